"""Laws of the uncertain quantities, sampled by inverse transform.

The inverse distribution function is applied to one uniform number per run and quantity.  Two experiments that differ
only in a bound therefore have the same runs up to a scale, and so have two that differ in ``uncertainty.scale``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from statistics import NormalDist, fmean

from rmpc_bench.types import NonNegative, Positive


class Distribution(ABC):
    """A law of one number."""

    @abstractmethod
    def quantile(self, p: float) -> float:
        """Value below which a share p in [0, 1) lies."""

    @abstractmethod
    def scaled(self, factor: float) -> Distribution:
        """Return the law with its spread about its centre multiplied; the centre of a choice is the mean of its values.

        The factor is at least 0; 1 returns an equal law, 0 one without spread.
        """


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
        """Move both bounds; see `Distribution.scaled`."""
        centre, reach = (self.low + self.high) / 2, factor * (self.high - self.low) / 2
        return self if factor == 1 else Uniform(centre - reach, centre + reach)


@dataclass(frozen=True)
class Normal(Distribution):
    """Normal, optionally truncated on both sides.

    Parameters
    ----------
    std : standard deviation
    mean : mean
    truncate : largest distance from the mean, in standard deviations; no limit if not given
    """

    std: NonNegative
    mean: float = 0.0
    truncate: Positive | None = None

    def quantile(self, p: float) -> float:
        """Value below which a share p lies."""
        tail = 0.0 if self.truncate is None else NormalDist().cdf(-self.truncate)
        inside = tail + (1.0 - 2.0 * tail) * p
        # p = 0 is one draw in 2^53; its quantile -infinity is replaced by that of half a draw.
        return self.mean + self.std * NormalDist().inv_cdf(max(inside, 2.0**-54))

    def scaled(self, factor: float) -> Normal:
        """Multiply the standard deviation; see `Distribution.scaled`."""
        return Normal(factor * self.std, self.mean, self.truncate)


@dataclass(frozen=True)
class Choice(Distribution):
    """One of ``values``, each equally likely.

    Parameters
    ----------
    values : the values
    """

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse an empty choice."""
        if not self.values:
            raise ValueError("values must not be empty")

    def quantile(self, p: float) -> float:
        """Value below which a share p lies."""
        return self.values[min(int(p * len(self.values)), len(self.values) - 1)]

    def scaled(self, factor: float) -> Choice:
        """Move all values; see `Distribution.scaled`."""
        centre = fmean(self.values)
        return self if factor == 1 else Choice(tuple(centre + factor * (value - centre) for value in self.values))


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
