"""Base classes of signals from outside: noise laws, references, input signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types.basics import Array, attribute


class Noise:
    """A law of n-dimensional noise; most add to a signal, and some alter it.

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
    def is_white(self) -> bool:
        """Whether samples at different k are independent; otherwise `mean` and `cov` are those of one sample."""
        return True

    @attribute
    def alters_output(self) -> bool:
        """Whether the law alters a measurement, by `altered`, and adds nothing to it."""
        return False

    @attribute
    def omits_measurements(self) -> bool:
        """Whether a measurement may be missing: `altered` may return NaN, or it may be late."""
        return False

    @attribute
    def longest_delay(self) -> int:
        """Largest delay of a law that delays, in samples: `draw` then gives the delays; 0 of other laws."""
        return 0

    @attribute
    def has_bursts(self) -> bool:
        """Whether the noise is larger in some intervals of time."""
        return False

    @attribute
    def burst_names(self) -> tuple[str, ...]:
        """Names of the random numbers that place the bursts of a run; none where all runs have the same bursts."""
        return ()

    def draw(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Noise of one run; a longer draw begins with the shorter one.

        A law that alters measurements returns here the random numbers that `altered` takes.
        """
        raise NotImplementedError("draw")

    def altered(self, y: Float[Array, "runs n"], drawn: Float[Array, "runs n"]) -> Float[Array, "runs n"]:
        """Return the measurements of one sample as the law alters them, run by run; see `alters_output`.

        Parameters
        ----------
        y : measurements with all noise that adds to them; NaN where one is missing already
        drawn : numbers of `draw` for this sample
        """
        return y

    def burst_values(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Values of `burst_names` in one run, from the fresh generator that `draw` takes."""
        return {}

    def in_burst(self, rng: np.random.Generator, n_samples: int) -> Bool[Array, " samples"]:
        """Whether a sample of one run is in a burst, from the fresh generator that `draw` takes."""
        return np.zeros(n_samples, dtype=bool)


class Reference:
    """A signal that the output should follow, known ahead of time.  A subclass gives the method `sample`."""

    def sample(self, n_samples: int) -> Float[Array, "samples ny"]:
        """Values at k = 0..n_samples - 1."""
        raise NotImplementedError("sample")


class InputSignal:
    """An input known ahead of time, in place of a controller.  A subclass gives the method `sample`."""

    @property
    def n_runs(self) -> int | None:
        """Number of runs that have an input; None where every run has one."""
        return None

    def sample(self, runs: Sequence[int], n_samples: int) -> Float[Array, "runs samples nu"]:
        """Values at k = 0..n_samples - 1 of every run.

        Parameters
        ----------
        runs : indices of the runs; a recorded input may be another one in every run
        n_samples : number of samples
        """
        raise NotImplementedError("sample")
