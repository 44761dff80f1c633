"""Riccati recursion of filters in which every run has a root of its covariance of its own.

Whitening   T R_v T' = I, T the inverse of the lower Cholesky factor of R_v; q = T e, H = T C.  A component of q is an
            output minus its prediction from the outputs before it, over its standard deviation: with correlated noises
            a weight of one component depends on the order of the outputs.
Correction  that of output_weights.py.
Missing     An output that is NaN has no effect.  T is then that of the other outputs.
Bits        A run is computed alone, whatever other runs the block has.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.numerics.square_root import root_of, without_missing
from rmpc_bench.types import Array


class Measured(NamedTuple):
    """Measurements compared with their predictions."""

    e: Float[Array, "runs ny"]
    """Innovation; NaN where an output is missing."""
    S: Float[Array, "runs ny ny"]
    """C P_pred C' + R_v."""
    q: Float[Array, "runs ny"]
    H: Float[Array, "runs ny nx"]


class OwnState(NamedTuple):
    """Estimate or prediction of every run with a root of its covariance."""

    x: Float[Array, "runs nx"]
    root: Float[Array, "runs nx nx"]


def whitening(R_v: Float[Array, "*k ny ny"]) -> Float[Array, "*k ny ny"]:
    """Return the lower triangular T with T R_v T' = I.

    Raises
    ------
    numpy.linalg.LinAlgError
        If R_v is singular.
    """
    inverse: Array = np.tril(np.linalg.inv(np.linalg.cholesky(R_v)))
    return inverse


def whitening_of_runs(
    T: Float[Array, "ny ny"], R_v: Float[Array, "ny ny"], missing: Bool[Array, "runs ny"]
) -> Float[Array, "runs ny ny"]:
    """Return T of every run, that of its outputs which are there."""
    rows = np.flatnonzero(missing.any(axis=1))
    found = np.repeat(T[None], len(missing), axis=0)
    found[rows] = whitening(without_missing(R_v, ~missing[rows]))
    return found


def measured(
    C: Float[Array, "ny nx"],
    d: Float[Array, " ny"],
    R_v: Float[Array, "ny ny"],
    T: Float[Array, "some ny ny"],
    state: OwnState,
    y: Float[Array, "runs ny"],
) -> Measured:
    """Compare y, NaN where it is missing, with the predictions C x + d; T is of every run, or a single one for all."""
    from rmpc_bench.numerics.own_covariance_kernel import measure_kernel

    (runs, nx), ny = state.x.shape, len(C)
    found = Measured(np.empty((runs, ny)), np.empty((runs, ny, ny)), np.empty((runs, ny)), np.empty((runs, ny, nx)))
    C, d, R_v, T, x, root, y = map(as_compiled, (C, d, R_v, T, *state, y))
    measure_kernel(C, d, R_v, T, x, root, y, *found)
    return found


def predicted(
    A: Float[Array, "nx nx"],
    B: Float[Array, "nx nu"],
    f: Float[Array, " nx"],
    Q_w: Float[Array, "nx nx"],
    state: OwnState,
    u: Float[Array, "runs nu"],
) -> OwnState:
    """Return A x + B u + f and the root of A P A' + Q_w of every run."""
    from rmpc_bench.numerics.output_weights_kernel import predict_kernel

    after = OwnState(np.empty_like(state.x), np.empty_like(state.root))
    A, B, f, Q_root, x, root, u = map(as_compiled, (A, B, f, root_of(Q_w), *state, u))
    predict_kernel(A, B, f, Q_root, x, root, u, *after)
    return after
