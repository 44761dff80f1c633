"""The Kullback-Leibler ball: how far nature may move a covariance P within divergence c.

Source  zenere2018, (13) and (16).  With x_i = theta * lambda_i(P) the left side of (16) is
        sum_i [log(1 - x_i) + x_i / (1 - x_i)], strictly increasing in theta from 0 to infinity.
Limit   c -> 0 gives theta -> 0 and V -> P.
Digits  theta is right to the last one; 1 - theta * lambda_max is about 1/c, so the largest eigenvalue of V keeps a
        relative error of about c * 1e-16.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.types import Array

_BELOW_ONE = math.nextafter(1.0, 0.0)


class Inflation(NamedTuple):
    """The least favourable covariance and its multiplier."""

    V: Float[Array, "n n"]
    theta: float


def divergence(s: float, mu: list[float]) -> float:
    """Left side of (16) at theta = s / lambda_max, for eigenvalues mu = lambda / lambda_max."""
    return sum(_term(s * m) for m in mu)


def _term(x: float) -> float:
    """log(1 - x) + x / (1 - x); for small x, where the two cancel, their series: the sum of (1 - 1/k) x^k, k >= 2."""
    if x < 1e-2:  # the first term left out is below 1e-16 of the first one kept
        tail = sum((1.0 - 1.0 / k) * x ** (k - 2) for k in range(9, 2, -1))
        return x * x * (0.5 + tail)
    return math.log1p(-x) + x / (1.0 - x)


def solve_scaled(mu: list[float], c: float) -> float:
    """Solve (16) for s = theta * lambda_max in (0, 1), to the last bit.

    Newton's method on the convex, increasing left side comes within a few units in the last place; a bracket is then
    opened around it and halved until no double lies inside.
    """
    if divergence(_BELOW_ONE, mu) <= c:  # the ball is larger than doubles can tell
        return _BELOW_ONE
    s = _newton(mu, c)
    low = high = s
    width = math.ulp(s)
    while divergence(low, mu) > c:
        low, width = max(low - width, 0.0), 2.0 * width
    width = math.ulp(s)
    while divergence(high, mu) <= c:
        high, width = min(high + width, _BELOW_ONE), 2.0 * width
    while low < (middle := 0.5 * (low + high)) < high:
        if divergence(middle, mu) > c:
            high = middle
        else:
            low = middle
    return low if c - divergence(low, mu) <= divergence(high, mu) - c else high


def _newton(mu: list[float], c: float) -> float:
    # The left side is about n s^2 / 2 for small s and about 1 / (1 - s) near s = 1.
    s = math.sqrt(2.0 * c / len(mu)) if c < 0.1 else c / (1.0 + c)
    for _ in range(100):
        slope = sum(s * m * m / (1.0 - s * m) ** 2 for m in mu)
        s_next = s - (divergence(s, mu) - c) / slope
        if not 0.0 < s_next < 1.0:
            s_next = 0.5 * (s + (1.0 if s_next >= 1.0 else 0.0))
        if abs(s_next - s) <= 2.0 * math.ulp(s):
            return s_next
        s = s_next
    return s


def inflate(P: Float[Array, "n n"], theta: float) -> Float[Array, "n n"]:
    """V = (P^-1 - theta I)^-1 by eigenvalues, so that a singular P is no obstacle, (13).

    Raises
    ------
    ValueError
        If theta * lambda_max(P) >= 1: V is undefined.
    """
    lam, U = np.linalg.eigh(symmetrise(P))
    if theta * lam[-1] >= 1.0:
        raise ValueError(f"theta*lambda_max(P) = {theta * lam[-1]:.6g} is not below 1")
    return _rebuild(U, np.maximum(lam, 0.0), theta * np.maximum(lam, 0.0))


def inflate_to_radius(P: Float[Array, "n n"], c: float) -> Inflation:
    """Solve (16) for theta and return V of (13); P = 0 gives V = 0 with theta = 0.

    Parameters
    ----------
    P : (n, n) positive semidefinite matrix, singular allowed
    c : radius of the ball, > 0 (dimensionless)
    """
    lam, U = np.linalg.eigh(symmetrise(P))
    lam = np.maximum(lam, 0.0)
    if lam[-1] == 0.0:
        return Inflation(np.zeros_like(P), 0.0)
    mu = lam / lam[-1]
    s = solve_scaled(mu.tolist(), c)
    return Inflation(_rebuild(U, lam, s * mu), s / float(lam[-1]))


def _rebuild(U: Float[Array, "n n"], lam: Float[Array, " n"], x: Float[Array, " n"]) -> Float[Array, "n n"]:
    return symmetrise((U * (lam / (1.0 - x))) @ U.T)
