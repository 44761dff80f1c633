"""Intervals and tests for one sample of numbers; resampling uses the seed of the experiment.

scipy.stats takes half a second to import: what scipy.special has is taken from there, with the same digits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from rmpc_bench.analysis.rounding import NEGLIGIBLE
from rmpc_bench.types import Array

Interval = tuple[float, float]
NONE: Interval = (math.nan, math.nan)
FEW = 20
"""Untied pairs below which counts decide."""


def t_quantile(df: float, confidence: float) -> float:
    """Return the number below which the absolute value of Student's t lies with this probability."""
    from scipy import special

    return float(special.stdtrit(df, (1 + confidence) / 2))


def normal_quantile(confidence: float) -> float:
    """Return the same of a standard normal number."""
    from scipy import special

    return float(special.ndtri((1 + confidence) / 2))


def standard_error(values: Array) -> float:
    """Compute the standard error of the mean; NaN below two values or where one is infinite."""
    if len(values) < 2 or not np.isfinite(values).all():
        return math.nan
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.std(values, ddof=1) / math.sqrt(len(values)))


def student(values: Array, confidence: float) -> Interval:
    """Student t interval of the mean of a sample (n,); NaN below two values or where one is infinite."""
    se = standard_error(values)
    if math.isnan(se):
        return NONE
    with np.errstate(over="ignore"):
        mean = float(np.mean(values))
    reach = t_quantile(len(values) - 1, confidence) * se
    return mean - reach, mean + reach


def welch(a: Array, b: Array, confidence: float, df: tuple[float, float]) -> Interval:
    """Welch interval of the difference of the means of two independent samples, with these degrees of freedom.

    NaN below two values of either or where one is infinite; the difference itself where neither has spread.
    """
    squares = standard_error(a) ** 2, standard_error(b) ** 2
    if math.isnan(sum(squares)):
        return NONE
    gap = float(np.mean(a) - np.mean(b))
    if not sum(squares):
        return gap, gap
    degrees = sum(squares) ** 2 / (squares[0] ** 2 / df[0] + squares[1] ** 2 / df[1])
    reach = t_quantile(degrees, confidence) * math.sqrt(sum(squares))
    return gap - reach, gap + reach


def fieller(a: Array, b: Array, confidence: float) -> Interval:
    """Fieller interval of the ratio of two means, paired.

    A factor c lies in it exactly where the Student interval of the mean of a - c b contains 0.  It is unbounded where
    the interval of the mean of b contains 0, NaN below two pairs.
    """
    n = len(a)
    if n < 2:
        return NONE
    covariance = np.cov(a, b) * (t_quantile(n - 1, confidence) ** 2 / n)
    mean_a, mean_b = float(np.mean(a)), float(np.mean(b))
    # c solves square c^2 - 2 half c + rest = 0.
    square, half, rest = mean_b**2 - covariance[1, 1], mean_a * mean_b - covariance[0, 1], mean_a**2 - covariance[0, 0]
    if square <= 0:
        return -math.inf, math.inf
    reach = math.sqrt(max(0.0, half**2 - square * rest)) / square
    return float(half / square - reach), float(half / square + reach)


def wilson(k: float, n: int, confidence: float) -> Interval:
    """Wilson interval of a share k/n, NaN for no run; ties may count half in k, unlike in scipy's."""
    if n == 0:
        return NONE
    z = normal_quantile(confidence)
    centre = (k + z * z / 2) / (n + z * z)
    reach = z * math.sqrt(k * (n - k) / n + z * z / 4) / (n + z * z)
    return max(0.0, centre - reach) if k else 0.0, min(1.0, centre + reach) if k < n else 1.0


def exact_share(k: float, n: int, confidence: float) -> Interval:
    """Interval of Clopper and Pearson of a share k/n."""
    from scipy import special

    rest = (1 - confidence) / 2
    low = float(special.betaincinv(k, n - k + 1, rest)) if k > 0 else 0.0
    return low, float(special.betaincinv(k + 1, n - k, 1 - rest)) if k < n else 1.0


def order_ranks(n: int, q: float, confidence: float) -> tuple[int, int]:
    """Ranks, from 1, of the order statistics between which a quantile lies; 0 and n + 1 where no run is beyond it."""
    rest = (1 - confidence) / 2
    # The number of values at or below the quantile is binomial.
    return _binomial_quantile(rest, n, q), _binomial_quantile(1 - rest, n, q) + 1


def _binomial_quantile(p: float, n: int, share: float) -> int:
    """Return the smallest k with P(X <= k) >= p for a binomial X."""
    from scipy import special

    if share in (0.0, 1.0):
        return round(n * share)
    # The inverse takes k as a real number, so that rounding may miss the step by one.
    k = max(math.ceil(float(special.bdtrik(p, n, share))), 0)
    return k - 1 if k and float(special.bdtr(k - 1, n, share)) >= p else k


def quantile(values: Array, q: float) -> Array:
    """Quantile along axis 0 of a NaN-free sample, linear between order statistics; NaN for an empty one.

    Unlike ``numpy.quantile`` it leaves inf between two infs as it is.
    """
    return quantiles(values, [q])[0]


