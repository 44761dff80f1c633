"""Laws that alter a measurement in place of adding to it: rounding to a grid, and missing measurements.

Model   y(k) is the output of the plant with all noise that adds to it.  The laws of `noise.measurement` that alter it
        are applied after that, in the order of the list.
        `quantised`: offset + step round((y - offset) / step); a tie goes to the even multiple.
        `missing`: y(k) is NaN at random samples, a two-state Markov chain in its stationary law: a sample is missing
        with `probability`, and missing samples come in gaps of `gap` on average.
Moments none: the error of rounding depends on y, and a missing measurement has no error.  For a step that is small
        beside the change of y from sample to sample the error is close to uniform with the variance step^2 / 12.
Limit   `missing` without `gap` has independent samples, where the mean length of a gap is 1 / (1 - probability).
Streams `quantised` draws nothing.  `missing` draws one number per sample (per sample and output with `outputs: each`),
        and without `gap` the missing samples of a smaller probability are among those of a larger one.
Source  Widrow, Kollar and Liu, IEEE Trans. Instrum. Meas. 45 (1996) for the error; Gilbert, Bell Syst. Tech. J. 39
        (1960) for the chain.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge
from jaxtyping import Float

from rmpc_bench.noise.parameters import Share
from rmpc_bench.numerics.linalg import as_vector
from rmpc_bench.types import Array, DesignError, Noise, Positive

NEGLIGIBLE = 1e-12
"""Relative difference of two numbers that is rounding."""


@dataclass(frozen=True, eq=False)
class Quantised(Noise):
    """Rounds every output to a grid."""

    step: Float[Array, " n"]
    offset: Float[Array, " n"]
    alters_output = True

    def draw(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Return zeros: nothing is random."""
        return np.zeros((n_samples, len(self.step)))

    def altered(self, y: Float[Array, "runs n"], drawn: Float[Array, "runs n"]) -> Float[Array, "runs n"]:
        """Round to the nearest point of the grid."""
        rounded: Array = self.offset + self.step * np.rint((y - self.offset) / self.step)
        return rounded


@dataclass(frozen=True, eq=False)
class Missing(Noise):
    """Omits measurements at random."""

    n: int
    probability: float
    enters: float
    """Probability of a missing sample after one that is not missing."""
    stays: float
    """Probability of a missing sample after a missing one."""
    together: bool
    """Whether all outputs of a sample are missing together."""
    alters_output = True
    omits_measurements = True

    def draw(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Return 1 where a measurement is missing and 0 where it is not."""
        p = rng.random((n_samples, 1 if self.together else self.n))
        if self.enters == self.stays:
            return np.repeat(p < self.probability, self.n // p.shape[1], axis=1).astype(float)
        chains = np.array([self._chain(column) for column in p.T.tolist()]).reshape(p.shape[1], n_samples)
        return np.repeat(chains.T, self.n // p.shape[1], axis=1)

    def altered(self, y: Float[Array, "runs n"], drawn: Float[Array, "runs n"]) -> Float[Array, "runs n"]:
        """Put NaN where a measurement is missing."""
        return np.where(drawn > 0.0, np.nan, y)

    def _chain(self, p: list[float]) -> list[float]:
        """Return the states of the chain, from one uniform number per sample."""
        first, *rest = p
        start = float(first < self.probability)
        step = {0.0: self.enters, 1.0: self.stays}
        return list(accumulate(rest, lambda last, new: float(new < step[last]), initial=start))


def quantised(ny: int, *, step: Positive | list[Positive], offset: float | list[float] = 0.0) -> Quantised:
    """Rounding of the measurement to a grid, as by an analogue-to-digital converter or an encoder.

    It acts after all noise that adds to the measurement.

    Parameters
    ----------
    ny : number of outputs
    step : distance of the points of the grid, a number (for every output) or one per output
    offset : a point of the grid, a number (for every output) or one per output

    Raises
    ------
    DesignError
        If a size does not fit.
    """
    return Quantised(as_vector(step, ny, "step"), as_vector(offset, ny, "offset"))


def missing(
    ny: int,
    *,
    probability: Share,
    gap: Annotated[float, Ge(1)] | None = None,
    outputs: Literal["together", "each"] = "together",
) -> Missing:
    """Missing measurements: the estimator gets NaN and predicts.

    Every estimator must predict where a measurement is missing; `rmpc-bench check` names those that cannot.

    Parameters
    ----------
    ny : number of outputs
    probability : probability that a sample is missing
    gap : mean number of successive missing samples (default: 1 / (1 - probability), independent samples)
    outputs : `together` omits all outputs of a sample, `each` omits every output by itself

    Raises
    ------
    DesignError
        If no chain has this probability and this mean length of a gap.
    """
    if gap is None:
        return Missing(ny, probability, probability, probability, outputs == "together")
    # A mean gap at the bound, such as 9 for 0.9, differs from it by rounding.
    if probability == 1.0 or probability / (1.0 - probability) > gap * (1.0 + NEGLIGIBLE):
        least = "infinite" if probability == 1.0 else f"at least {probability / (1.0 - probability):.6g} samples"
        raise DesignError(f"with the probability {probability:g} the mean gap is {least} (got {gap:g})", "gap")
    enters = min(probability / ((1.0 - probability) * gap), 1.0)
    return Missing(ny, probability, enters, 1.0 - 1.0 / gap, outputs == "together")
