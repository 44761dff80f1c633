"""How well an experiment resolves the comparison of its primary metric: relative half widths of its intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.comparison import averages_of, compared, counts_of, levels
from rmpc_bench.analysis.comparison_text import change_of
from rmpc_bench.analysis.intervals import FEW, skewness, skewness_error, student
from rmpc_bench.analysis.pairs import Pairs, relative_change
from rmpc_bench.analysis.superiority import superiority_interval
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array


class HalfWidth(NamedTuple):
    """Relative half width of an interval."""

    point: str  # the point of the sweep in words; empty without a sweep
    method: str
    value: float  # inf where there is no interval that runs support
    reason: str = ""  # why there is none, if it is not that too few runs finished


def half_widths(trials: Trials) -> list[HalfWidth]:
    """Return the relative half widths of the comparisons of the primary metric, at all points of a sweep.

    The intervals are those of the verdicts, which are simultaneous.  Of a change in per cent the half width is that of
    the ratio: with 2 % the interval reaches from the ratio divided by 1.02 to the ratio times 1.02.  That of a signed
    metric is relative to the mean absolute value of the metric in both methods.  Where counts decide it is that of the
    probability of superiority.  It takes two runs that both methods finished.  Without a second method it is that of
    the mean of the metric, relative to the mean.

    An average has no width while it has no printed interval, or while n runs have a skewness that with its standard
    error exceeds sqrt(n / `FEW`) (Cochran's rule).  Fewer than about `FEW` runs then make up its long tail, and the
    spread may be small by chance.
    """
    of, found = levels(trials), list[HalfWidth]()
    for point in trials.each:
        info = point.primary_info
        if info is None:
            continue
        rows = compared(point, info, of)
        found += [_half_width(point.title, row["method"], *_of_comparison(point, pairs, row)) for pairs, row in rows]
        if not rows:
            values = point.column(info.name, point.baseline)
            values = values[~np.isnan(values)]
            low, high = student(values, of.held)
            size = abs(low + high) / 2
            width = (high - low) / 2 / size if size else math.nan
            found.append(_half_width(point.title, point.baseline, width, values))
    return found


def _half_width(point: str, method: str, width: float, values: Array) -> HalfWidth:
    """Give no width to a mean that rests on few runs of a long tail."""
    if math.isnan(width):
        return HalfWidth(point, method, math.inf)
    n = len(values)
    # Runs without the tail make the width small and the skewness, too: its error counts.
    if n and n < FEW * (abs(skewness(values)) + skewness_error(n)) ** 2:
        return HalfWidth(point, method, math.inf, "rests on few runs of a long tail")
    return HalfWidth(point, method, width)


def _of_comparison(point: Trials, pairs: Pairs, row: Mapping[str, Any]) -> tuple[float, Array]:
    """Return the half width over the runs that both methods finished, and the numbers of which it is the mean."""
    if row["n_pairs"] < 2:
        return math.nan, np.zeros(0)
    if row["average"]:
        return _of_average(pairs, row), averages_of(point, pairs)[row["average"]].values
    low, high = superiority_interval(*counts_of(pairs.scores[pairs.both]), row["ci_level"])
    return (high - low) / 2, np.zeros(0)


def _of_average(pairs: Pairs, row: Mapping[str, Any]) -> float:
    """Return the half width of an average; NaN without an interval."""
    if not math.isnan(row["ci_low"]):
        # A change of -100 % has no finite logarithm.
        low, high = (math.log1p(end / 100) if end > -100 else -math.inf for end in (row["ci_low"], row["ci_high"]))
        half = (high - low) / 2
        return math.inf if math.isnan(half) else relative_change(half)
    scale, change = pairs.scale(), change_of(row)
    return (change.high - change.low) / 2 / scale if scale else math.nan