def quantiles(values: Array, levels: Sequence[float]) -> list[Array]:
    """Quantiles along axis 0, each as `quantile` returns it, from one search for all order statistics."""
    if not len(values):
        return [np.full(values.shape[1:], np.nan) for _ in levels]
    places = [q * (len(values) - 1) for q in levels]
    ends = [(math.floor(place), math.ceil(place)) for place in places]
    # Of many values some order statistics are found sooner than all.
    ordered = np.partition(values, sorted({rank for pair in ends for rank in pair}), axis=0)
    found = []
    for place, (first, second) in zip(places, ends, strict=True):
        low, high = ordered[first], ordered[second]
        with np.errstate(invalid="ignore"):
            found.append(np.asarray(np.where(low == high, low, low + (high - low) * (place - first))))
    return found


def difference(a: Array, b: Array) -> Array:
    """Subtract entry by entry, where inf against inf is 0."""
    with np.errstate(invalid="ignore"):
        return np.where(a == b, 0.0, a - b)


MOST_EXACT = 50
"""Number of differences up to which the law of the signed-rank statistic is exact, as in SciPy."""
MOST_WITH_TIES = 13
"""The same if some are equal or 0."""


def signed_rank_p(differences: Array) -> float:
    """Two-sided Wilcoxon signed-rank p of paired differences; 1 for a single one or where all are 0, NaN for none."""
    if not len(differences) or np.isnan(differences).any():
        return math.nan
    if not differences.any() or len(differences) == 1:
        return 1.0
    some = differences[differences != 0]
    ranks, statistic, ties = _signed_ranks(some)
    if len(differences) <= (MOST_EXACT if len(ties) == len(differences) else MOST_WITH_TIES):
        return _exact_signed_rank_p(ranks, statistic)
    return _normal_signed_rank_p(statistic, ties.astype(float))


def _exact_signed_rank_p(ranks: Array, statistic: float) -> float:
    """Signed-rank p from the number of choices of signs for each sum of ranks; scipy.stats counts the same ones."""
    halves, reached = (2 * ranks).astype(int), int(2 * statistic)  # a rank of ties may end in .5
    choices = np.zeros(halves.sum() + 1, dtype=np.int64)
    choices[0] = 1
    for each in halves:
        choices[each:] += choices[:-each].copy()
    return min(1.0, 2 * int(min(choices[: reached + 1].sum(), choices[reached:].sum())) / 2.0 ** len(ranks))


def _signed_ranks(differences: Array) -> tuple[Array, float, Array]:
    """Ranks of the absolute differences, the sum of those of positive ones, and how often each value occurs."""
    _, place, ties = np.unique(np.abs(differences), return_inverse=True, return_counts=True)
    ranks = (np.cumsum(ties) - (ties - 1) / 2)[place]
    return ranks, float(ranks[differences > 0].sum()), ties


def _normal_signed_rank_p(statistic: float, ties: Array) -> float:
    """Signed-rank p from the normal law, with the correction for ties, as in `scipy.stats.wilcoxon`."""
    from scipy import special

    n = float(ties.sum())
    variance = (n * (n + 1) * (2 * n + 1) - float((ties**3 - ties).sum()) / 2) / 24
    z = (statistic - n * (n + 1) / 4) / math.sqrt(variance)
    return 2 * float(special.ndtr(-abs(z)))


def holm(p: Sequence[float]) -> list[float]:
    """Adjust p values of one family after Holm; NaN is a test that could not be made, which does not count."""
    tests = [i for i in np.argsort(p, kind="stable") if not math.isnan(p[i])]
    adjusted, largest = [math.nan] * len(p), 0.0
    for done, i in enumerate(tests):
        largest = max(largest, min(1.0, (len(tests) - done) * p[i]))
        adjusted[i] = largest
    return adjusted


RESAMPLES = 4999
TOGETHER = 200
"""Resamples whose mean and spread are computed at a time: their values stay in the cache of the processor."""
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

    Source: Hall, On the removal of skewness by transformation, J. R. Stat. Soc. B 54 (1992) 221.
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
    n, found = len(values), skewness(values)
    # Without the bias that it has for a normal law.
    found *= math.sqrt(n * (n - 1)) / (n - 2)
    if n >= FEW:
        found += math.copysign(skewness_error(n), found)
    t = t_quantile(n - 1, confidence)
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


@lru_cache(maxsize=1)
def _resamples(n: int, seed: int) -> Array:
    """Which of n values are in every resample; the same for all methods and metrics."""
    rng = np.random.Generator(np.random.PCG64(seed))
    return rng.integers(0, n, (RESAMPLES, n))


def bootstrap_t(values: Array, confidence: float, seed: int) -> Interval:
    """Studentised bootstrap interval of a mean, from resamples of whole runs.

    Where too many resamples repeat one value, so that the ends of the interval would rest on them, it is Student's.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 12.5.
    """
    n = len(values)
    means, spread = np.empty((2, RESAMPLES))
    for first in range(0, RESAMPLES, TOGETHER):
        rows = slice(first, first + TOGETHER)
        drawn = values[_resamples(n, seed)[rows]]
        means[rows] = drawn.mean(axis=1)
        spread[rows] = drawn.std(axis=1, ddof=1, mean=means[rows, None])
    # A resample of one repeated value has no t statistic; rounding is no spread.
    some = spread > NEGLIGIBLE * np.abs(values).max()
    if 1 - some.mean() > (1 - confidence) / 2:
        return student(values, confidence)
    mean = float(values.mean())
    t = (means[some] - mean) / (spread[some] / math.sqrt(n))
    se = float(values.std(ddof=1)) / math.sqrt(n)
    low, high = map(float, quantiles(t, [(1 - confidence) / 2, (1 + confidence) / 2]))
    return mean - high * se, mean - low * se
