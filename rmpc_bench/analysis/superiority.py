"""Probability of superiority, difference of two paired shares, and about how many runs would decide a comparison."""

from __future__ import annotations

import math
from functools import lru_cache

from rmpc_bench.analysis.intervals import FEW, NONE, Interval, normal_quantile, wilson
from rmpc_bench.analysis.verdict import mcnemar

_BISECTIONS = 60


def superiority(won: int, lost: int, tied: int) -> float:
    """Return the share of better runs, where a tied one counts half; NaN without runs."""
    n = won + lost + tied
    return (won + tied / 2) / n if n else math.nan


@lru_cache(maxsize=4096)
def superiority_interval(won: int, lost: int, tied: int, confidence: float) -> Interval:
    """Score interval of the probability of superiority.

    Its variance is that of the difference of the shares won and lost at each candidate value, with the share of ties
    that is then most likely.  Without ties it is the Wilson interval.  It is widened
    to contain the interval of the exact sign test with fewer than `FEW` untied runs, and where that test does not
    reject 1/2: fair coins are called unfair in 7.6 % of experiments with 26 runs by the Wilson interval at 95 %.

    Source: Tango, Statistics in Medicine 17 (1998) 891: interval of the difference of paired proportions.

    >>> [round(end, 3) for end in superiority_interval(30, 0, 10, 0.95)]
    [0.798, 0.929]
    """
    n = won + lost + tied
    if n == 0:
        return NONE
    low, high = _score_interval(won, lost, n, confidence)
    exact = mcnemar(won, lost, n, confidence)
    if won + lost < FEW or exact[0] <= 0 <= exact[1]:
        low, high = min(low, exact[0]), max(high, exact[1])
    return (1 + low) / 2, (1 + high) / 2


def shares_interval(first_only: int, second_only: int, n: int, confidence: float) -> Interval:
    """Interval of the difference of two paired shares, such as of failed runs; NaN without runs.

    It is the score interval of `superiority_interval`, widened to contain 0 where the exact McNemar test does not
    reject equal shares.  The exact interval itself, which takes the number of runs in which only one of the two failed
    as given, does not cover the difference: if only one method fails, it ends at the observed share.

    >>> [round(end, 3) for end in shares_interval(6, 0, 200, 0.95)]
    [0.011, 0.064]
    """
    if n == 0:
        return NONE
    low, high = _score_interval(first_only, second_only, n, confidence)
    exact = mcnemar(first_only, second_only, n, confidence)
    return (min(low, 0.0), max(high, 0.0)) if exact[0] <= 0 <= exact[1] else (low, high)


def independent_shares(k: tuple[int, int], n: tuple[int, int], confidence: float) -> Interval:
    """Interval of the difference of two independent shares: Newcombe, Statistics in Medicine 17 (1998) 873, no. 10."""
    if not all(n):
        return NONE
    p, q = k[0] / n[0], k[1] / n[1]
    (low_p, high_p), (low_q, high_q) = (wilson(*each, confidence) for each in zip(k, n, strict=True))
    return p - q - math.hypot(p - low_p, high_q - q), p - q + math.hypot(high_p - p, q - low_q)


def _score_interval(won: int, lost: int, n: int, confidence: float) -> Interval:
    z = normal_quantile(confidence)
    difference = (won - lost) / n
    return _root(won, lost, n, z, -1.0, difference), _root(won, lost, n, -z, difference, 1.0)


def _root(won: int, lost: int, n: int, z: float, low: float, high: float) -> float:
    """Find where the score of a difference, which falls from `low` to `high`, is z."""
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        if _score(won, lost, n, middle) > z:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _score(won: int, lost: int, n: int, difference: float) -> float:
    """Return (observed - assumed difference of the shares) over its standard deviation under the assumption."""
    gap = won - lost - n * difference
    b = (2 * n - won + lost) * difference - won - lost
    c = -lost * difference * (1 - difference)
    share_lost = (math.sqrt(max(b * b - 8 * n * c, 0.0)) - b) / (4 * n)
    variance = n * (2 * share_lost + difference * (1 - difference))
    if variance <= 0:
        return math.copysign(math.inf, gap) if gap else 0.0
    return gap / math.sqrt(variance)


POWER = 0.8
"""Probability of a decision with the number of runs given."""


def runs_for_direction(difference: float, sd: float, confidence: float) -> float:
    """Return the runs after which an interval excludes 0 with probability `POWER`, if a difference is the true one.

    It is a whole number; NaN where the difference is 0 or not known.

    >>> runs_for_direction(0.02, 0.10, 0.95)
    197.0
    """
    from scipy import special

    return _runs(normal_quantile(confidence) + float(special.ndtri(POWER)), sd, abs(difference))


def runs_for_equivalence(sd: float, margin: float, confidence: float) -> float:
    """Return the runs after which an interval lies inside the margin with probability `POWER`, without a difference.

    It is a whole number; NaN where the margin is 0 or the spread is not known.

    >>> runs_for_equivalence(0.10, 0.01, 0.95)
    1051.0
    """
    # Both ends must stay inside, so each of them may leave with half of the probability of failure.
    return _runs(normal_quantile(confidence) + normal_quantile(POWER), sd, margin)


def runs_for_count(won: int, lost: int, tied: int, confidence: float) -> float:
    """Return the runs after which a count decides with probability `POWER`, if the shares seen are the true ones.

    NaN where `FEW` untied runs or more would be needed, of which the average decides.

    >>> runs_for_count(4, 0, 0, 0.95), runs_for_count(3, 2, 0, 0.95)
    (6.0, nan)
    """
    from scipy import special

    untied = won + lost
    for more in range(untied + 1, FEW if untied else 0):
        ties = round(more * tied / untied)
        least = more
        while least and superiority_interval(least - 1, more - least + 1, ties, confidence)[0] > 0.5:
            least -= 1
        decides = superiority_interval(least, more - least, ties, confidence)[0] > 0.5
        if decides and special.bdtrc(least - 1, more, max(won, lost) / untied) >= POWER:
            return float(more + ties)
    return math.nan


def _runs(z: float, sd: float, distance: float) -> float:
    if not (math.isfinite(sd) and distance > 0):
        return math.nan
    # Rounded so that a number next to a whole one is the same on every CPU; two runs are needed for any interval.
    n = round((z * sd / distance) ** 2, 6)
    return float(max(2, math.ceil(n))) if math.isfinite(n) else math.nan
