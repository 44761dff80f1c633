"""Intervals by resampling whole runs; the seed of the experiment makes them reproducible."""

from __future__ import annotations

import math

import numpy as np

from rmpc_bench.analysis.intervals import Interval, quantile, student
from rmpc_bench.analysis.rounding import NEGLIGIBLE
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
    """Interval of a mean: Student t, or bootstrap-t for fewer than `MANY` skewed values.

    Parameters
    ----------
    values : (n,) sample, such as log ratios
    confidence : level, such as 0.95
    seed : of the resamples

    Returns
    -------
    low, high; NaN below two values or where one is not finite
    """
    if FEWEST <= len(values) < MANY and abs(skewness(values)) > SKEWED:
        return bootstrap_t(values, confidence, seed)
    return student(values, confidence)


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


def bootstrap_t(values: Array, confidence: float, seed: int) -> Interval:
    """Studentised bootstrap interval of a mean, from resamples of whole runs.

    Where too many resamples repeat one value, so that the ends of the interval would rest on them, it is Student's.

    Parameters
    ----------
    values : (n,) finite sample with spread
    confidence : level, such as 0.95
    seed : of the resamples

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
