"""Intervals by resampling whole runs; the seed of the experiment makes them reproducible."""

from __future__ import annotations

import math

import numpy as np

from rmpc_bench.analysis.intervals import Interval, quantile, standard_error, student
from rmpc_bench.analysis.rounding import NEGLIGIBLE
from rmpc_bench.analysis.verdict import FEW
from rmpc_bench.types import Array

RESAMPLES = 4999
SKEWED = 1.0
"""Absolute skewness above which the t interval of a mean is too narrow on one side.

For log-normal differences (50 runs) intervals at 95 % cover 0.915 of the time with a limit of 2, as the skewness of a
small sample is often far below that of its law, and 0.93 with a limit of 1.
"""
MANY = 1000
"""Number of runs from which on the t interval covers in spite of skewness; at 200 it covers 0.937 of the time."""
FEWEST = 10
"""Number of runs below which the t interval is better, as resamples repeat the same few values."""


def mean_interval(values: Array, confidence: float, seed: int) -> Interval:
    """Interval of a mean: Student's, and for fewer than `MANY` skewed values the outer ends of it and of two more.

    Those are bootstrap-t and, from half that skewness on, the first Cornish-Fisher correction of the t statistic on the
    side of the long tail.  From `FEW` values on it takes the skewness to be larger by its standard error: the mean of a
    skewed law is most often wrong where a sample has, by chance, less skewness.

    References
    ----------
    Hall, On the removal of skewness by transformation, J. R. Stat. Soc. B 54 (1992) 221.
    """
    low, high = student(values, confidence)
    if not FEWEST <= len(values) < MANY or abs(skewness(values)) <= SKEWED / 2:
        return low, high
    longer = _corrected_tail(values, confidence)
    ends = [(low + min(longer, 0.0), high + max(longer, 0.0))]
    if abs(skewness(values)) > SKEWED:
        ends.append(bootstrap_t(values, confidence, seed))
    return min(end for end, _ in ends), max(end for _, end in ends)


def _corrected_tail(values: Array, confidence: float) -> float:
    """Return how far the interval of skewed values reaches beyond Student's; negative at its lower end."""
    from scipy import special

    n, found = len(values), skewness(values)
    # Without the bias that it has for a normal law.
    found *= math.sqrt(n * (n - 1)) / (n - 2)
    if n >= FEW:
        found += math.copysign(skewness_error(n), found)
    t = float(special.stdtrit(n - 1, (1 + confidence) / 2))
    return found * (1 + 2 * t * t) / (6 * math.sqrt(n)) * standard_error(values)


def skewness(values: Array) -> float:
    """Return the skewness of a sample; 0 where the spread is only rounding or a value is not finite."""
    if len(values) < 2 or not np.isfinite(values).all():
        return 0.0
    deviations = values - values.mean()
    square = float((deviations**2).mean())
    if math.sqrt(square) <= NEGLIGIBLE * float(np.abs(values).max()):
        return 0.0
    # Rounded so that a value at the border is on the same side on every CPU.
    return round(float((deviations**3).mean()) / math.sqrt(square) ** 3, 9)


def skewness_error(n: int) -> float:
    """Return the standard error of the skewness of n normal values; inf for fewer than 3."""
    return math.sqrt(6 * n * (n - 1) / ((n - 2) * (n + 1) * (n + 3))) if n > 2 else math.inf


def bootstrap_t(values: Array, confidence: float, seed: int) -> Interval:
    """Studentised bootstrap interval of a mean, from resamples of whole runs.

    Where too many resamples repeat one value, so that the ends of the interval would rest on them, it is Student's.

    References
    ----------
    Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 12.5.
    """
    n = len(values)
    rng = np.random.Generator(np.random.PCG64(seed))
    drawn = values[rng.integers(0, n, (RESAMPLES, n))]
    spread = drawn.std(axis=1, ddof=1)
    # A resample of one repeated value has no t statistic; rounding is no spread.
    some = spread > NEGLIGIBLE * np.abs(values).max()
    if 1 - some.mean() > (1 - confidence) / 2:
        return student(values, confidence)
    mean = float(values.mean())
    t = (drawn.mean(axis=1)[some] - mean) / (spread[some] / math.sqrt(n))
    se = float(values.std(ddof=1)) / math.sqrt(n)
    low, high = (float(quantile(t, p)) for p in ((1 - confidence) / 2, (1 + confidence) / 2))
    return mean - high * se, mean - low * se
