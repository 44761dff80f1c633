"""Laws of random points in a box, a ball or a cube around 0, from which bounded noise is made."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array


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
