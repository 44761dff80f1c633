"""Laws of the uncertain quantities, sampled by inverse transform.

The inverse distribution function is applied to one uniform number per run and quantity.  Two experiments that differ
only in a bound therefore have the same runs up to a scale, and so have two that differ in ``uncertainty.scale``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from statistics import NormalDist, fmean
from typing import Annotated

import numpy as np
from annotated_types import Ge

from rmpc_bench.numerics.linalg import as_covariance, psd_sqrt
from rmpc_bench.types import Array, DesignError, NonNegative, Positive

STANDARD = NormalDist()
LEAST = 2.0**-54
"""Share in place of 0, which is one draw in 2^53 and has the normal quantile -infinity: that of half a draw."""
ROUNDING = 1e-9
"""What the sum of probabilities may differ from 1."""


def _below(z: float) -> float:
    """Share of the standard normal law below z, with all digits in its lower tail."""
    return 0.5 * math.erfc(-z / math.sqrt(2.0))


class UncertainLaw(ABC):
    """A law of one number, or of several that are drawn together; its key in the configuration is given as `name`."""

    def names(self, name: str) -> tuple[str, ...]:
        """Names of its numbers."""
        return (name,)

    def streams(self, name: str) -> tuple[str, ...]:
        """Names of its random streams, each of which gives one uniform number per run."""
        return (name,)

    @abstractmethod
    def draw(self, p: Sequence[float]) -> Sequence[float]:
        """Return its numbers by a uniform number in [0, 1) of every stream."""

    @abstractmethod
    def scaled(self, factor: float) -> UncertainLaw:
        """Return the law with its spread about its centre multiplied; the centre of a choice is the mean of its values.

        The factor is at least 0; 1 returns an equal law, 0 one without spread.
        """


class Distribution(UncertainLaw):
    """A law of one number."""

    @abstractmethod
    def quantile(self, p: float) -> float:
        """Value below which a share p in [0, 1) lies."""

    def draw(self, p: Sequence[float]) -> Sequence[float]:
        """Return the quantile."""
        return (self.quantile(p[0]),)


@dataclass(frozen=True)
class Uniform(Distribution):
    """Uniform between ``low`` and ``high``.

    Parameters
    ----------
    low : smallest value
    high : largest value
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        """Refuse bounds in the wrong order."""
        if self.low > self.high:
            raise ValueError(f"low ({self.low:g}) must not exceed high ({self.high:g})")

    def quantile(self, p: float) -> float:
        """Value below which a share p lies."""
        return self.low + (self.high - self.low) * p

    def scaled(self, factor: float) -> Uniform:
        """Move both bounds; see `UncertainLaw.scaled`."""
        centre, reach = (self.low + self.high) / 2, factor * (self.high - self.low) / 2
        return self if factor == 1 else Uniform(centre - reach, centre + reach)


@dataclass(frozen=True)
class Normal(Distribution):
    """Normal, optionally truncated on both sides.

    Parameters
    ----------
    std : standard deviation
    mean : mean, before values beyond limits are left out
    truncate : largest distance from the mean, in standard deviations; no limit if not given
    low : smallest value; no limit if not given
    high : largest value; no limit if not given
    """

    std: NonNegative
    mean: float = 0.0
    truncate: Positive | None = None
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        """Refuse limits between which nothing is."""
        low, high, _ = self._range
        if self.truncate is not None and not low == -high == -math.inf:
            raise ValueError("give `truncate`, or `low` and `high`")
        if not _below(high) > _below(low):
            raise ValueError("no value lies between low and high")

    @property
    def _range(self) -> tuple[float, float, float]:
        """Limits in standard deviations from the mean, and 1; above it mirrored, and -1: shares near 1 lose digits."""
        low = -math.inf if self.low is None or not self.std else (self.low - self.mean) / self.std
        high = math.inf if self.high is None or not self.std else (self.high - self.mean) / self.std
        return (-high, -low, -1.0) if low > 0 else (low, high, 1.0)

    def quantile(self, p: float) -> float:
        """Value below which a share p lies."""
        low, high, sign = self._range
        if not low == -high == -math.inf:
            first, last = _below(low), _below(high)
            share = first + (last - first) * (p if sign > 0 else 1.0 - p)
            z = STANDARD.inv_cdf(min(max(share, LEAST * last), 1.0 - 2 * LEAST))
            return self.mean + sign * self.std * min(max(z, low), high)
        tail = 0.0 if self.truncate is None else NormalDist().cdf(-self.truncate)
        inside = tail + (1.0 - 2.0 * tail) * p
        return self.mean + self.std * NormalDist().inv_cdf(max(inside, LEAST))

    def scaled(self, factor: float) -> Normal:
        """Multiply the standard deviation and the distances of limits from the mean; see `UncertainLaw.scaled`."""
        if factor == 1:
            return self
        moved = (None if each is None else self.mean + factor * (each - self.mean) for each in (self.low, self.high))
        return Normal(factor * self.std, self.mean, self.truncate, *moved)


