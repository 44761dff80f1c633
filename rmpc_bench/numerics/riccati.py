"""Riccati recursions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.types import Array


class FilterStep(NamedTuple):
    """One period of a filter's covariances and gains."""

    L: Float[Array, "nx ny"]
    """Correction gain: x_hat = x_pred + L e."""
    K: Float[Array, "nx ny"]
    """Prediction gain: K = A L."""
    P: Float[Array, "nx nx"]
    """Covariance of x_hat - x."""
    P_next: Float[Array, "nx nx"]
    """Covariance of x_pred(k+1) - x(k+1)."""


def filter_step(
    A: Float[Array, "nx nx"],
    C: Float[Array, "ny nx"],
    Q_w: Float[Array, "nx nx"],
    R_v: Float[Array, "ny ny"],
    V: Float[Array, "nx nx"],
) -> FilterStep:
    """Correct and propagate the covariance ``V`` of the prediction error.

    The correction is written in Joseph form, which keeps P symmetric and positive semidefinite under rounding.

    Raises
    ------
    numpy.linalg.LinAlgError
        If C V C' + R_v is singular.
    """
    S = symmetrise(C @ V @ C.T + R_v)
    L = np.linalg.solve(S, C @ V).T
    rest = np.eye(len(A)) - L @ C
    P = symmetrise(rest @ V @ rest.T + L @ R_v @ L.T)
    return FilterStep(L, A @ L, P, symmetrise(A @ P @ A.T + Q_w))
