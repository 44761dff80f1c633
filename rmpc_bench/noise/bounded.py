"""Bounded noise: uniform in a box, at the corners of a box, and laws for an ellipsoid.

Model   `uniform`  w = center + L u, L = mix diag(radius), u uniform in the box [-1, 1]^n.
        `corners`  w = center + L u, L = diag(radius), u at a corner of the box [-1, 1]^n.
        `ellipsoid`  w = center + L u, u in the unit ball, L a root of the shape matrix M: (w - center)' M^-1 (w -
                     center) <= 1.  A singular M gives a flat ellipsoid.
Source  `ellipsoid`  ma2025, (1), (74), (75); Section V for the skewed cube.
Limit   `ellipsoid`  With skew 1/2 and outside `reject` is uniform in the ellipsoid.
Sums    {sum: [{gaussian: {cov: 0.25}}, {ellipsoid: {shape: 5}}]} adds noises, each with a random stream.
Bursts  make the law depend on k, without moments `mean` and `cov`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.noise.bursts import BurstyNoise, CenteredNoise, RandomBursts, Share, with_bursts
from rmpc_bench.numerics.linalg import as_covariance, as_matrix, as_vector, psd_sqrt, symmetrise
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import Array, DesignError, Matrix, NonNegative, Positive

EQUATION = {
    "corners": r"w = c + \mathrm{diag}(\rho) u, \quad u_i = \pm 1",
    "ellipsoid": r"w = c + s L u, \quad L L^\top = M, \quad (w - c)^\top M^{-1} (w - c) \le s^2",
    "uniform": r"w = c + T \mathrm{diag}(\rho) u, \quad u_i \sim \mathcal{U}(-1, 1)",
}
SKEW = 0.9
"""Share of positive coordinates in ma2025."""
SINGULAR = 1e-12
"""A smallest eigenvalue below this share of the largest is a rounding of 0."""


# Laws of random points in a box, a ball or a cube around 0, from which the noise is made.


class PointMoments(NamedTuple):
    """First two moments of a point."""

    mean: Float[Array, " n"]
    cov: Float[Array, "n n"]


class Points(ABC):
    """A law of points in n dimensions."""

    n_children = 0
    """Number of children of the generator that `draw` uses."""

    @abstractmethod
    def draw(self, rng: np.random.Generator, n_samples: int, n: int) -> Float[Array, "samples n"]:
        """Draw points; a longer draw begins with the points of a shorter one."""

    def moments(self, n: int) -> PointMoments | None:
        """Mean and covariance of a point; None where there is no closed form."""
        return None


@dataclass(frozen=True)
class Box(Points):
    """Uniform in [-1, 1]^n."""

    def draw(self, rng: np.random.Generator, n_samples: int, n: int) -> Float[Array, "samples n"]:
        """Points one by one."""
        return 2.0 * rng.random((n_samples, n)) - 1.0

    def moments(self, n: int) -> PointMoments:
        """Mean and covariance of a point."""
        return PointMoments(np.zeros(n), np.eye(n) / 3.0)


@dataclass(frozen=True)
class Corners(Points):
    """Corners of [-1, 1]^n, all equally likely."""

    def draw(self, rng: np.random.Generator, n_samples: int, n: int) -> Float[Array, "samples n"]:
        """Points one by one; the signs are those of `Box` with the same generator."""
        return np.where(rng.random((n_samples, n)) < 0.5, -1.0, 1.0)

    def moments(self, n: int) -> PointMoments:
        """Mean and covariance of a point."""
        return PointMoments(np.zeros(n), np.eye(n))


@dataclass(frozen=True)
class Ball(Points):
    """Uniform in the unit ball."""

    def draw(self, rng: np.random.Generator, n_samples: int, n: int) -> Float[Array, "samples n"]:
        """Points one by one: n coordinates of a random direction in n + 2 dimensions are uniform in the ball."""
        g = rng.standard_normal((n_samples, n + 2))
        return g[:, :n] / _lengths(g)

    def moments(self, n: int) -> PointMoments:
        """Mean and covariance of a point."""
        return PointMoments(np.zeros(n), np.eye(n) / (n + 2))


@dataclass(frozen=True)
class SkewedCube(Points):
    """Every coordinate uniform on (0, 1) with probability `skew`, else on (-1, 0)."""

    skew: float

    def draw(self, rng: np.random.Generator, n_samples: int, n: int) -> Float[Array, "samples n"]:
        """Draw points; another skew changes signs but not the absolute values."""
        modulus, sign = np.moveaxis(rng.random((n_samples, 2, n)), 1, 0)
        return np.where(sign < self.skew, modulus, -modulus)

    def moments(self, n: int) -> PointMoments:
        """Mean and covariance of a point."""
        mean = (2.0 * self.skew - 1.0) / 2.0
        return PointMoments(np.full(n, mean), (1.0 / 3.0 - mean**2) * np.eye(n))


@dataclass(frozen=True)
class ProjectedCube(Points):
    """The skewed cube with all points outside the unit ball projected radially onto the sphere.

    There is no closed form of the moments for every n.
    """

    cube: SkewedCube

    def draw(self, rng: np.random.Generator, n_samples: int, n: int) -> Float[Array, "samples n"]:
        """Points one by one, those of the cube where they are inside."""
        u = self.cube.draw(rng, n_samples, n)
        return u / np.maximum(_lengths(u), 1.0)


@dataclass(frozen=True)
class RejectedCube(Points):
    """The skewed cube, drawn again until the point is inside the unit ball: uniform there, except for the signs."""

    cube: SkewedCube
    n_children = 1

    def draw(self, rng: np.random.Generator, n_samples: int, n: int) -> Float[Array, "samples n"]:
        """Points one by one, those of the cube where they are inside.

        In many dimensions almost all points of a cube are outside the unit ball, so that rejection would need too many
        draws.  Its result has the distribution of a uniform point of the ball with the signs of the cube.  This point
        has its own random stream, so that it does not depend on the number of earlier points outside the ball.
        """
        u = self.cube.draw(rng, n_samples, n)
        inside = Ball().draw(rng.spawn(1)[0], n_samples, n)
        return np.where(_lengths(u) <= 1.0, u, np.copysign(inside, u))

    def moments(self, n: int) -> PointMoments:
        """Mean and covariance of a point: its signs and the moduli of a uniform one are independent."""
        balance = 2.0 * self.cube.skew - 1.0  # mean of a sign
        # Modulus of a coordinate: n / (n + 1), the mean radius, times that of a random direction.
        direction = math.exp(math.lgamma(0.5 * n) - math.lgamma(0.5 * (n + 1))) / math.sqrt(math.pi)
        mean = balance * n / (n + 1) * direction
        second = np.full((n, n), balance**2 * 2.0 / (math.pi * (n + 2)))
        np.fill_diagonal(second, 1.0 / (n + 2))
        return PointMoments(np.full(n, mean), second - mean**2)


def _lengths(u: Float[Array, "samples n"]) -> Float[Array, "samples 1"]:
    return np.sqrt(np.einsum("ki,ki->k", u, u))[:, None]


@dataclass(frozen=True, eq=False)
class BoundedNoise(CenteredNoise):
    """Noise center + factor u; its mean is `center` only if the mean of u is 0."""

    center: Float[Array, " n"]
    factor: Float[Array, "n n"]
    points: Points

    n_children = property(lambda self: self.points.n_children)

    @property
    def mean(self) -> Float[Array, " n"] | None:
        """Mean of the noise; None where it is not known."""
        known = self.points.moments(len(self.center))
        return None if known is None else self.center + self.factor @ known.mean

    @property
    def cov(self) -> Float[Array, "n n"] | None:
        """Covariance of the noise; None where it is not known."""
        known = self.points.moments(len(self.center))
        return None if known is None else symmetrise(self.factor @ known.cov @ self.factor.T)

    def deviation(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run without its center."""
        u = np.ascontiguousarray(self.points.draw(rng, n_samples, len(self.center)))
        return np.einsum("ij,kj->ki", self.factor, u)