@dataclass(frozen=True)
class Lognormal(Distribution):
    """Lognormal: the logarithm is normal, with mean ln(median) and standard deviation ln(factor).

    Parameters
    ----------
    median : half of the values lie below it
    factor : 68 % of the values lie between median / factor and median * factor
    """

    median: Positive
    factor: Annotated[float, Ge(1)]

    def quantile(self, p: float) -> float:
        """Value below which a share p lies."""
        return self.median * math.exp(math.log(self.factor) * STANDARD.inv_cdf(max(p, LEAST)))

    def scaled(self, factor: float) -> Lognormal:
        """Multiply ln(factor); see `UncertainLaw.scaled`."""
        return Lognormal(self.median, self.factor**factor)


@dataclass(frozen=True)
class Triangular(Distribution):
    """Triangular: the density grows from ``low`` to ``mode`` and falls to ``high``.

    Parameters
    ----------
    low : smallest value
    mode : most probable value
    high : largest value
    """

    low: float
    mode: float
    high: float

    def __post_init__(self) -> None:
        """Refuse values in the wrong order."""
        if not self.low <= self.mode <= self.high:
            raise ValueError(f"low <= mode <= high does not hold ({self.low:g}, {self.mode:g}, {self.high:g})")

    def quantile(self, p: float) -> float:
        """Value below which a share p lies."""
        width, rise, fall = self.high - self.low, self.mode - self.low, self.high - self.mode
        if p * width < rise:
            return self.low + math.sqrt(p * width * rise)
        return self.high - math.sqrt((1.0 - p) * width * fall)

    def scaled(self, factor: float) -> Triangular:
        """Multiply the distances of the ends from the mode; see `UncertainLaw.scaled`."""
        low, high = (self.mode + factor * (each - self.mode) for each in (self.low, self.high))
        return self if factor == 1 else Triangular(low, self.mode, high)


@dataclass(frozen=True)
class Choice(Distribution):
    """One of ``values``, each equally likely unless ``probabilities`` are given.

    Parameters
    ----------
    values : the values
    probabilities : of the values; all equal if not given
    """

    values: tuple[float, ...]
    probabilities: tuple[NonNegative, ...] | None = None

    def __post_init__(self) -> None:
        """Refuse an empty choice, and probabilities that are none."""
        _check_choice(self.values, self.probabilities)

    def quantile(self, p: float) -> float:
        """Value below which a share p lies."""
        return self.values[_chosen(p, len(self.values), self.probabilities)]

    def scaled(self, factor: float) -> Choice:
        """Move all values; see `UncertainLaw.scaled`."""
        if factor == 1:
            return self
        centre = _centre(self.values, self.probabilities)
        return Choice(tuple(centre + factor * (value - centre) for value in self.values), self.probabilities)


def _check_choice(values: Sequence[object], probabilities: Sequence[float] | None) -> None:
    if not values:
        raise ValueError("values must not be empty")
    if probabilities is None:
        return
    if len(probabilities) != len(values):
        raise ValueError(f"there are {len(values)} values and {len(probabilities)} probabilities")
    if abs(math.fsum(probabilities) - 1.0) > ROUNDING:
        raise ValueError(f"the probabilities add to {math.fsum(probabilities):.10g}, not to 1")


