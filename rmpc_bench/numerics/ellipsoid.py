"""Ellipsoids E(c, M) = {x : (x - c)' M^-1 (x - c) <= 1}, given by their shape matrices M, singular ones included.

A singular M is a flat ellipsoid, M = 0 the point c.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import sqrt
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import mv, symmetrise
from rmpc_bench.types import Array

Criterion: TypeAlias = Literal["trace", "volume"]

EPS = float(np.finfo(np.float64).eps)
LAST = 1.0 - 1e-6
"""Largest weight of a measurement; the weight of the prediction is at least 1e-6, so that the set stays bounded in
unmeasured directions."""
SHARES = np.linspace(0.0, 1.0, 17)
ROUNDS = 10
"""Rounds of a search, each on a grid 8 times finer: accurate to 1e-9 of the range and 1e-18 of the minimum."""
SLACK = 8.0
"""Rounding errors per term of a sum by which sets are enlarged; states on the boundary left the set with 0.5, but not
with 1."""


def weight(M1: Float[Array, "n n"], M2: Float[Array, "n n"]) -> float:
    """Return p = sqrt(tr M1 / tr M2), which minimises the ellipsoid around a sum; 0 or inf if one set is a point.

    Of all p > 0, this one gives (1 + 1/p) M1 + (1 + p) M2 the least trace, (sqrt(tr M1) + sqrt(tr M2))^2.
    """
    first, second = sqrt(max(M1.trace(), 0.0)), sqrt(max(M2.trace(), 0.0))
    if second == 0.0:
        return float("inf")
    return first / second


def sum_shape(M1: Float[Array, "n n"], M2: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Return the shape of least trace whose ellipsoid contains all sums of a point of E(0, M1) and one of E(0, M2)."""
    p = weight(M1, M2)
    if p == 0.0:
        return M2
    if p == float("inf"):
        return M1
    return (1.0 + 1.0 / p) * M1 + (1.0 + p) * M2


def sum_shapes(M1: Float[Array, "runs n n"], M2: Float[Array, "n n"]) -> Float[Array, "runs n n"]:
    """Return `sum_shape` for one M1 per run."""
    first, second = np.sqrt(np.maximum(np.einsum("rii->r", M1), 0.0)), sqrt(max(M2.trace(), 0.0))
    if second == 0.0:
        return M1
    inverse = np.divide(second, first, out=np.zeros_like(first), where=first > 0.0)
    return (1.0 + inverse)[:, None, None] * M1 + (1.0 + first / second)[:, None, None] * M2


