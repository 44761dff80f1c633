"""Least favourable joint covariance of a state and a measurement in a Wasserstein ball.

Problem max over S >= 0 of f(S) = tr(S_xx - S_xy S_yy^-1 S_yx)
        subject to  tr(S + Sigma - 2 (Sigma^1/2 S Sigma^1/2)^1/2) <= rho^2,
        where Sigma = G G' is the nominal covariance of [x; y].  f is concave, and L = S_xy S_yy^-1 is the best gain.
Method  Frank-Wolfe.  With T = [I -L] the gradient of f is T'T = U diag(d) U', and f(S) = tr(T S T').  The S_new that
        maximises tr(T S T') in the ball is M Sigma M with M = I + U diag(d / (gamma - d)) U'; gamma > max d solves
        sum_i s_i (d_i / (gamma - d_i))^2 = rho^2,  s_i = u_i' Sigma u_i.                           (secular equation)
        The unknown is gamma - max d, and Newton's method is applied to the inverse square root of the left side, which
        is concave: from the lower bound on the root all steps are upwards.
        S moves towards S_new by the step that maximises f, found by Newton's method between bounds.  A full step can
        cycle.  The mean square error tr(T S_new T') of any gain is an upper bound of f; the duality gap is the least
        one minus f(S).
        Where this is slow, which is the case for a rho above (tr Sigma)^1/2, the gain is found in place of S: a
        quasi-Newton method minimises max_S tr(T S T'), which is convex in L and has the same value.
Start   The S_new of a given gain.  It is in the ball, also if Sigma has changed since that gain was optimal.
Singular
        Where Sigma has no component in the directions of the largest d, gamma may be max d.  What is left of rho^2 is
        then added to S in these directions, in equal parts.
Source  Shafieezadeh-Abadeh, Nguyen, Kuhn, Mohajerin Esfahani, NeurIPS 2018, Algorithms 1-3, with the step 2 / (k + 2).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.square_root import Conditional, conditional, covariance_of, lower_root
from rmpc_bench.types import Array

_STEPS = 20
"""Steps of Frank-Wolfe before the quasi-Newton method."""
_NEWTON = 100
_EQUAL = 1e-14
"""Eigenvalues that differ by less, relative to the largest one, count as equal."""
_NOTHING = 1e-30
"""Part of tr Sigma below which a component of Sigma counts as 0: the square of a rounding error."""


class LeastFavourable(NamedTuple):
    """The least favourable covariance, and the estimator that is best under it."""

    S_root: Float[Array, "nz nz"]
    L: Float[Array, "nx ny"]  # gain S_xy S_yy^-1
    root: Float[Array, "nx nx"]  # root of the covariance of the error, P = S_xx - L S_yx
    gap: float  # duality gap over tr P

    @property
    def S(self) -> Float[Array, "nz nz"]:
        """The covariance."""
        return covariance_of(self.S_root)

    @property
    def P(self) -> Float[Array, "nx nx"]:
        """Covariance of the error."""
        return covariance_of(self.root)


def joint_factor(
    C: Float[Array, "ny nx"], P_root: Float[Array, "nx n"], R_root: Float[Array, "ny m"]
) -> Float[Array, "nz r"]:
    """Return G of the nominal covariance G G' = [P, P C'; C P, C P C' + R]."""
    (ny, nx), n, m = C.shape, P_root.shape[1], R_root.shape[1]
    G = np.zeros((nx + ny, n + m))
    G[:nx, :n] = P_root
    G[nx:, :n] = C.dot(P_root)
    G[nx:, n:] = R_root
    return G


