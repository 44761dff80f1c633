"""Mean and covariance of f(x) for a Gaussian x and a nonlinear f: by sigma points, or by central differences.

Every run has its own mean and its own root F of the covariance, P = F F'; the points of all runs are evaluated in one
call.  The result is the joint root of f(x) and x (numerics/square_root.py).

Points   x and x +- column j of sqrt(n + lam) F, n + lam = alpha^2 (n + kappa).  Weights of the mean: lam / (n + lam),
         others w = 1 / (2 (n + lam)); of the covariance: that of x plus 1 - alpha^2 + beta.
         With d_i = f(x_i) - f(x) and m = sum w d_i these weights give
             mean = f(x) + m,   covariance = sum w d_i d_i' + (beta - alpha^2) m m',
         which is sum w (d_i - t m) (d_i - t m)' with 2 n w t^2 - 2 t = beta - alpha^2.  In this form no weight of -1e6
         cancels digits when alpha is small, and the d_i - t m are the root.  t is complex where
         2 n w (alpha^2 - beta) > 1, which needs kappa < 0 or beta < 0: there the root is that of the sum, and the
         last term is left to the filter.
Differences  Column i of the Jacobian is [f(x + h_i) - f(x - h_i)] / (2 h_i); mean = f(x), covariance = J P J'.  With
         `spread` h_i = spread sqrt(P_ii): a step of one standard deviation can contain a jump, such as the end of
         sticking; a tiny one does not.  Without it h_i is 6e-6 of |x_i| or sqrt(P_ii), the larger one, where truncation
         and rounding are least: ten digits.
Bounds   Points stay inside the bounds of the states: each one, also the centre, is moved to the nearest state inside.
         Differences are divided by the distance that is left, and f(x) outside is that of the tangent.  Deviations of
         sigma points are those of the moved ones.  What they lack of P, where it is positive, is independent of f(x).
Angles   Differences of components of f(x) with a period are wrapped; a mean then is within half a period of f(x).
Limit    For a linear f both are exact.  alpha -> 0 gives the mean f(x) of the differences plus a term of order P.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.intervals import Interval
from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.numerics.square_root import covariance_of
from rmpc_bench.types import Array
from rmpc_bench.types.angles import wrapped

INDEFINITE = 1e-12
"""A P whose smallest eigenvalue is below minus this share of the largest is indefinite, not only rounded."""
SMALLEST_STEP = 1e-8
"""Shortest step of a difference relative to |x_i|: below it f(x + h) - f(x - h) has no correct digits."""
BEST_STEP = float(np.cbrt(np.finfo(float).eps))
"""Step of a difference relative to |x_i| or 1 where the standard deviation is zero: least sum of both errors."""

Means: TypeAlias = Float[Array, "runs n"]
Roots: TypeAlias = Float[Array, "runs n n"]
Map = Callable[[Float[Array, "runs points n"]], Float[Array, "runs points m"]]
"""A function of the points of every run."""


class Moments(NamedTuple):
    """Moments of f(x), and the joint root of f(x) and x."""

    mean: Float[Array, "runs m"]
    image: Float[Array, "runs m r"]
    """Rows of the joint root that belong to f(x); the covariance of f(x) is image image' - minus minus'."""
    source: Float[Array, "runs n r"]
    """Rows that belong to x; the covariance of x and f(x) is source image'."""
    minus: Float[Array, "runs m"] | None = None
    """A vector whose square is subtracted from the covariance of f(x); None unless weights make it necessary."""
    rest: Float[Array, "runs n n"] | None = None
    """Root of what `source` lacks of the covariance of x, 0 in a run without moved points; None without such a run."""


@dataclass(frozen=True)
class SigmaPoints:
    """Sigma points with the parameters of the unscented transform; the defaults are those of the cubature rule."""

    alpha: float = 1.0  # spread of the points
    beta: float = 0.0  # added weight of the centre in the covariance
    kappa: float = 0.0  # added to the number of states in the spread

    def moments(
        self, f: Map, x: Means, root: Roots, limits: Interval | None = None, period: Array | None = None
    ) -> Moments:
        """Return the moments of f(x), x with mean `x` and the root of its covariance, by points inside the limits.

        `period` is that of f(x).
        """
        n = x.shape[1]
        c = self.alpha**2 * (n + self.kappa)
        points, moved = _points(x, np.sqrt(c) * root.mT, limits)
        values = f(points)
        at_mean, d = values[:, 0], wrapped(values[:, 1:] - values[:, :1], period)
        m = 0.5 / c * np.einsum("rpi->ri", d)
        source = np.sqrt(0.5) * np.concatenate([root, -root], axis=2)
        less = self.alpha**2 - self.beta
        inside = 1.0 - n / c * less
        t = less / (1.0 + np.sqrt(inside)) if inside >= 0.0 else 0.0
        image = np.sqrt(0.5 / c) * np.ascontiguousarray((d - t * m[:, None]).mT)
        rest = None
        if moved.any():
            rest = np.zeros_like(root)
            source[moved] = np.sqrt(0.5 / c) * (points[moved, 1:] - points[moved, :1]).mT
            rest[moved] = covariance_root(covariance_of(root[moved]) - covariance_of(source[moved]))[0]
        return Moments(at_mean + m, image, source, None if inside >= 0.0 else np.sqrt(less) * m, rest)