def uniform(
    n: int,
    Ts: Positive = 1.0,
    *,
    radius: NonNegative | list[NonNegative],
    center: float | list[float] = 0.0,
    mix: Matrix | Array | None = None,
    bursts: list[Burst] | RandomBursts | None = None,
) -> BoundedNoise | BurstyNoise:
    """Noise center + mix diag(radius) u, where the coordinates of u are independent and uniform in [-1, 1].

    Without `mix` the noise is uniform between center - radius and center + radius.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s], for bursts
    radius : half-width of the box
    center : centre of the box
    mix : matrix that correlates the coordinates; the identity if not given
    bursts : time intervals in which the deviation from the centre is multiplied by `factor` (overlapping ones
        multiply): {from: 3.4, to: 4.0, factor: 2} (seconds, ends included), the same in every run, or random ones,
        {within: [[1, 3.8], [4.6, 7]], duration: [0.3, 0.8], factor: [1.5, 3]}

    Raises
    ------
    DesignError
        If a size does not fit, or a burst does not fit into its window.
    """
    factor = np.diag(as_vector(radius, n, "radius"))
    if mix is not None:
        factor = as_matrix(mix, n, "mix") @ factor
    return with_bursts(BoundedNoise(as_vector(center, n, "center"), factor, Box()), bursts, Ts)


