"""The verdict of a comparison, a pure function of intervals, counts and failed runs, and shares of failed runs.

The rules follow equivalence testing with the smallest relevant difference as margin, in this order:

1. `fails-more`: the interval of the difference of the shares of failed runs lies above 0.
2. `depends-on-average`: the intervals of two averages exclude 0 with opposite signs.
3. `better`, `worse`: the interval lies beyond the margin.
4. `better-size-uncertain`, `worse-size-uncertain`: it excludes 0 and lies on both sides of the end of the margin.
5. `equivalent`: it lies inside the margin.
6. `inconclusive`: it contains 0 and leaves the margin.

Without an interval, or with fewer than `FEW` untied pairs, counts decide: `better` or `worse` where the interval of the
probability of superiority excludes 1/2, else `inconclusive`.  Few untied pairs are `equivalent` all the same if there
are `FEW` pairs and the interval lies inside the margin.

The runs that both finished do not make a method better, equivalent or dependent on the average if it failed in more
runs than the baseline, and another word followed if every failed run counted: as the worst finished one of all methods,
and as ten times worse than its partner.  The verdict is then `inconclusive`: one failure more may be chance, so that it
is not `fails-more`.  With the two exchanged, or if the baseline certainly fails more, `worse` and
`worse-size-uncertain` are `inconclusive`.
"""

from __future__ import annotations

import math
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import FEW, NONE, Interval, exact_share
from rmpc_bench.types import Array


class Verdict(StrEnum):
    """The words, as they stand in comparisons.csv."""

    FAILS_MORE = "fails-more"
    DEPENDS_ON_AVERAGE = "depends-on-average"
    BETTER = "better"
    WORSE = "worse"
    BETTER_SIZE_UNCERTAIN = "better-size-uncertain"
    WORSE_SIZE_UNCERTAIN = "worse-size-uncertain"
    EQUIVALENT = "equivalent"
    INCONCLUSIVE = "inconclusive"


_WORSE = (Verdict.WORSE, Verdict.WORSE_SIZE_UNCERTAIN)


class Evidence(NamedTuple):
    """Numbers from which a verdict follows; negative differences are better."""

    interval: Interval
    """Of the average difference, on logs for a ratio; NaN where there is none."""
    margin: float
    """Differences up to this size are irrelevant, in the same unit."""
    n_pairs: int
    """Runs that both methods finished."""
    n_untied: int
    """Those of them that differ by more than the margin."""
    superiority: Interval = NONE
    """Of the probability that a run of the method is better, ties counting half."""
    other: Interval = NONE
    """Of the second average; NaN where one is asked only."""


class Failures(NamedTuple):
    """Runs that only one of two methods failed in, and what would follow if they counted."""

    method_only: int
    baseline_only: int
    interval: Interval
    """Of the difference of the shares of failed runs, method minus baseline."""
    counted: Evidence
    """The evidence with every failed run as the worst finished one, and as ten times worse than its partner."""


def verdict(evidence: Evidence, failures: Failures | None = None) -> Verdict:
    """Return exactly one verdict, from the runs that both methods finished and from those that failed, if any.

    >>> str(verdict(Evidence((-0.12, -0.09), margin=0.01, n_pairs=200, n_untied=180)))
    'better'
    >>> str(verdict(Evidence((-0.076, 0.001), margin=0.01, n_pairs=200, n_untied=180)))
    'inconclusive'
    """
    word = _word(evidence)
    if failures is None or failures.method_only == failures.baseline_only:
        return word
    fails_more, is_certain = failures.method_only > failures.baseline_only, bool(sign_of(failures.interval))
    if fails_more and is_certain:
        return Verdict.FAILS_MORE
    # Failures can make a method worse than its finished runs say, and its baseline's can make it better.
    is_doubtful = is_certain or _word(failures.counted) != word
    return Verdict.INCONCLUSIVE if is_doubtful and (word in _WORSE) != fails_more else word


def counts_decide(evidence: Evidence) -> bool:
    """Whether counts decide in place of the interval."""
    low, high = evidence.interval
    few = evidence.n_untied < FEW and not (_inside(evidence) and evidence.n_pairs >= FEW)
    return math.isnan(low) or math.isnan(high) or few


def _inside(evidence: Evidence) -> bool:
    low, high = evidence.interval
    return -evidence.margin <= low and high <= evidence.margin


def _word(evidence: Evidence) -> Verdict:
    if counts_decide(evidence):
        return _word_of_counts(evidence.superiority)
    low, high = evidence.interval
    sign, other = sign_of(evidence.interval), sign_of(evidence.other)
    if sign * other < 0:
        return Verdict.DEPENDS_ON_AVERAGE
    if _inside(evidence):
        return Verdict.EQUIVALENT
    if sign < 0:
        return Verdict.BETTER if high < -evidence.margin else Verdict.BETTER_SIZE_UNCERTAIN
    if sign > 0:
        return Verdict.WORSE if low > evidence.margin else Verdict.WORSE_SIZE_UNCERTAIN
    return Verdict.INCONCLUSIVE


def _word_of_counts(superiority: Interval) -> Verdict:
    low, high = superiority
    if low > 0.5:
        return Verdict.BETTER
    return Verdict.WORSE if high < 0.5 else Verdict.INCONCLUSIVE


def sign_of(interval: Interval) -> int:
    """Return the sign of an interval that excludes 0, else 0; NaN excludes nothing."""
    low, high = interval
    return 1 if low > 0 else -1 if high < 0 else 0


FACTOR = 10.0
"""A failed run counts as worse than its partner by this factor; a finished one that exceeds it is far worse."""
BOUND = 0.95
"""Level of the bound of the share of runs that failed or are far worse."""


def far_worse(values: Array, partners: Array, factor: float) -> Array:
    """Return where a value exceeds a factor times that of its partner; nowhere beside a failed or a negative one."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray((values > factor * partners) & (partners >= 0))


def largest_share(k: int, n: int) -> float:
    """Return the largest share that k of n runs leave possible, exactly (Clopper and Pearson, one side).

    >>> [round(100 * largest_share(*each), 4) for each in ((0, 60), (3, 200))]
    [4.8703, 3.831]
    """
    from scipy import special

    return float(special.betaincinv(k + 1, n - k, BOUND)) if k < n else 1.0 if n else float("nan")


@lru_cache(maxsize=4096)
def mcnemar(method_only: int, baseline_only: int, n: int, confidence: float) -> Interval:
    """Invert the exact McNemar test of equal shares of failed runs.

    Given the number m of runs that only one of the two failed in, those in which only the method failed are binomial.
    The interval of that probability p (Clopper and Pearson) gives (2 p - 1) m / n, which excludes 0 where the exact
    test rejects equal shares.  As m is random, it is no interval of the difference itself: `shares_interval` is.

    >>> [round(end, 3) for end in mcnemar(6, 0, 200, 0.95)]
    [0.002, 0.03]
    """
    if not n:
        return NONE
    m = method_only + baseline_only
    if not m:
        return 0.0, 0.0
    low, high = exact_share(method_only, m, confidence)
    return (2 * low - 1) * m / n, (2 * high - 1) * m / n
