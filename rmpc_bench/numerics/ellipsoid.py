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

from rmpc_bench.numerics.linalg import as_covariance, mv
from rmpc_bench.types import Array, Matrix

Criterion: TypeAlias = Literal["trace", "volume"]

LAST = 1.0 - 1e-6
"""Largest share of a measurement: where it is best to forget the prediction, the size is 1e-6 above the least, and what
rounding does to directions that nothing is seen of counts a millionfold only."""
SHARES = np.linspace(0.0, 1.0, 17)
ROUNDS = 10
"""Rounds of a search, each 8 times finer than the one before: 1e-9 of the range, 1e-18 of the size around its least."""
MARGIN = 1e-12
"""What rounding may take from the scale of a set, which is made that much larger: sets that touch stay sets."""


def shape_of(value: Matrix | Array, n: int) -> Float[Array, "n n"]:
    """Expand a number (times the identity), a list (the diagonal) or a matrix to the shape matrix of an ellipsoid.

    Raises
    ------
    ValueError
        If the size does not fit, the matrix is not symmetric or an eigenvalue is negative.
    """
    return as_covariance(value, n)


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

    For every lam in [0, 1] these points obey (1 - lam) x' M^-1 x + lam (e - C x)' R^-1 (e - C x) <= 1.  A full square
    makes that an ellipsoid of shape delta2 X around G e: with T = (1 - lam) R + lam C M C',
    G = lam M C' T^-1,  X = (M - G C M) / (1 - lam),  delta2 = 1 - lam (1 - lam) e' T^-1 e,
    where delta2 < 0 for some lam if, and only if, there is no such point.  With R^-1/2 C M C' R^-1/2 = U diag(g) U' all
    lam cost sums over g only.

    Parameters
    ----------
    M : shapes of the first sets, singular ones included
    C, R : what is measured, and the regular shape of the set of its noise
    e : measurements minus what the centres of the first sets would give
    criterion : what shall be smallest, the trace of the shape or the volume
    """
    root = np.linalg.inv(np.linalg.cholesky(R))
    seen = np.einsum("rij,kj->rik", M, root @ C)
    g, U = np.linalg.eigh(np.einsum("ki,rij->rkj", root @ C, seen))
    g, N = np.maximum(g, 0.0), np.einsum("rik,rkj->rij", seen, U)
    z = np.einsum("rkj,rk->rj", U, mv(root, e))
    combined = _Combination(M, g, N, z)
    size = combined.trace if criterion == "trace" else combined.radius
    met = ~(combined.delta2(_smallest(combined.delta2, len(e))[:, None])[:, 0] < -MARGIN)
    lam = np.where(met, _smallest(lambda lam: combined.delta2(lam) * size(lam), len(e)), 0.0)
    H = N / ((1.0 - lam)[:, None] + lam[:, None] * g)[:, None, :]  # M C' T^-1 R^1/2 U
    rest = np.eye(M.shape[1]) - lam[:, None, None] * np.einsum("rij,rkj,kl->ril", H, U, root @ C)
    X = np.einsum("rik,rjk->rij", np.einsum("rij,rjk->rik", rest, M), rest) / (1.0 - lam)[:, None, None]
    X = X + lam[:, None, None] * np.einsum("rik,rjk->rij", H, H)  # Joseph form, which keeps X positive semidefinite
    scale = np.where(lam > 0.0, np.maximum(combined.delta2(lam[:, None])[:, 0], 0.0) + MARGIN, 1.0)
    centre = lam[:, None] * np.einsum("rij,rj->ri", H, z)
    return Intersection(centre, scale[:, None, None] * (0.5 * (X + X.mT)), lam, met)


class _Combination(NamedTuple):
    """The combinations of two sets, by what their sizes depend on; lam is (runs, points)."""

    M: Float[Array, "runs n n"]
    g: Float[Array, "runs m"]
    N: Float[Array, "runs n m"]
    z: Float[Array, "runs m"]

    def delta2(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Scale of X."""
        left: Array = 1.0 - lam * (1.0 - lam) * (self.z[:, None] ** 2 / self._mixed(lam)).sum(axis=2)
        return left

    def trace(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """Trace of X, as a sum of positive terms."""
        seen = np.divide((self.N**2).sum(axis=1), self.g, out=np.zeros_like(self.g), where=self.g > 0.0)
        unseen = np.maximum(np.einsum("rii->r", self.M) - seen.sum(axis=1), 0.0)
        total: Array = unseen[:, None] / (1.0 - lam) + (seen[:, None] / self._mixed(lam)).sum(axis=2)
        return total

    def radius(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points"]:
        """(det X / det M)^(1/n), which times delta2 grows as the volume does."""
        n, m = self.N.shape[1:]
        logs = (n - m) * np.log1p(-lam) + np.log(self._mixed(lam)).sum(axis=2)
        root: Array = np.exp(-logs / n)
        return root

    def _mixed(self, lam: Float[Array, "runs points"]) -> Float[Array, "runs points m"]:
        mixed: Array = (1.0 - lam)[:, :, None] + lam[:, :, None] * self.g[:, None]
        return mixed


def _smallest(size: Callable[[Array], Array], n_runs: int) -> Float[Array, " runs"]:
    """Find the lam in [0, LAST] at which a size is smallest, run by run: ever finer points around the best one."""
    low, high, rows = np.zeros(n_runs), np.full(n_runs, LAST), np.arange(n_runs)
    for _ in range(ROUNDS):
        points = low[:, None] + (high - low)[:, None] * SHARES
        best = size(points).argmin(axis=1)
        low, high = points[rows, np.maximum(best - 1, 0)], points[rows, np.minimum(best + 1, len(SHARES) - 1)]
    found: Array = points[rows, best]
    return found
