"""Laws of the uncertain quantities, sampled by inverse transform.

The inverse distribution function is applied to one uniform number per run and quantity.  Two experiments that differ
only in a bound therefore have the same runs up to a scale.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from statistics import NormalDist

from rmpc_bench.types import NonNegative, Positive


class Distribution(ABC):
    """A law of one number."""

    @abstractmethod
    def quantile(self, p: float) -> float:
        """Value below which a share p in [0, 1) lies."""


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
