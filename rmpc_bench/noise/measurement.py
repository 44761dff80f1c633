"""Laws that alter a signal in place of adding to it: rounding to a grid, missing and delayed samples.

Model   These laws are applied to y(k) after all noise that adds to it, in the order of the list.
        `quantised`  offset + step round((y - offset) / step); a tie goes to the even multiple.
        `missing`  Lost packets, dropped samples (intermittent observations): y(k) is NaN at random samples, a
                   stationary Markov chain of two states: a sample is missing with `probability`, in gaps of `gap`
                   samples on average.  With `every`: m a sample is there at k = first + i m only.  Wherever it stands
                   in the list, it omits the sample when that is taken.
        `delayed`  The value of sample j arrives at j + d(j), with its time.  Delays of several laws add up.
Moments `quantised`  None, since the error depends on y.  For a step that is small beside the change of y from sample to
                     sample the error is close to uniform with the variance step^2 / 12.
Limit   `missing`  Without `gap` samples are independent, and the mean length of a gap is 1 / (1 - probability).
        `delayed`  A delay of 0 is no law.
Streams `quantised`  It draws nothing.
        `missing`  A number per sample (per output, too, with `outputs: each`).  Without `gap` the missing samples of a
                   smaller probability are among those of a larger one.
        `delayed`  A number per sample or run for all outputs, none for a constant delay.
Source  `quantised`  Widrow, Kollar and Liu, IEEE Trans. Instrum. Meas. 45 (1996).
        `missing`  Gilbert, Bell Syst. Tech. J. 39 (1960).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Bool, Float
from pydantic import BeforeValidator

from rmpc_bench.noise.bursts import Share
from rmpc_bench.numerics.linalg import as_vector
from rmpc_bench.types import Array, DesignError, Noise, Positive
from rmpc_bench.types.signals import indices_of

EQUATION = {
    "quantised": r"y = o + q \mathrm{round} \left( \frac{y - o}{q} \right)",
    "delayed": r"y_j \ \mathrm{arrives\ at\ } k = j + d_j, \quad 0 \le d_j \le D",
    "missing": r"P(y_k \ \mathrm{is\ missing}) = p",
}
NEGLIGIBLE = 1e-12
"""Relative difference of two numbers that is rounding."""
LONGEST_DELAY = 100
"""Largest delay in samples; an estimator that counts with it repeats so many steps at every sample."""
MOST_SAMPLES = 10**9  # between two measurements; an integer of NumPy


def _whole(value: Any) -> Any:
    if isinstance(value, float) and value % 1.0 != 0.0:
        raise ValueError(f"must be a whole number (got {value:g}); for parts of a sample choose a smaller time.step")
    return value


Samples: TypeAlias = Annotated[int, BeforeValidator(_whole)]


@dataclass(frozen=True, eq=False)
class Quantised(Noise):
    """Rounds every chosen component to a grid."""

    step: Float[Array, " n"]
    offset: Float[Array, " n"]
    chosen: Bool[Array, " n"]
    alters_output = True

    def draw(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Return zeros: nothing is random."""
        return np.zeros((n_samples, len(self.step)))

    def altered(self, y: Float[Array, "runs n"], drawn: Float[Array, "runs n"]) -> Float[Array, "runs n"]:
        """Round to the nearest point of the grid."""
        rounded: Array = self.offset + self.step * np.rint((y - self.offset) / self.step)
        return np.where(self.chosen, rounded, y)


