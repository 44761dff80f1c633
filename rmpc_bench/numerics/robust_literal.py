"""Table 2 of the enhanced robust predictor evaluated line by line, to see where rounding errors make it fail.

Model   estimators/enhanced_robust.py, with all symbols.  P, W and V enter in the same way, each through a channel.
        P is not symmetrised, its excess is a difference of matrices, and Step 5 is a difference of two large terms.
        An error of rounding that is not symmetric grows from step to step when the excess eps is small.
Source  souto2011, Table 2, (85)-(87).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.norm_bound import Excess
from rmpc_bench.types import Array

_ASYMMETRY = 1e-3
"""Largest |P - P'| of a covariance, relative to the largest entry of P."""


class Channel(NamedTuple):
    """What one of x, w and v adds to x(k+1) and y(k), nominally and by its uncertainty."""

    B: Float[Array, "nx n"]
    D: Float[Array, "ny n"]
    H: Float[Array, "nx r"]
    H_out: Float[Array, "ny r"]
    G: Float[Array, "s n"]
    Q: Float[Array, "n n"]
    """Covariance; of x it is P, whatever stands here."""
    excess: Excess


def is_covariance(
    P0: Float[Array, "nx nx"], channels: Sequence[tuple[Channel, Channel, Channel]]
) -> Float[Array, " steps"]:
    """Return at which k the P of Table 2, evaluated line by line, is a covariance matrix.

    Parameters
    ----------
    P0 : (nx, nx) covariance of the initial state
    channels : of x, w and v at k = 0..N

    Returns
    -------
    1 as long as P is finite, symmetric to 0.1 % and positive semidefinite, and 0 from the first k at which it is not
    """
    found, P = np.zeros(len(channels)), P0
    for k, (x, w, v) in enumerate(channels):
        if not _is_covariance(P):
            break
        found[k] = 1.0
        try:
            P = _next((x._replace(Q=P), w, v))
        except np.linalg.LinAlgError:
            break
    return found


def _is_covariance(P: Array) -> bool:
    if not np.isfinite(P).all():
        return False
    size = _ASYMMETRY * float(np.abs(P).max())
    return float(np.abs(P - P.T).max()) <= size and float(np.linalg.eigvalsh(P + P.T)[0]) >= -size


def _next(channels: tuple[Channel, ...]) -> Array:
    """Compute P at k+1 as Table 2 prints it; each sum has the terms of x, w and v."""
    a = [_parameter(each) for each in channels]  # Step 1
    Qc = [_widened(each, a_i) for each, a_i in zip(channels, a, strict=True)]  # Step 2
    parts = list(zip(channels, a, Qc, strict=True))
    own = np.add.reduce([c.B @ Q @ c.B.T + a_i * c.H @ c.H.T for c, a_i, Q in parts])
    S = np.add.reduce([c.D @ Q @ c.D.T + a_i * c.H_out @ c.H_out.T for c, a_i, Q in parts])
    x, Pc = channels[0], Qc[0]
    # As printed, without B U D'.
    N = x.B @ Pc @ x.D.T + np.add.reduce([a_i * c.H @ c.H_out.T for c, a_i, _ in parts])
    return np.asarray(own - N @ np.linalg.pinv(S) @ N.T)  # Step 5


def _parameter(channel: Channel) -> float:
    """Compute a = 1/alpha, (85)-(87)."""
    G, Q = channel.G, channel.Q
    largest = float(np.linalg.svd(G @ Q @ G.T, compute_uv=False).max())
    return largest + channel.excess.over(largest)


def _widened(channel: Channel, a: float) -> Array:
    G, Q = channel.G, channel.Q
    return np.asarray(Q + Q @ G.T @ np.linalg.inv(a * np.eye(len(G)) - G @ Q @ G.T) @ G @ Q)
