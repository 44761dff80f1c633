"""Riccati recursions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.types import Array

# A smaller pivot counts as 0.
_SINGULAR = 4 * np.finfo(float).eps


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
    growth: float = 1.0,
) -> FilterStep:
    """Correct and propagate the covariance ``V`` of the prediction error: P_next = growth A P A' + Q_w.

    The correction uses the Joseph form, which keeps P symmetric and positive semidefinite under rounding.  For such
    small matrices `dot` takes half the time of `@`, because the overhead of the call dominates.

    Raises
    ------
    numpy.linalg.LinAlgError
        If C V C' + R_v is singular.
    """
    CV = C.dot(V)
    L = filter_gain(CV.dot(C.T) + R_v, CV)
    rest = np.eye(len(A)) - L.dot(C)
    P = symmetrise(rest.dot(V).dot(rest.T) + L.dot(R_v).dot(L.T))
    return FilterStep(L, A.dot(L), P, symmetrise(growth * A.dot(P).dot(A.T) + Q_w))


def unmeasured_step(
    A: Float[Array, "nx nx"],
    C: Float[Array, "ny nx"],
    Q_w: Float[Array, "nx nx"],
    R_v: Float[Array, "ny ny"],
    V: Float[Array, "nx nx"],
    growth: float = 1.0,
) -> FilterStep:
    """Propagate a covariance without a measurement."""
    nothing = np.zeros((len(A), len(C)))
    return FilterStep(nothing, nothing, V, symmetrise(growth * A.dot(V).dot(A.T) + Q_w))


class PredictorStep(NamedTuple):
    """One period of a one-step predictor."""

    K: Float[Array, "nx ny"]
    """Gain: x_pred(k+1) = A x_pred + .. + K e."""
    P_next: Float[Array, "nx nx"]
    """Covariance of x_pred(k+1) - x(k+1)."""


def predictor_step(M: Float[Array, "nz nx"], J: Float[Array, "nz nz"], P: Float[Array, "nx nx"]) -> PredictorStep:
    """Return the optimal gain for [x(k+1); y] = M x + [w; v] with correlated noises, and the resulting covariance.

    K = (A P C' + S) (C P C' + R)^+ for M = [A; C] and J = [Q S; S' R].  P_next has the Joseph form
    (A - K C) P (A - K C)' + [I -K] J [I -K]'.  It is symmetric and positive semidefinite under rounding, and it is the
    covariance for the computed K, including its rounding errors.

    Parameters
    ----------
    M : A over C
    J : covariance of w over v
    P : covariance of the error of x
    """
    nx = len(P)
    Y = M.dot(P).dot(M[nx:].T)
    Y += J[:, nx:]
    K = predictor_gain(Y[:nx], Y[nx:])
    T = error_map(K)
    return PredictorStep(K, error_covariance(T, M, J, P))


def error_map(K: Float[Array, "nx ny"]) -> Float[Array, "nx nz"]:
    """Return [I -K], which maps noise in [x(k+1); y] to the error of the prediction."""
    nx, ny = K.shape
    T = np.zeros((nx, nx + ny))
    T.ravel()[: nx * (nx + ny) : nx + ny + 1] = 1.0
    np.negative(K, out=T[:, nx:])
    return T


def error_covariance(
    T: Float[Array, "nx nz"], M: Float[Array, "nz nx"], J: Float[Array, "nz nz"], P: Float[Array, "nx nx"]
) -> Float[Array, "nx nx"]:
    """Return T (M P M' + J) T' as the sum (T M) P (T M)' + T J T'."""
    rest = T.dot(M)
    return symmetrise(rest.dot(P).dot(rest.T) + T.dot(J).dot(T.T))


def predictor_gain(N: Float[Array, "nx ny"], Y: Float[Array, "ny ny"]) -> Float[Array, "nx ny"]:
    """Return N Y^+ for the covariance Y of an innovation; the rows of N are in the range of Y.

    The method is elimination, or the pseudo-inverse if Y is singular.  All outputs are scaled to variance 1 first, so
    that the test for singularity does not depend on their units.
    """
    if len(Y) == 1:
        K: Array = N / Y if Y.item() > 0.0 else np.zeros_like(N)
        return K
    scale = np.sqrt(np.maximum(Y.diagonal(), 0.0))
    scale[scale == 0.0] = 1.0
    correlation = symmetrise(Y) / (scale[:, None] * scale)
    N = N / scale
    try:
        pivots = np.linalg.cholesky(correlation).diagonal()
        regular = bool(pivots.min() ** 2 > _SINGULAR * len(Y))
    except np.linalg.LinAlgError:
        regular = False
    if regular:
        gain: Array = np.linalg.solve(correlation, N.T).T
    else:
        gain = N.dot(np.linalg.pinv(correlation, rcond=_SINGULAR * len(Y), hermitian=True))
    return gain / scale


def filter_gain(S: Float[Array, "ny ny"], CV: Float[Array, "ny nx"]) -> Float[Array, "nx ny"]:
    """Return V C' S^-1.

    Raises
    ------
    numpy.linalg.LinAlgError
        If S is singular.
    """
    if len(S) > 1:
        return np.linalg.solve(symmetrise(S), CV).T
    if S.item() == 0.0:
        raise np.linalg.LinAlgError("Singular matrix")
    L: Array = CV.T / S
    return L


def error_radius(
    F: Float[Array, "kF nx nx"], K: Float[Array, "kK nx ny"], C: Float[Array, "kC ny nx"]
) -> Float[Array, " k"]:
    """Return the spectral radius of F - K C at each k; below 1 the error dynamics are stable."""
    radius: Array = np.abs(np.linalg.eigvals(F - K @ C)).max(axis=-1)
    return radius
