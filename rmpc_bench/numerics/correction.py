"""Corrections of a filter whose gains differ from run to run; a row of a block equals the row alone, bit for bit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import congruence, mv, symmetrise
from rmpc_bench.types import Array


class Corrected(NamedTuple):
    """Mean and covariance after a correction."""

    x: Float[Array, "runs n"]
    P: Float[Array, "runs n n"]


def joseph_correction(
    x: Float[Array, "runs n"],
    P: Float[Array, "runs n n"],
    e: Float[Array, "runs ny"],
    C: Float[Array, "runs ny n"],
    R_v: Float[Array, "runs ny ny"],
) -> Corrected:
    """Correct with an output matrix of every run, P in Joseph form; NaN where S = C P C' + R_v cannot be inverted.

    Parameters
    ----------
    x, P : prediction and its covariance
    e : innovation
    C : output matrix
    R_v : covariance of the measurement noise
    """
    PC = np.einsum("rij,rkj->rik", P, C)
    L = solved(congruence(C, P) + R_v, PC.swapaxes(1, 2)).swapaxes(1, 2)
    rest = np.eye(x.shape[1]) - np.einsum("rij,rjk->rik", L, C)
    return Corrected(x + mv(L, e), symmetrise(congruence(rest, P) + congruence(L, R_v)))


def cross_correction(
    x: Float[Array, "runs n"],
    P: Float[Array, "runs n n"],
    e: Float[Array, "runs ny"],
    S: Float[Array, "runs ny ny"],
    cross: Float[Array, "runs n ny"],
) -> Corrected:
    """Correct with the joint covariance of state and output, P - L S L'; NaN where S cannot be inverted.

    Parameters
    ----------
    x, P : prediction and its covariance
    e : innovation
    S : covariance of the innovation
    cross : covariance of state and output
    """
    L = solved(S, cross.swapaxes(1, 2)).swapaxes(1, 2)
    return Corrected(x + mv(L, e), symmetrise(P - congruence(L, S)))


def solved(S: Float[Array, "runs ny ny"], N: Float[Array, "runs ny n"]) -> Float[Array, "runs ny n"]:
    """Return S^-1 N of every run; NaN where S is singular or not finite, as in a failed run."""
    good = np.isfinite(S).all(axis=(1, 2))
    found = np.full(N.shape, np.nan)
    try:
        found[good] = np.linalg.solve(S[good], N[good])
    except np.linalg.LinAlgError:
        for i in np.flatnonzero(good):
            try:
                found[i] = np.linalg.solve(S[i], N[i])
            except np.linalg.LinAlgError:
                pass
    return found