def least_favourable(
    G: Float[Array, "nz r"], radius: float, L: Float[Array, "nx ny"], tolerance: float = 1e-10
) -> LeastFavourable:
    """Return the least favourable covariance in the ball around G G', from the gain L on.

    It ends at a duality gap of `tolerance`, relative to the value.  A LinAlgError says that S_yy is singular.
    """
    nx, nothing = len(L), _nothing(G)
    F, bound = _worst(G, radius, L, nothing)
    for _ in range(_STEPS):
        best, value = _best(F, nx)
        if bound - value <= tolerance * value:
            return _result(F, best.gain, best.root, bound - value)
        new, error = _worst(G, radius, best.gain, nothing)
        bound = min(bound, error)
        t = step_length(F, new, nx)
        F = lower_root((1.0 - t) ** 0.5 * F, t**0.5 * new)
    L = minimax_gain(G, radius, _best(F, nx)[0].gain)
    worst, error = _worst(G, radius, L, nothing)
    F = max((F, worst), key=lambda each: _best(each, nx)[1])
    return _result(F, L, lower_root(F[:nx] - L.dot(F[nx:])), min(bound, error) - _best(F, nx)[1])


def _result(
    F: Float[Array, "nz r"], L: Float[Array, "nx ny"], root: Float[Array, "nx nx"], gap: float
) -> LeastFavourable:
    value = float((root * root).sum())
    return LeastFavourable(F, L, root, max(gap, 0.0) / value if value > 0.0 else 0.0)


def _best(F: Float[Array, "nz r"], nx: int) -> tuple[Conditional, float]:
    """Return the best gain under F F' with the root of P, and tr P; raise a LinAlgError if S_yy is singular."""
    best = conditional(F[nx:], F[:nx])
    if not best.regular:
        raise np.linalg.LinAlgError("Singular matrix")
    return best, float((best.root * best.root).sum())


def mean_square(S: Float[Array, "nz nz"], L: Float[Array, "nx ny"]) -> float:
    """Return tr([I -L] S [I -L]'), the mean square error of a gain."""
    nx = len(L)
    return float(S[:nx, :nx].trace() + (L * (L.dot(S[nx:, nx:]) - 2.0 * S[:nx, nx:])).sum())


def minimax_gain(G: Float[Array, "nz r"], radius: float, L: Float[Array, "nx ny"]) -> Float[Array, "nx ny"]:
    """Minimise the largest mean square error in the ball, by a quasi-Newton method in coordinates with S_yy = I."""
    from scipy.optimize import minimize

    nx = len(L)
    S = _worst(G, radius, L, _nothing(G))[0]
    root, scale = lower_root(S[nx:]), mean_square(covariance_of(S), L)

    def largest(point: Array) -> tuple[float, Array]:
        gain = np.linalg.solve(root.T, point.reshape(L.shape).T).T
        worst = worst_for_gain(G, radius, gain)
        gradient = np.linalg.solve(root, 2.0 * (gain.dot(worst[nx:, nx:]) - worst[:nx, nx:]).T).T
        return mean_square(worst, gain) / scale, gradient.ravel() / scale

    found = minimize(largest, L.dot(root).ravel(), jac=True, method="BFGS", options={"gtol": 1e-9})
    return np.linalg.solve(root.T, found.x.reshape(L.shape).T).T


def worst_for_gain(G: Float[Array, "nz r"], radius: float, L: Float[Array, "nx ny"]) -> Float[Array, "nz nz"]:
    """Return the S in the ball that maximises the mean square error of the gain L."""
    return covariance_of(_worst(G, radius, L, _nothing(G))[0])


def _nothing(G: Float[Array, "nz r"]) -> float:
    return _NOTHING * float((G * G).sum())


def _worst(
    G: Float[Array, "nz r"], radius: float, L: Float[Array, "nx ny"], nothing: float
) -> tuple[Float[Array, "nz more"], float]:
    """Return the root of the worst S for a gain, and its error; a component of Sigma up to `nothing` counts as 0."""
    nx, ny = L.shape
    d, V = np.linalg.eigh(np.eye(nx) + L.dot(L.T))
    U = np.empty((nx + ny, nx))
    U[:nx] = V
    np.negative(L.T.dot(V), out=U[nx:])
    U /= np.sqrt(d)
    GU = U.T.dot(G)
    values, s = d.tolist(), (GU * GU).sum(axis=1).tolist()
    weights, added = stretches(values, s, radius, nothing)
    error = sum(a * ((1.0 + w) ** 2 * b + t) for a, w, b, t in zip(values, weights, s, added, strict=True))
    moved = G + (U * weights).dot(GU)
    return (np.hstack([moved, U * np.sqrt(added)]) if any(added) else moved), error


