"""Half-normal noise: the absolute value of normal noise, on one side of a bound.

Model   w = center + std |z| in every coordinate, z ~ N(0, 1), independent.
Moments The mean is center + sqrt(2 / pi) std, the variance (1 - 2 / pi) std^2.
Limit   The distance from the center is the absolute value of `gaussian` with the same stream.  std = 0 in a coordinate
        is a constant.
Source  Rao, Rawlings, Lee, Automatica 37 (2001), where it is the process noise of a moving-horizon estimator.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from jaxtyping import Float

from rmpc_bench.noise.bursts import BurstyNoise, CenteredNoise, RandomBursts, with_bursts
from rmpc_bench.numerics.linalg import as_vector
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import Array, NonNegative, Positive

EQUATION = r"w = c + s |z|, \quad z \sim \mathcal{N}(0, I)"


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
