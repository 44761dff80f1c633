"""Mean and Monte Carlo error of a metric while its trials arrive; sums of several writers can be joined."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rmpc_bench.types import Array


class RunningMean(NamedTuple):
    """Number, mean and sum of squared deviations of the finite values so far."""

    n: int = 0
    mean: float = 0.0
    m2: float = 0.0
    """Sum of (value - mean)^2."""
    n_other: int = 0
    """Values that are infinite or missing: an event that did not occur, or a failed run."""

    @property
    def se(self) -> float:
        """Standard error of the mean; NaN with fewer than two values."""
        return math.sqrt(self.m2 / (self.n - 1) / self.n) if self.n > 1 else math.nan

    def joined(self, other: RunningMean) -> RunningMean:
        """Return the record of both sets of values."""
        n = self.n + other.n
        if n == 0:
            return RunningMean(n_other=self.n_other + other.n_other)
        difference = other.mean - self.mean
        mean = self.mean + difference * other.n / n
        m2 = self.m2 + other.m2 + difference * difference * self.n * other.n / n
        return RunningMean(n, mean, m2, self.n_other + other.n_other)


def mean_of(values: Array) -> RunningMean:
    """Return the record of some values, of which inf and NaN are counted apart."""
    finite = values[np.isfinite(values)]
    n_other = len(values) - len(finite)
    if not len(finite):
        return RunningMean(n_other=n_other)
    # A metric of a run that is nearly diverged may be so large that its square is not a number of the machine.
    with np.errstate(over="ignore"):
        mean = float(np.mean(finite))
        m2 = float(np.sum((finite - mean) ** 2))
    return RunningMean(len(finite), mean, m2, n_other)
