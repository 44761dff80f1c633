"""Heavy-tailed noise: Student's t, and normal noise with outliers.

Model   `student-t`  w = mean + S t, S a root of the scale matrix, t = z / sqrt(c / dof), z ~ N(0, I), c ~
                     chi-squared(dof), one c per coordinate or one for the whole vector.
        `outliers`  w = mean + d, d ~ N(0, cov), with probability p factor d.  A sample is an outlier in all coordinates
                    or in none.
Moments `student-t`  Mean for dof > 1, covariance dof / (dof - 2) S S' for dof > 2; otherwise they do not exist.
        `outliers`  covariance (1 - p + p factor^2) cov.
Limit   `student-t`  dof -> infinity is `gaussian`.
        `outliers`  p = 0 or factor = 1 is `gaussian`.
Streams z is that of `gaussian` with the same stream.
        `student-t`  c comes from a child of the generator.
        `outliers`  Outliers come from a child of the generator, and those of a smaller p are among those of a larger.
Source  `student-t`  Lange, Little and Taylor, JASA 84 (1989).
        `outliers`  Tukey, A survey of sampling from contaminated distributions (1960).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge
from jaxtyping import Float

from rmpc_bench.noise.bursts import BurstyNoise, CenteredNoise, RandomBursts, child_of, with_bursts
from rmpc_bench.noise.gaussian import FromNormal
from rmpc_bench.noise.parameters import Share, spread_root
from rmpc_bench.numerics.linalg import as_vector, symmetrise
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import Array, Matrix, NonNegative, Positive

EQUATION = {
    "student_t": r"w = \bar w + s z \sqrt{\nu / \chi^2_\nu}, \quad z \sim \mathcal{N}(0, I)",
    "outliers": r"w = \bar w + f^b z, \quad z \sim \mathcal{N}(0, s^2 \Sigma), \quad b \sim \mathrm{Bernoulli}(p)",
}


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