def stretches(d: list[float], s: list[float], radius: float, nothing: float) -> tuple[list[float], list[float]]:
    """Solve the secular equation for ascending eigenvalues d of the gradient and s = u_i' Sigma u_i; s <= nothing is 0.

    Return the weights d / (gamma - d) of U U' in M, and what is added to S in the directions U.
    """
    none = [0.0] * len(d)
    if radius == 0.0:
        return none, none
    below = [0.0 if d[-1] - each <= _EQUAL * d[-1] else d[-1] - each for each in d]
    terms = [(a * a * each, b) for a, b, each in zip(d, below, s, strict=True) if each > nothing]
    at_pole = sum(a for a, b in terms if b == 0.0)
    rest = 0.0 if at_pole else sum(a / (b * b) for a, b in terms)
    if not at_pole and rest <= radius**2:
        share = (radius**2 - rest) / below.count(0.0)
        return [a / b if b else 0.0 for a, b in zip(d, below, strict=True)], [0.0 if b else share for b in below]
    delta = _root(terms, radius, math.sqrt(at_pole) / radius)
    return [a / (delta + b) for a, b in zip(d, below, strict=True)], none


def _root(terms: list[tuple[float, float]], radius: float, start: float) -> float:
    """Solve sum a / (delta + b)^2 = radius^2 for delta, from a lower bound; the sum there is at least radius^2."""
    delta = start
    for _ in range(_NEWTON):
        square = cube = 0.0
        for a, b in terms:
            term = a / (delta + b) ** 2
            square += term
            cube += term / (delta + b)
        step = (math.sqrt(square) / radius - 1.0) * square / cube
        if step <= 1e-15 * delta:
            break
        delta += step
    return delta


def step_length(F: Float[Array, "nz r"], new: Float[Array, "nz s"], nx: int) -> float:
    """Return the t in [0, 1] that maximises f(S + t (S_new - S)), from the roots of S and S_new.

    In coordinates of y in which S_yy = I and the S_yy of new is I + diag(lam), f is a sum over the outputs:
    f(t) = tr S_xx + t tr D_xx - sum_i |a_i + t b_i|^2 / (1 + t lam_i).
    """
    root = np.linalg.inv(lower_root(F[nx:]))
    moved = root.dot(new[nx:])
    lam, Q = np.linalg.eigh(moved.dot(moved.T) - np.eye(len(root)))
    W = root.T.dot(Q)
    a = F[:nx].dot(F[nx:].T.dot(W))
    b = new[:nx].dot(new[nx:].T.dot(W)) - a
    inner = [(a * a).sum(axis=0), (a * b).sum(axis=0), (b * b).sum(axis=0), lam]
    rows = list(zip(*(each.tolist() for each in inner), strict=True))
    slope = float((new[:nx] ** 2).sum() - (F[:nx] ** 2).sum())
    if _derivatives(rows, slope, 1.0)[0] >= 0.0:
        return 1.0
    low, high, t = 0.0, 1.0, 0.0
    for _ in range(_NEWTON):
        first, second = _derivatives(rows, slope, t)
        low, high = (t, high) if first > 0.0 else (low, t)
        moved = t - first / second if second < 0.0 else 0.5 * (low + high)
        if not low < moved < high:
            moved = 0.5 * (low + high)
        if abs(moved - t) <= 1e-12:
            break
        t = moved
    return t


def _derivatives(rows: list[tuple[float, ...]], slope: float, t: float) -> tuple[float, float]:
    """Return f'(t) and f''(t); a row is |a_i|^2, a_i b_i, |b_i|^2, lam_i."""
    first, second = slope, 0.0
    for aa, ab, bb, lam in rows:
        z = 1.0 + t * lam
        first -= (2.0 * (ab + t * bb) - lam * (aa + t * (2.0 * ab + t * bb)) / z) / z
        second -= 2.0 * (bb + lam * (lam * aa - 2.0 * ab)) / z**3
    return first, second
