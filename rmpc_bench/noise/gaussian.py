"""Gaussian noise and laws made from it: half-normal noise, Student's t, and normal noise with outliers.

Model   `half-normal`  w = center + std |z| in every coordinate, z ~ N(0, 1), independent.
        `student-t`  w = mean + S t, S a root of the scale matrix, t = z / sqrt(c / dof), z ~ N(0, I), c ~
                     chi-squared(dof), one c per coordinate or one for the whole vector.
        `outliers`  w = mean + d, d ~ N(0, cov), with probability p factor d.  A sample is an outlier in all coordinates
                    or in none.
Moments `half-normal`  The mean is center + sqrt(2 / pi) std, the variance (1 - 2 / pi) std^2.
        `student-t`  Mean for dof > 1, covariance dof / (dof - 2) S S' for dof > 2; otherwise they do not exist.
        `outliers`  covariance (1 - p + p factor^2) cov.
Limit   `half-normal`  The distance from the center is the absolute value of `gaussian` with the same stream.  std = 0
                       in a coordinate is a constant.
        `student-t`  dof -> infinity is `gaussian`.
        `outliers`  p = 0 or factor = 1 is `gaussian`.
Streams `student-t`  z is that of `gaussian` with the same stream; c comes from a child of the generator.
        `outliers`  z is that of `gaussian` with the same stream.  Outliers come from a child of the generator, and
                    those of a smaller p are among those of a larger.
Source  `half-normal`  Rao, Rawlings, Lee, Automatica 37 (2001), where it is the process noise of a moving-horizon
                       estimator.
        `student-t`  Lange, Little and Taylor, JASA 84 (1989).
        `outliers`  Tukey, A survey of sampling from contaminated distributions (1960).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt
from typing import Annotated

import numpy as np
from annotated_types import Ge
from jaxtyping import Float

from rmpc_bench.noise.bursts import BurstyNoise, CenteredNoise, RandomBursts, Share, child_of, with_bursts
from rmpc_bench.numerics.linalg import as_covariance, as_vector, psd_sqrt, symmetrise
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import Array, DesignError, Matrix, NonNegative, Positive

EQUATION = {
    "gaussian": r"w \sim \mathcal{N}(\bar w, s^2 \Sigma)",
    "half_normal": r"w = c + s |z|, \quad z \sim \mathcal{N}(0, I)",
    "student_t": r"w = \bar w + s z \sqrt{\nu / \chi^2_\nu}, \quad z \sim \mathcal{N}(0, I)",
    "outliers": r"w = \bar w + f^b z, \quad z \sim \mathcal{N}(0, s^2 \Sigma), \quad b \sim \mathrm{Bernoulli}(p)",
}


@dataclass(frozen=True, eq=False)
class FromNormal(CenteredNoise):
    """Noise that is made from root z with z ~ N(0, I)."""

    mean: Float[Array, " n"]
    root: Float[Array, "n n"]

    def normal(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Draw root z of one run."""
        return self.shaped(rng.standard_normal((n_samples, len(self.mean))))

    def shaped(self, z: Float[Array, "samples n"]) -> Float[Array, "samples n"]:
        """Return root z; the sums of a sample do not depend on the number of samples."""
        return np.einsum("ij,kj->ki", self.root, z)


@dataclass(frozen=True, eq=False)
class Gaussian(FromNormal):
    """Normal noise mean + root z."""

    cov = property(lambda self: self.root @ self.root.T)
    deviation = FromNormal.normal


