"""Riccati recursions of the roots of covariances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.square_root import conditional, corrected, covariance_of, lower_root, root_of
from rmpc_bench.types import Array


class FilterStep(NamedTuple):
    """One period of a filter's covariances and gains."""

    L: Float[Array, "nx ny"]  # correction gain: x_hat = x_pred + L e
    K: Float[Array, "nx ny"]  # prediction gain: K = A L
    root: Float[Array, "nx nx"]  # root of the covariance of x_hat - x
    root_next: Float[Array, "nx nx"]  # root of the covariance of x_pred(k+1) - x(k+1)

    @property
    def P(self) -> Float[Array, "nx nx"]:
        """Covariance of x_hat - x."""
        return covariance_of(self.root)

    @property
    def P_next(self) -> Float[Array, "nx nx"]:
        """Covariance of x_pred(k+1) - x(k+1)."""
        return covariance_of(self.root_next)


def filter_step(
    A: Float[Array, "nx nx"],
    C: Float[Array, "ny nx"],
    Q_w: Float[Array, "nx nx"],
    R_v: Float[Array, "ny ny"],
    root: Float[Array, "nx r"],
    growth: float = 1.0,
    *,
    measured: bool = True,
) -> FilterStep:
    """Correct and propagate a root of the covariance of the prediction error: P_next = growth A P A' + Q_w.

    A LinAlgError says that C P C' + R_v is singular.
    """
    if not measured:
        nothing = np.zeros((len(A), len(C)))
        return FilterStep(nothing, nothing, root, predicted_root(A, Q_w, root, growth))
    found = corrected(C, root_of(R_v), root)
    if not found.regular:
        raise np.linalg.LinAlgError("Singular matrix")
    L = found.gain
    return FilterStep(L, A.dot(L), found.root, predicted_root(A, Q_w, found.root, growth))


def predicted_root(
    A: Float[Array, "... nx nx"], Q_w: Float[Array, "nx nx"], root: Float[Array, "... nx r"], growth: float = 1.0
) -> Float[Array, "... nx nx"]:
    """Return the root of growth A P A' + Q_w."""
    return lower_root(growth**0.5 * (A @ root), root_of(Q_w))


class PredictorStep(NamedTuple):
    """One period of a one-step predictor."""

    K: Float[Array, "nx ny"]  # gain: x_pred(k+1) = A x_pred + .. + K e
    root_next: Float[Array, "nx nx"]  # root of the covariance of x_pred(k+1) - x(k+1)

    @property
    def P_next(self) -> Float[Array, "nx nx"]:
        """Covariance of x_pred(k+1) - x(k+1)."""
        return covariance_of(self.root_next)


def predictor_step(M: Float[Array, "nz nx"], J: Float[Array, "nz nz"], root: Float[Array, "nx r"]) -> PredictorStep:
    """Return the optimal gain for [x(k+1); y] = M x + [w; v] with correlated noises, and the resulting covariance.

    K = (A P C' + S) (C P C' + R)^+ for M = [A; C] and J = [Q S; S' R]; P is given by its root.
    """
    nx = len(root)
    both = np.hstack([M.dot(root), root_of(J)])
    found = conditional(both[nx:], both[:nx])
    return PredictorStep(found.gain, found.root)


def error_map(K: Float[Array, "nx ny"]) -> Float[Array, "nx nz"]:
    """Return [I -K], which maps noise in [x(k+1); y] to the error of the prediction."""
    nx, ny = K.shape
    T = np.zeros((nx, nx + ny))
    T.ravel()[: nx * (nx + ny) : nx + ny + 1] = 1.0
    np.negative(K, out=T[:, nx:])
    return T


def error_radius(
    F: Float[Array, "kF nx nx"], K: Float[Array, "kK nx ny"], C: Float[Array, "kC ny nx"]
) -> Float[Array, " k"]:
    """Return the spectral radius of F - K C at each k; below 1 the error dynamics are stable."""
    return np.abs(np.linalg.eigvals(F - K @ C)).max(axis=-1)