@dataclass(frozen=True)
class CentralDifferences:
    """Linearisation by central differences."""

    spread: float | None = None  # step in standard deviations; None for the step with the least error of the derivative

    def moments(
        self, f: Map, x: Means, root: Roots, limits: Interval | None = None, period: Array | None = None
    ) -> Moments:
        """Return the moments of f(x) with f linearised at `x`; the root also sets the steps."""
        at_mean, J = self.slopes(f, x, np.sqrt(np.einsum("rij,rij->ri", root, root)), limits, period)
        inside = x if limits is None else np.clip(x, *limits)
        for i in np.flatnonzero((x != inside).any(axis=1)) if limits is not None else ():
            # The tangent goes on outside, so that a linear f is exact there, too.
            at_mean[i] += J[i] @ (x[i] - inside[i])
        return Moments(at_mean, J @ root, root)

    def slopes(
        self, f: Map, x: Means, deviation: Means, limits: Interval | None = None, period: Array | None = None
    ) -> tuple[Float[Array, "runs m"], Float[Array, "runs m n"]]:
        """Return f(x) and its Jacobian; x has the given standard deviations."""
        n, points = x.shape[1], self.points(x, deviation, limits)
        values = f(points)
        # The step that the rounded points really have; a state whose bounds are equal has none.
        step = np.einsum("rii->ri", points[:, 1 : n + 1] - points[:, n + 1 :])
        step = np.where(step == 0.0, 1.0, step)
        d = wrapped(values[:, 1 : n + 1] - values[:, n + 1 :], period)
        return values[:, 0], np.ascontiguousarray((d / step[:, :, None]).mT)

    def points(self, x: Means, deviation: Means, limits: Interval | None = None) -> Float[Array, "runs points n"]:
        """Return x, then x with a step up, then with a step down, in every state."""
        size = np.abs(x)
        if self.spread is None:
            size = np.maximum(size, deviation)
            h = BEST_STEP * np.where(size > 0.0, size, 1.0)
        else:
            h = self.spread * deviation
            h = np.where(h > SMALLEST_STEP * size, h, BEST_STEP * np.maximum(size, 1.0))
        return _points(x, h[:, :, None] * np.eye(x.shape[1]), limits)[0]


MomentRule: TypeAlias = SigmaPoints | CentralDifferences
"""Ways to compute the moments, both by 2 n + 1 points."""


def _points(
    x: Means, steps: Float[Array, "runs p n"], limits: Interval | None
) -> tuple[Float[Array, "runs points n"], Bool[Array, " runs"]]:
    """Return x, and x plus and minus every step, inside the limits, and in which runs a point has been moved there."""
    centre = x[:, None] if limits is None else np.clip(x, *limits)[:, None]
    free = np.concatenate([centre, centre + steps, centre - steps], axis=1)
    if limits is None:
        return free, np.zeros(len(x), dtype=bool)
    points = np.clip(free, *limits)
    return points, np.asarray((points != free).any(axis=(1, 2)) & ~np.isnan(free).any(axis=(1, 2)))


def covariance_root(P: Float[Array, "runs n n"]) -> tuple[Float[Array, "runs n n"], Bool[Array, " runs"]]:
    """Return S with S S' = P for every run, and whether P is indefinite: S is then the root of its positive part."""
    n, indefinite = P.shape[1], np.zeros(len(P), dtype=bool)
    finite: Array = np.asarray(np.isfinite(P).all(axis=(1, 2)))
    sound = P if finite.all() else np.where(finite[:, None, None], P, np.eye(n))
    try:
        root = np.linalg.cholesky(sound)
    except np.linalg.LinAlgError:
        root = np.empty_like(sound)
        for i, each in enumerate(sound):
            root[i], indefinite[i] = _root(each)
    root[~finite] = np.nan
    return root, indefinite


def _root(P: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], bool]:
    """Return the Cholesky factor, or the symmetric root of the positive part."""
    try:
        return np.linalg.cholesky(P), False
    except np.linalg.LinAlgError:
        lam, U = np.linalg.eigh(symmetrise(P))
    positive: Array = np.sqrt(np.maximum(lam, 0.0))
    return np.einsum("ij,j,kj->ik", U, positive, U), bool(lam[0] < -INDEFINITE * np.abs(lam).max())