def corners(
    n: int,
    Ts: Positive = 1.0,
    *,
    radius: NonNegative | list[NonNegative],
    center: float | list[float] = 0.0,
    bursts: list[Burst] | RandomBursts | None = None,
) -> BoundedNoise | BurstyNoise:
    """Noise at a corner of a box, center - radius or center + radius in every coordinate, all equally likely.

    It tests a law that is designed for all noises in a box.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s], for bursts
    radius : half-width of the box
    center : centre of the box
    bursts : time intervals of larger noise, as in `uniform`

    Raises
    ------
    DesignError
        If a size does not fit, or a burst does not fit into its window.
    """
    factor = np.diag(as_vector(radius, n, "radius"))
    return with_bursts(BoundedNoise(as_vector(center, n, "center"), factor, Corners()), bursts, Ts)


def ellipsoid(
    n: int,
    Ts: Positive = 1.0,
    *,
    shape: Matrix | Array,
    law: Literal["uniform", "skewed-cube"] = "uniform",
    root: Literal["symmetric", "lower", "upper"] = "symmetric",
    outside: Literal["keep", "project", "reject"] = "keep",
    center: float | list[float] = 0.0,
    skew: Share = SKEW,
    scale: NonNegative = 1.0,
    bursts: list[Burst] | RandomBursts | None = None,
) -> BoundedNoise | BurstyNoise:
    """Noise center + scale L u for an ellipsoid with the shape matrix M, where L is a root of M.

    `uniform`: u is uniform in the unit ball.  `skewed-cube` (ma2025, Section V): every coordinate of u is uniform on
    (0, 1) with probability `skew`, else on (-1, 0).  Corners of the cube are outside the unit ball: the noise may leave
    the ellipsoid, see `outside`.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s], for bursts
    shape : M, positive semidefinite
    law : distribution of u
    root : root L: `symmetric` (L L = M), `lower` (Cholesky, L L' = M), or `upper`, the R with R' R = M of MATLAB's chol
        as if it were L; R R' differs from M, and the noise may leave the ellipsoid
    outside : what becomes of a u of the skewed cube outside the unit ball: `keep` it (as in ma2025), `project` it
        radially onto the sphere (moments unknown), or `reject` it and draw again; the others are the same
    center : centre of the ellipsoid
    skew : probability of a positive coordinate of the skewed cube
    scale : factor on L
    bursts : time intervals of larger noise, as in `uniform`

    Raises
    ------
    DesignError
        If a size does not fit, the shape is not positive semidefinite, a Cholesky factor of a singular shape is
        required, `outside` or `skew` is given for the uniform law, or a burst does not fit into its window.
    """
    M = as_covariance(shape, n, "shape")
    factor, middle, points = scale * _root(M, root), as_vector(center, n, "center"), _points(n, law, outside, skew)
    return with_bursts(BoundedNoise(middle, factor, points), bursts, Ts)


def _points(n: int, law: str, outside: str, skew: float) -> Points:
    if law == "uniform":
        for name, given in (("outside", outside != "keep"), ("skew", skew != SKEW)):
            if given:
                raise DesignError("can only be given with law: skewed-cube", name)
        return Ball()
    cube = SkewedCube(skew)
    if outside == "keep" or n == 1:  # in one dimension the cube is the ball
        return cube
    return RejectedCube(cube) if outside == "reject" else ProjectedCube(cube)


def _root(M: Float[Array, "n n"], kind: str) -> Float[Array, "n n"]:
    if kind == "symmetric":
        return psd_sqrt(M)
    lam = np.linalg.eigvalsh(M)
    if lam[0] <= SINGULAR * lam[-1]:
        raise DesignError(f"the shape is singular and has a symmetric root only (got {kind!r})", "root")
    lower: Array = np.linalg.cholesky(M)
    return lower if kind == "lower" else lower.T