def _chosen(p: float, n: int, probabilities: Sequence[float] | None) -> int:
    """Return which of n values a uniform number chooses; never one of probability 0."""
    if probabilities is None:
        return min(int(p * n), n - 1)
    last = max(number for number, share in enumerate(probabilities) if share > 0)
    return min(bisect_right([*accumulate(probabilities)], p), last)


def _centre(values: Sequence[float], probabilities: Sequence[float] | None) -> float:
    """Return the mean of a choice."""
    if probabilities is None:
        return fmean(values)
    return math.fsum(value * share for value, share in zip(values, probabilities, strict=True))


@dataclass(frozen=True)
class Fixed(Distribution):
    """Always ``value``.

    Parameters
    ----------
    value : the value of every run
    """

    value: float

    def quantile(self, p: float) -> float:
        """Return the value for every p."""
        return self.value

    def scaled(self, factor: float) -> Fixed:
        """Return the law, which has no spread."""
        return self


class GroupLaw(UncertainLaw):
    """A law of several numbers that are drawn together."""

    of: tuple[str, ...]

    def names(self, name: str) -> tuple[str, ...]:
        """Names of its numbers."""
        return self.of


@dataclass(frozen=True)
class NormalGroup(GroupLaw):
    """Jointly normal.

    Parameters
    ----------
    of : names of the quantities
    mean : their means
    cov : their covariance matrix
    """

    of: tuple[str, ...]
    mean: tuple[float, ...]
    cov: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        """Refuse sizes that do not fit, and a matrix that is no covariance."""
        if len(self.mean) != len(self.of):
            raise ValueError(f"there are {len(self.of)} names and {len(self.mean)} means")
        try:
            as_covariance([[*row] for row in self.cov], len(self.of))
        except DesignError as error:
            raise ValueError(f"cov: {error}") from None

    @cached_property
    def _root(self) -> Array:
        return psd_sqrt(np.array(self.cov))

    def streams(self, name: str) -> tuple[str, ...]:
        """Streams of single quantities of these names, so that a diagonal covariance gives their draws."""
        return self.of

    def draw(self, p: Sequence[float]) -> Sequence[float]:
        """Return mean + S z with S S = cov and standard normal z."""
        z = [STANDARD.inv_cdf(max(each, LEAST)) for each in p]
        rows = zip(self.mean, self._root.tolist(), strict=True)
        return [mean + math.fsum(s * each for s, each in zip(row, z, strict=True)) for mean, row in rows]

    def scaled(self, factor: float) -> NormalGroup:
        """Multiply the covariance by the square; see `UncertainLaw.scaled`."""
        return NormalGroup(self.of, self.mean, tuple(tuple(factor**2 * each for each in row) for row in self.cov))


@dataclass(frozen=True)
class ChoiceGroup(GroupLaw):
    """One of the rows, each equally likely unless ``probabilities`` are given.

    Parameters
    ----------
    of : names of the quantities
    values : the rows, each with a value for every name, or {file: posterior.csv}, whose heading, if any, has the names
    probabilities : of the rows; all equal if not given
    """

    of: tuple[str, ...]
    values: tuple[tuple[float, ...], ...]
    probabilities: tuple[NonNegative, ...] | None = None

    def __post_init__(self) -> None:
        """Refuse an empty choice, rows of other lengths, and probabilities that are none."""
        _check_choice(self.values, self.probabilities)
        for number, row in enumerate(self.values, 1):
            if len(row) != len(self.of):
                raise ValueError(f"row {number} has {len(row)} values, and there are {len(self.of)} names")

    def draw(self, p: Sequence[float]) -> Sequence[float]:
        """Return the row that a uniform number chooses."""
        return self.values[_chosen(p[0], len(self.values), self.probabilities)]

    def scaled(self, factor: float) -> ChoiceGroup:
        """Move all rows; see `UncertainLaw.scaled`."""
        if factor == 1:
            return self
        centres = [_centre(column, self.probabilities) for column in zip(*self.values, strict=True)]
        rows = (tuple(c + factor * (v - c) for c, v in zip(centres, row, strict=True)) for row in self.values)
        return ChoiceGroup(self.of, tuple(rows), self.probabilities)
