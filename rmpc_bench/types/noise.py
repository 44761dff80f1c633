"""Base class of noise laws."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types.attribute import attribute
from rmpc_bench.types.basics import Array


class Noise:
    """A law of n-dimensional noise, independent over time.

    A subclass gives the method `draw`.  Everything else has a default.
    """

    @attribute
    def mean(self) -> Float[Array, " n"] | None:
        """Mean of the noise; None where it is not known or depends on k."""
        return None

    @attribute
    def cov(self) -> Float[Array, "n n"] | None:
        """Covariance of the noise; None where it is not known or depends on k."""
        return None

    @attribute
    def has_bursts(self) -> bool:
        """Whether the noise is larger in some intervals of time."""
        return False

    @attribute
    def burst_names(self) -> tuple[str, ...]:
        """Names of the random numbers that place the bursts of a run; none where all runs have the same bursts."""
        return ()

    def draw(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run; a longer draw begins with the shorter one."""
        raise NotImplementedError("draw")

    def burst_values(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Values of `burst_names` in one run, from the fresh generator that `draw` takes."""
        return {}

    def in_burst(self, rng: np.random.Generator, n_samples: int) -> Bool[Array, " samples"]:
        """Whether a sample of one run is in a burst, from the fresh generator that `draw` takes."""
        return np.zeros(n_samples, dtype=bool)