@dataclass(frozen=True, eq=False)
class HalfNormal(CenteredNoise):
    """Noise center + std |z|."""

    center: Float[Array, " n"]
    std: Float[Array, " n"]

    @property
    def mean(self) -> Float[Array, " n"]:
        """Mean of the noise."""
        return self.center + sqrt(2.0 / pi) * self.std

    @property
    def cov(self) -> Float[Array, "n n"]:
        """Covariance of the noise."""
        return np.diag((1.0 - 2.0 / pi) * self.std**2)

    def deviation(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run without its center."""
        return self.std * np.abs(rng.standard_normal((n_samples, len(self.center))))


@dataclass(frozen=True, eq=False)
class StudentT(CenteredNoise):
    """Student's t noise center + root t."""

    center: Float[Array, " n"]
    root: Float[Array, "n n"]
    dof: float
    joint: bool
    """Whether all coordinates of a sample share one chi-squared number."""
    n_children = 1

    @property
    def mean(self) -> Float[Array, " n"] | None:
        """Mean of the noise; None for dof = 1, where it does not exist."""
        return self.center if self.dof > 1.0 else None

    @property
    def cov(self) -> Float[Array, "n n"] | None:
        """Covariance of the noise; None for dof <= 2, where it is infinite."""
        return symmetrise(self.dof / (self.dof - 2.0) * self.root @ self.root.T) if self.dof > 2.0 else None

    def deviation(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run without its center."""
        z = rng.standard_normal((n_samples, len(self.center)))
        c = child_of(rng, 0).chisquare(self.dof, (n_samples, 1 if self.joint else len(self.center)))
        return np.einsum("ij,kj->ki", self.root, z / np.sqrt(c / self.dof))


@dataclass(frozen=True, eq=False)
class ContaminatedNormal(FromNormal):
    """Normal noise whose deviation from the mean is multiplied by a factor at random samples."""

    probability: float
    factor: float
    n_children = 1

    @property
    def cov(self) -> Float[Array, "n n"]:
        """Covariance of the noise."""
        power = 1.0 - self.probability + self.probability * self.factor**2
        return symmetrise(power * self.root @ self.root.T)

    def deviation(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run without its mean."""
        normal = self.normal(rng, n_samples)
        gain = np.where(child_of(rng, 0).random(n_samples) < self.probability, self.factor, 1.0)
        return gain[:, None] * normal


def spread_root(
    n: int, std: float | list[float] | None, cov: Matrix | Array | None, names: tuple[str, str] = ("std", "cov")
) -> Float[Array, "n n"]:
    """Root of a covariance that is given by standard deviations, one or n, or as `matrix` expands it.

    Raises a DesignError, with the keys, if both or none are given, or a size does not fit.
    """
    if (std is None) == (cov is None):
        raise DesignError(f"give either {names[0]} or {names[1]}")
    if std is not None:
        return np.diag(as_vector(std, n, names[0]))
    assert cov is not None
    return psd_sqrt(as_covariance(cov, n, names[1]))


def gaussian(
    n: int,
    Ts: Positive = 1.0,
    sampled: Callable[[Array], Array] | None = None,
    *,
    mean: float | list[float] = 0.0,
    std: NonNegative | list[NonNegative] | None = None,
    cov: Matrix | Array | None = None,
    density: Matrix | None = None,
    scale: NonNegative = 1.0,
    bursts: list[Burst] | RandomBursts | None = None,
) -> Gaussian | BurstyNoise:
    """Normal noise; give std, cov or density.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s], for bursts
    sampled : spectral density -> covariance of a sample, of the plant's channel
    mean : mean of the noise
    std : standard deviation
    cov : covariance
    density : spectral density of white noise of x' or of y of a continuous plant, as that of `noise` of design models
    scale : factor on the standard deviation
    bursts : time intervals of larger noise, as in `uniform`

    Raises
    ------
    DesignError
        If not one of std, cov and density is given, a size does not fit, or a burst does not fit into its window.
    """
    if density is not None:
        if std is not None or cov is not None:
            raise DesignError("give one of std, cov and density", "density")
        if sampled is None:
            raise DesignError("density needs a continuous plant", "density")
        cov = sampled(as_covariance(density, n, "density"))
    elif (std is None) == (cov is None):
        raise DesignError("give one of std, cov and density")
    root = scale * spread_root(n, std, cov)
    return with_bursts(Gaussian(as_vector(mean, n, "mean"), root), bursts, Ts)


def half_normal(
    n: int,
    Ts: Positive = 1.0,
    *,
    std: NonNegative | list[NonNegative],
    center: float | list[float] = 0.0,
    scale: NonNegative = 1.0,
    bursts: list[Burst] | RandomBursts | None = None,
) -> HalfNormal | BurstyNoise:
    """Half-normal noise: never below its center.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s], for bursts
    std : standard deviation of the normal noise
    center : lower end of the noise
    scale : factor on std
    bursts : time intervals of larger noise, as in `uniform`

    Raises
    ------
    DesignError
        If a size does not fit, or a burst does not fit into its window.
    """
    steady = HalfNormal(as_vector(center, n, "center"), scale * as_vector(std, n, "std"))
    return with_bursts(steady, bursts, Ts)


def student_t(
    n: int,
    Ts: Positive = 1.0,
    *,
    dof: Annotated[float, Ge(1)],
    scale: NonNegative | list[NonNegative] | None = None,
    scale_matrix: Matrix | Array | None = None,
    mean: float | list[float] = 0.0,
    joint: bool = False,
    bursts: list[Burst] | RandomBursts | None = None,
) -> StudentT | BurstyNoise:
    """Student's t noise; give either scale or scale_matrix.

    Its standard deviation is sqrt(dof / (dof - 2)) times the scale, infinite for dof <= 2.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s], for bursts
    dof : degrees of freedom; 1 is the Cauchy law, which has no mean
    scale : scale of a coordinate
    scale_matrix : scale matrix, of which `scale` is the root
    mean : mean of the noise
    joint : whether the coordinates of a sample are large together (multivariate t) or independent before the scale
        matrix is applied
    bursts : time intervals of larger noise, as in `uniform`

    Raises
    ------
    DesignError
        If both or none of scale and scale_matrix are given, a size does not fit, or a burst does not fit into its
        window.
    """
    root = spread_root(n, scale, scale_matrix, ("scale", "scale_matrix"))
    return with_bursts(StudentT(as_vector(mean, n, "mean"), root, dof, joint), bursts, Ts)


def outliers(
    n: int,
    Ts: Positive = 1.0,
    *,
    probability: Share,
    factor: NonNegative,
    std: NonNegative | list[NonNegative] | None = None,
    cov: Matrix | Array | None = None,
    mean: float | list[float] = 0.0,
    scale: NonNegative = 1.0,
    bursts: list[Burst] | RandomBursts | None = None,
) -> ContaminatedNormal | BurstyNoise:
    """Normal noise with outliers (contaminated normal); give either std or cov.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s], for bursts
    probability : probability of an outlier
    factor : factor on the deviation of an outlier from the mean
    std : standard deviation of the other samples
    cov : covariance of the other samples
    mean : mean of the noise
    scale : factor on the standard deviation
    bursts : time intervals of larger noise, as in `uniform`

    Raises
    ------
    DesignError
        If both or none of std and cov are given, a size does not fit, or a burst does not fit into its window.
    """
    root = scale * spread_root(n, std, cov)
    return with_bursts(ContaminatedNormal(as_vector(mean, n, "mean"), root, probability, factor), bursts, Ts)
