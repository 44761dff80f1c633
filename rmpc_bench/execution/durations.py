"""Durations of the calls of a component, as a histogram: a run has too many calls to store each of them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

WIDTH = 0.01
"""Relative width of a bin, hence the relative error of a quantile."""
_SMALLEST = 1e-9
"""Shortest duration with a bin of its own [s], below the resolution of the clock."""


@dataclass
class Durations:
    """Histogram of durations with bins of equal relative width.

    Parameters
    ----------
    counts : number of a bin -> how many durations lie in it
    largest : the longest duration [s]; 0 of none

    Examples
    --------
    >>> durations = Durations.of([0.001, 0.002, 0.002, 0.002, 0.1])
    >>> durations.n, durations.largest, round(durations.quantile(0.5), 4)
    (5, 0.1, 0.002)
    """

    counts: Counter[int] = field(default_factory=Counter)
    largest: float = 0.0

    @classmethod
    def of(cls, seconds: Iterable[float]) -> Durations:
        """Count durations [s]."""
        values = np.fromiter(seconds, dtype=float)
        bins = np.floor(np.log(np.maximum(values, _SMALLEST)) / math.log1p(WIDTH)).astype(int)
        numbers, counts = np.unique(bins, return_counts=True)
        return cls(Counter(dict(zip(numbers.tolist(), counts.tolist(), strict=True))), float(values.max(initial=0.0)))

    @property
    def n(self) -> int:
        """How many durations there are."""
        return self.counts.total()

    def add(self, other: Durations) -> None:
        """Add the durations of another histogram."""
        self.counts.update(other.counts)
        self.largest = max(self.largest, other.largest)

    def quantile(self, share: float) -> float:
        """Return the duration that a share of all does not exceed [s]; NaN of none."""
        if not self.counts:
            return math.nan
        rank, below = max(1, math.ceil(share * self.n)), 0
        for number, count in sorted(self.counts.items()):
            below += count
            if below >= rank:
                # The middle of the bin, which may lie beyond the longest duration in it.
                return min(math.exp((number + 0.5) * math.log1p(WIDTH)), self.largest)
        return self.largest
