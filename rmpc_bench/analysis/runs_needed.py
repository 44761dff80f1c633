"""About how many runs would decide a comparison, from the spread that was observed."""

from __future__ import annotations

import math

from rmpc_bench.analysis.superiority import superiority_interval
from rmpc_bench.analysis.verdict import FEW

POWER = 0.8
"""Probability of a decision with the number of runs given."""


def runs_for_direction(difference: float, sd: float, confidence: float) -> float:
    """Return the runs after which an interval excludes 0 with probability `POWER`, if a difference is the true one.

    It is a whole number; NaN where the difference is 0 or not known.

    Examples
    --------
    >>> runs_for_direction(0.02, 0.10, 0.95)
    197.0
    """
    from scipy import special

    return _runs(float(special.ndtri((1 + confidence) / 2) + special.ndtri(POWER)), sd, abs(difference))


def runs_for_equivalence(sd: float, margin: float, confidence: float) -> float:
    """Return the runs after which an interval lies inside the margin with probability `POWER`, without a difference.

    It is a whole number; NaN where the margin is 0 or the spread is not known.

    Examples
    --------
    >>> runs_for_equivalence(0.10, 0.01, 0.95)
    1051.0
    """
    from scipy import special

    # Both ends must stay inside, so each of them may leave with half of the probability of failure.
    return _runs(float(special.ndtri((1 + confidence) / 2) + special.ndtri((1 + POWER) / 2)), sd, margin)


def runs_for_count(won: int, lost: int, tied: int, confidence: float) -> float:
    """Return the runs after which a count decides with probability `POWER`, if the shares seen are the true ones.

    NaN where `FEW` untied runs or more would be needed, of which the average decides.

    Examples
    --------
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