@cache
def confidence(level: float, n: int) -> float:
    """Return the chi-square quantile c: E(0, c P) contains a Gaussian vector with covariance P at this level."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(n / 2.0, level))


class Intersection(NamedTuple):
    """Ellipsoids around the intersection of two sets, one per run."""

    centre: Float[Array, "runs n"]  # centre relative to the centre of the first set
    M: Float[Array, "runs n n"]
    lam: Float[Array, " runs"]  # weight of the second set in the combination; with 0 the result is the first set
    met: Bool[Array, " runs"]  # whether the sets intersect; if not, the result is the first set


def intersection(
    M: Float[Array, "runs n n"],
    C: Float[Array, "m n"],
    R: Float[Array, "m m"],
    e: Float[Array, "runs m"],
    criterion: Criterion = "trace",
) -> Intersection:
    """Enclose the points x with x' M^-1 x <= 1 and (e - C x)' R^-1 (e - C x) <= 1 by their smallest combination.

    M may be singular, R may not; e are measurements minus the outputs at the centres of the first sets.

    With M = F F', R^-1/2 C F = U diag(s) W' and z = U' R^-1/2 e, these are the points x = F W xi with |xi| <= 1 and
    |z - s xi| <= 1, for any rank of M or C.  For every lam in [0, 1] they satisfy
    (1 - lam) |xi|^2 + lam |z - s xi|^2 <= 1.  Completing the square gives an ellipsoid of shape delta2 diag(1 / t) with
    centre lam s z / t, where t = 1 - lam + lam s^2 and delta2 = 1 - lam (1 - lam) sum(z^2 / t).  delta2 < 0 for some
    lam if and only if there is no such point.

    The set is enlarged to account for rounding.  F F' and the root of R are enlarged, see `_root`.  Relative rounding
    eps of C F, e and the singular values changes z - s xi by eps times `reach`, the size of their products, which is
    added to the scale.  The rounding of the centre remains: x may be outside by about 1e-13 of the half-widths
    sqrt(M_ii) of the first set.
    """
    (m, n), (F, _), (_, root) = C.shape, _root(M), _root(R)
    A = np.einsum("ki,rij->rkj", root @ C, F)
    U, s, Wt = np.linalg.svd(np.where(np.isfinite(A), A, 0.0))  # which raises for all runs if one has overflowed
    s, z = _padded(s, max(m, n)), _padded(np.einsum("rkj,rk->rj", U, mv(root, e)), max(m, n))
    B = np.einsum("rij,rkj->rik", F, Wt)
    reach = mv(np.abs(root), np.abs(e) + mv(np.abs(C), np.abs(F).sum(axis=2)))
    margin = SLACK * (m + n) * EPS * (1.0 + np.sqrt((reach**2).sum(axis=1)))
    combined = _Combination(B, s**2, z, margin)
    size = combined.trace if criterion == "trace" else combined.radius
    met = ~(combined.delta2(_smallest(combined.delta2, len(e))[:, None])[:, 0] < -margin)
    lam = np.where(met, _smallest(lambda lam: combined.scale(lam) * size(lam), len(e)), 0.0)
    t = combined.mixed(lam[:, None])[:, 0]
    centre = np.einsum("rij,rj->ri", B, (lam[:, None] * s * z / t)[:, :n])
    Y = B * np.sqrt(combined.scale(lam[:, None]) / t[:, :n])[:, None, :]
    X = np.einsum("rik,rjk->rij", Y, Y) * (1.0 + _slack(n) * np.eye(n))
    return Intersection(centre, np.where((lam > 0.0)[:, None, None], symmetrise(X), M), lam, met)


def _slack(n: int) -> float:
    """Return a bound of the rounding error of the eigenvalues of a matrix with a diagonal of ones."""
    return SLACK * n * n * EPS


def _root(M: Float[Array, "*runs n n"]) -> tuple[Float[Array, "*runs n n"], Float[Array, "*runs n n"]]:
    """Return F with F F' = M + slack diag(M), so that rounding does not reduce the set, and its inverse."""
    # A flat set becomes one whose thickness is about 1e-7 of its half-widths. An entry of x that is known exactly
    # remains known exactly; the inverse then has zeros for it.
    half = np.sqrt(np.maximum(np.einsum("...ii->...i", M), 0.0))
    inverse = np.divide(1.0, half, out=np.zeros_like(half), where=half > 0.0)
    d, V = np.linalg.eigh(inverse[..., :, None] * M * inverse[..., None, :])
    d = np.sqrt(np.maximum(d, 0.0) + _slack(M.shape[-1]))[..., None, :]
    return half[..., None] * V * d, (inverse[..., None] * V / d).mT


def _padded(values: Float[Array, "runs k"], size: int) -> Float[Array, "runs size"]:
    return np.pad(values, ((0, 0), (0, size - values.shape[1])))


class _Combination(NamedTuple):
    """Combinations of two sets as functions of their weight lam (runs, points)."""

    B: Float[Array, "runs n n"]  # F W, which maps xi to x
    g: Float[Array, "runs p"]  # squares of s; g and z are padded with zeros to the larger of n and m
    z: Float[Array, "runs p"]
    margin: Float[Array, " runs"]

    def delta2(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Scale of diag(1 / t), without the margin for rounding."""
        return 1.0 - lam * (1.0 - lam) * (self.z[:, None] ** 2 / self.mixed(lam)).sum(axis=2)

    def scale(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Return delta2 plus the margin for rounding, so that sets in contact still intersect."""
        return np.maximum(self.delta2(lam), 0.0) + self.margin[:, None]

    def trace(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Trace of the shape for the scale 1."""
        n = self.B.shape[1]
        return ((self.B**2).sum(axis=1)[:, None] / self.mixed(lam)[:, :, :n]).sum(axis=2)

    def radius(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Return prod(t)^(-1/n); its product with the scale is a monotonic function of the volume."""
        n = self.B.shape[1]
        return np.exp(-np.log(self.mixed(lam)[:, :, :n]).sum(axis=2) / n)

    def mixed(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points p"]:
        """Return t."""
        return (1.0 - lam)[:, :, None] + lam[:, :, None] * self.g[:, None]


def _smallest(size: Callable[[Array], Array], n_runs: int) -> Float[Array, " runs"]:
    """Minimise a size over lam in [0, LAST] for each run, on successively finer grids around the best point."""
    low, high, rows = np.zeros(n_runs), np.full(n_runs, LAST), np.arange(n_runs)
    for _ in range(ROUNDS):
        points = low[:, None] + (high - low)[:, None] * SHARES
        best = size(points).argmin(axis=1)
        low, high = points[rows, np.maximum(best - 1, 0)], points[rows, np.minimum(best + 1, len(SHARES) - 1)]
    return points[rows, best]