@dataclass(frozen=True, eq=False)
class Missing(Noise):
    """Omits samples, at random or all but every so many."""

    chosen: Bool[Array, " n"]
    """Which components of the signal are concerned."""
    probability: float
    enters: float
    """Probability of a missing sample after one that is not missing."""
    stays: float
    """Probability of a missing sample after a missing one."""
    together: bool
    """Whether all components of a sample are missing together."""
    every: int = 1
    first: int = 0
    known: bool | None = None
    """Whether a method knows that its input is held; None where this is not said."""
    alters_output = True
    omits_measurements = True

    def draw(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Return 1 where a sample is missing and 0 where it is not."""
        k = np.arange(n_samples)
        lost = np.zeros((n_samples, len(self.chosen)))
        random = self._random(rng, n_samples) if self.probability > 0.0 else np.zeros((n_samples, 1))
        between = (k < self.first) | ((k - self.first) % self.every > 0)
        lost[:, self.chosen] = np.maximum(random, between[:, None])
        return lost

    def _random(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples few"]:
        """Return what is missing at random: one column for all that are concerned, or one for each."""
        p = rng.random((n_samples, 1 if self.together else int(self.chosen.sum())))
        if self.enters == self.stays:
            return (p < self.probability).astype(float)
        return np.array([self._chain(column) for column in p.T.tolist()]).reshape(p.shape[1], n_samples).T

    def altered(self, y: Float[Array, "runs n"], drawn: Float[Array, "runs n"]) -> Float[Array, "runs n"]:
        """Put NaN where a measurement is missing."""
        return np.where(drawn > 0.0, np.nan, y)

    def _chain(self, p: list[float]) -> list[float]:
        """Return the states of the chain, from one uniform number per sample."""
        first, *rest = p
        start = float(first < self.probability)
        step = {0.0: self.enters, 1.0: self.stays}
        return list(accumulate(rest, lambda last, new: float(new < step[last]), initial=start))


@dataclass(frozen=True, eq=False)
class Delayed(Noise):
    """Lets samples arrive late."""

    chosen: Bool[Array, " n"]
    """Which components of the signal are concerned."""
    low: int
    longest_delay: int
    per: Literal["step", "run"]
    alters_output = True

    @property
    def omits_measurements(self) -> bool:
        """Whether nothing may arrive at a sample."""
        return self.longest_delay > 0

    def draw(self, rng: np.random.Generator, n_samples: int) -> Float[Array, "samples n"]:
        """Return the delays in samples."""
        d: Any = self.low
        if self.longest_delay > self.low:
            shares = rng.random((n_samples if self.per == "step" else 1, 1))
            d = self.low + np.floor((self.longest_delay - self.low + 1) * shares)
        return np.broadcast_to(d * self.chosen, (n_samples, len(self.chosen))).astype(float)


def quantised(
    ny: int,
    *,
    signal_names: Sequence[str] = (),
    step: Positive | list[Positive],
    offset: float | list[float] = 0.0,
    only: list[Any] | None = None,
) -> Quantised:
    """Rounding to a grid, as by an analogue-to-digital converter or an encoder.

    Parameters
    ----------
    ny : number of outputs, or of inputs
    signal_names : their names
    step : distance of the points of the grid, one per output, or per name of `only`
    offset : a point of the grid, in the same way
    only : names or indices (from 0) of the outputs or inputs concerned (default: all)

    Raises
    ------
    DesignError
        If a size does not fit, or a name is unknown.
    """
    indices, steps, offsets = _indices(only, signal_names, ny), np.ones(ny), np.zeros(ny)
    steps[indices] = as_vector(step, len(indices), "step")
    offsets[indices] = as_vector(offset, len(indices), "offset")
    return Quantised(steps, offsets, np.isin(range(ny), indices))


def missing(
    ny: int,
    *,
    signal_names: Sequence[str] = (),
    probability: Share | None = None,
    gap: Annotated[float, Ge(1)] | None = None,
    outputs: Literal["together", "each"] = "together",
    every: Annotated[int, Ge(1), Le(MOST_SAMPLES)] | None = None,
    first: Annotated[int, Ge(0)] | None = None,
    only: list[Any] | None = None,
    known: bool | None = None,
) -> Missing:
    """Missing samples: an estimator gets NaN and predicts, an input is held.

    Every estimator must predict where a measurement is missing; `rmpc-bench check` names those that cannot.

    Parameters
    ----------
    ny : number of outputs, or of inputs
    signal_names : their names
    probability : probability that a sample is missing (default with `every`: 0; needed without)
    gap : mean length of a gap in samples (default: 1 / (1 - probability), independent samples)
    outputs : whether a sample is missing in all outputs `together` or in `each` by itself
    every : m: samples at k = first + i m only, as of a slow sensor
    first : first sample with `every`, less than it (default: 0)
    only : names or indices (from 0) of the outputs or inputs concerned (default: all)
    known : of the channel `input`: whether a method knows that its input is held (default: true)

    Raises
    ------
    DesignError
        If no chain has this probability and this mean length of a gap, keys do not go together, or a name is unknown.
    """
    if probability is None and every is None:
        raise DesignError("give `probability`, `every` or both")
    own = {"gap": gap is not None, "outputs": outputs == "each", "first": first is not None}
    for key, needs in (("gap", probability), ("outputs", probability), ("first", every)):
        if own[key] and needs is None:
            raise DesignError(f"has no effect without `{'every' if key == 'first' else 'probability'}`", key)
    if every is not None and (first or 0) >= every:
        raise DesignError(f"must be less than `every` (got {first})", "first")
    p, chosen = probability or 0.0, np.isin(range(ny), _indices(only, signal_names, ny))
    enters, stays = (p, p) if gap is None else _chain_of(p, gap)
    return Missing(chosen, p, enters, stays, outputs == "together", every or 1, first or 0, known)


def _chain_of(probability: float, gap: float) -> tuple[float, float]:
    """Return the probabilities of a missing sample after one that is there, and after a missing one."""
    # A mean gap at the bound, such as 9 for 0.9, differs from it by rounding.
    if probability == 1.0 or probability / (1.0 - probability) > gap * (1.0 + NEGLIGIBLE):
        least = "infinite" if probability == 1.0 else f"at least {probability / (1.0 - probability):.6g} samples"
        raise DesignError(f"with the probability {probability:g} the mean gap is {least} (got {gap:g})", "gap")
    return min(probability / ((1.0 - probability) * gap), 1.0), 1.0 - 1.0 / gap


def delayed(
    ny: int,
    *,
    signal_names: Sequence[str] = (),
    samples: Samples | list[Samples],
    per: Literal["step", "run"] = "step",
    only: list[Any] | None = None,
) -> Delayed:
    """Samples that arrive late, as by computing or communication; `delayed: 2` is short for `{samples: 2}`.

    What a method knows of it is the key `delay` of its design model.

    Parameters
    ----------
    ny : number of outputs, or of inputs
    signal_names : their names
    samples : delay in samples, 0 to 100; [low, high] for a random whole number, all equally likely
    per : whether a random delay is drawn anew at every `step` or once per `run`
    only : names or indices (from 0) of the outputs or inputs concerned (default: all)

    Raises
    ------
    DesignError
        If a delay or a range of delays is none, or a name is unknown.
    """
    bounds = samples if isinstance(samples, list) else [samples, samples]
    if len(bounds) != 2 or not 0 <= bounds[0] <= bounds[1] <= LONGEST_DELAY:
        message = f"must be a whole number from 0 to {LONGEST_DELAY}, or [low, high] of such numbers (got {samples})"
        raise DesignError(message, "samples")
    if per == "run" and bounds[0] == bounds[1]:
        raise DesignError("has no effect on a constant delay; a random one is [low, high]", "per")
    return Delayed(np.isin(range(ny), _indices(only, signal_names, ny)), bounds[0], bounds[1], per)


def _indices(only: list[Any] | None, names: Sequence[str], n: int) -> list[int]:
    """Return the indices of the components of a signal that are concerned; all without `only`."""
    return [*range(n)] if only is None else indices_of(only, names, n, "name of this signal")
