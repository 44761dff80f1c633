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
"""Largest weight of a measurement; the prediction keeps at least a millionth, so that unmeasured directions stay
finite."""
SHARES = np.linspace(0.0, 1.0, 17)
ROUNDS = 10
"""Rounds of a search, each 8 times finer than the one before: 1e-9 of the range, 1e-18 of the size around its least."""
SLACK = 8.0
"""Roundings per term of a sum for which sets are made larger; of states on the surfaces, 0.5 lost some, 1 none."""


def weight(M1: Float[Array, "n n"], M2: Float[Array, "n n"]) -> float:
    """Return p = sqrt(tr M1 / tr M2), with which the ellipsoid around a sum is smallest; 0 and inf if one is a point.

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
    total: Array = (1.0 + 1.0 / p) * M1 + (1.0 + p) * M2
    return total


def sum_shapes(M1: Float[Array, "runs n n"], M2: Float[Array, "n n"]) -> Float[Array, "runs n n"]:
    """Return `sum_shape` for one M1 per run."""
    first, second = np.sqrt(np.maximum(np.einsum("rii->r", M1), 0.0)), sqrt(max(M2.trace(), 0.0))
    if second == 0.0:
        return M1
    inverse = np.divide(second, first, out=np.zeros_like(first), where=first > 0.0)
    total: Array = (1.0 + inverse)[:, None, None] * M1 + (1.0 + first / second)[:, None, None] * M2
    return total


@cache
def confidence(level: float, n: int) -> float:
    """Return the quantile of chi-square: n Gaussian numbers with covariance P lie in E(0, c P) at this level."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(n / 2.0, level))


class Intersection(NamedTuple):
    """Ellipsoids around what two sets have in common, one per run."""

    centre: Float[Array, "runs n"]
    """Where the centre is, seen from that of the first set."""
    M: Float[Array, "runs n n"]
    lam: Float[Array, " runs"]
    """Share of the second set in the combination; 0 keeps the first one."""
    met: Bool[Array, " runs"]
    """Whether the sets have a point in common; where not, the first set is kept."""


def intersection(
    M: Float[Array, "runs n n"],
    C: Float[Array, "m n"],
    R: Float[Array, "m m"],
    e: Float[Array, "runs m"],
    criterion: Criterion = "trace",
) -> Intersection:
    """Enclose the points x with x' M^-1 x <= 1 and (e - C x)' R^-1 (e - C x) <= 1 by their smallest combination.

    With M = F F', R^-1/2 C F = U diag(s) W' and z = U' R^-1/2 e, these are the points x = F W xi with |xi| <= 1 and
    |z - s xi| <= 1, whatever the rank of M or C.  For every lam in [0, 1] they obey
    (1 - lam) |xi|^2 + lam |z - s xi|^2 <= 1.  A full square makes that an ellipsoid of shape delta2 diag(1 / t) around
    lam s z / t: with t = 1 - lam + lam s^2,  delta2 = 1 - lam (1 - lam) sum(z^2 / t),
    where delta2 < 0 for some lam if, and only if, there is no such point.

    The set is enlarged to account for rounding.  F F' and the root of R are enlarged, see `_root`.  Relative rounding
    eps of C F, e and the singular values changes z - s xi by eps times `reach`, the size of their products, which is
    added to the scale.  The rounding of the centre remains: x may be outside by about 1e-13 of the half-widths
    sqrt(M_ii) of the first set.

    Parameters
    ----------
    M : shapes of the first sets, singular ones included
    C, R : what is measured, and the regular shape of the set of its noise
    e : measurements minus what the centres of the first sets would give
    criterion : what shall be smallest, the trace of the shape or the volume
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
    """Return what rounding may take from the eigenvalues of a matrix with a diagonal of ones."""
    return SLACK * n * n * EPS


def _root(M: Float[Array, "*runs n n"]) -> tuple[Float[Array, "*runs n n"], Float[Array, "*runs n n"]]:
    """Return F with F F' = M + slack diag(M), so that rounding takes nothing from the set, and its inverse.

    A set that is flat becomes one about 1e-7 of its half widths thick; only an entry of x that is known stays so, and
    has zeros in the inverse.
    """
    half = np.sqrt(np.maximum(np.einsum("...ii->...i", M), 0.0))
    inverse = np.divide(1.0, half, out=np.zeros_like(half), where=half > 0.0)
    d, V = np.linalg.eigh(inverse[..., :, None] * M * inverse[..., None, :])
    d = np.sqrt(np.maximum(d, 0.0) + _slack(M.shape[-1]))[..., None, :]
    return half[..., None] * V * d, (inverse[..., None] * V / d).mT


def _padded(values: Float[Array, "runs k"], size: int) -> Float[Array, "runs size"]:
    return np.pad(values, ((0, 0), (0, size - values.shape[1])))


class _Combination(NamedTuple):
    """The combinations of two sets, by what their sizes depend on; lam is (runs, points)."""

    B: Float[Array, "runs n n"]
    """F W, by which xi becomes x."""
    g: Float[Array, "runs p"]
    """Squares of s; with z, filled up with zeros to the larger one of n and m."""
    z: Float[Array, "runs p"]
    margin: Float[Array, " runs"]

    def delta2(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Scale of diag(1 / t), without rounding."""
        left: Array = 1.0 - lam * (1.0 - lam) * (self.z[:, None] ** 2 / self.mixed(lam)).sum(axis=2)
        return left

    def scale(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Return delta2 with what rounding may have taken from it: sets that touch stay sets."""
        enough: Array = np.maximum(self.delta2(lam), 0.0) + self.margin[:, None]
        return enough

    def trace(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Trace of the shape for the scale 1."""
        n = self.B.shape[1]
        total: Array = ((self.B**2).sum(axis=1)[:, None] / self.mixed(lam)[:, :, :n]).sum(axis=2)
        return total

    def radius(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Return prod(t)^(-1/n), which times the scale grows as the volume does."""
        n = self.B.shape[1]
        root: Array = np.exp(-np.log(self.mixed(lam)[:, :, :n]).sum(axis=2) / n)
        return root

    def mixed(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points p"]:
        """Return t."""
        t: Array = (1.0 - lam)[:, :, None] + lam[:, :, None] * self.g[:, None]
        return t


def _smallest(size: Callable[[Array], Array], n_runs: int) -> Float[Array, " runs"]:
    """Find the lam in [0, LAST] at which a size is smallest, run by run: ever finer points around the best one."""
    low, high, rows = np.zeros(n_runs), np.full(n_runs, LAST), np.arange(n_runs)
    for _ in range(ROUNDS):
        points = low[:, None] + (high - low)[:, None] * SHARES
        best = size(points).argmin(axis=1)
        low, high = points[rows, np.maximum(best - 1, 0)], points[rows, np.minimum(best + 1, len(SHARES) - 1)]
    found: Array = points[rows, best]
    return found
