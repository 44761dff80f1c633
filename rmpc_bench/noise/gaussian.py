"""Gaussian noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.noise.bursts import BurstyNoise, CenteredNoise, RandomBursts, with_bursts
from rmpc_bench.noise.parameters import spread_root
from rmpc_bench.numerics.linalg import as_vector
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import Array, Matrix, NonNegative, Positive


@dataclass(frozen=True, eq=False)
class Gaussian(CenteredNoise):
    """Normal noise mean + root z with z ~ N(0, I)."""

    mean: Float[Array, " n"]
    root: Float[Array, "n n"]

    @property
    def center(self) -> Float[Array, " n"]:
        """The mean."""
        return self.mean

    @property
    def cov(self) -> Float[Array, "n n"]:
        """Covariance of the noise."""
        return self.root @ self.root.T

    def deviation(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run without its mean."""
        return self.shaped(rng.standard_normal((n_samples, len(self.mean))))

    def shaped(self, z: Float[Array, "samples n"]) -> Float[Array, "samples n"]:
        """Return root z; the sums of a sample do not depend on the number of samples."""
        deviation: Array = np.einsum("ij,kj->ki", self.root, z)
        return deviation


def gaussian(
    n: int,
    Ts: Positive = 1.0,
    *,
    mean: float | list[float] = 0.0,
    std: NonNegative | list[NonNegative] | None = None,
    cov: Matrix | Array | None = None,
    scale: NonNegative = 1.0,
    bursts: list[Burst] | RandomBursts | None = None,
) -> Gaussian | BurstyNoise:
    """Normal noise; give either std or cov.

    Parameters
    ----------
    n : dimension
    Ts : sampling time [s], for bursts
    mean : a number (in every coordinate) or one per coordinate
    std : standard deviation, a number or one per coordinate
    cov : covariance: a number (times the identity), a diagonal or a matrix
    scale : factor on the standard deviation
    bursts : time intervals in which the deviation from the mean is larger, as in `uniform`

    Raises
    ------
    DesignError
        If both or none of std and cov are given, a size does not fit, or a burst does not fit into its window.
    """
    root = scale * spread_root(n, std, cov)
    return with_bursts(Gaussian(as_vector(mean, n, "mean"), root), bursts, Ts)
