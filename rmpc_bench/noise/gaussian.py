"""Gaussian noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.noise.bursts import BurstyNoise, CenteredNoise, RandomBursts, with_bursts
from rmpc_bench.noise.parameters import spread_root
from rmpc_bench.numerics.linalg import as_covariance, as_vector
from rmpc_bench.numerics.sample_times import Burst
from rmpc_bench.types import Array, DesignError, Matrix, NonNegative, Positive

EQUATION = r"w \sim \mathcal{N}(\bar w, s^2 \Sigma)"


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


class Gaussian(FromNormal):
    """Normal noise mean + root z."""

    cov = property(lambda self: self.root @ self.root.T)
    deviation = FromNormal.normal


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
