"""Ranks of the methods of an experiment and their ratios to the baseline, over all points of a sweep and in parts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rmpc_bench.analysis.intervals import Interval
from rmpc_bench.analysis.loss_differences import Difference, Losses, losses
from rmpc_bench.analysis.ranks import Ranks, group_intervals, ranks
from rmpc_bench.analysis.trials import Trials

MOST_VALUES = 6
"""Values of a swept axis that have a ratio of their own in the tables; of more the smallest and the largest one."""


@dataclass(frozen=True)
class Ratio:
    """Geometric mean of the ratios of the metric of a method to that of the baseline.

    Parameters
    ----------
    axis, value : the part of the sweep, such as ``noise`` and ``biased``; both empty for all points
    method : name
    ratio, low, high : the geometric mean with its interval; NaN without a pair
    n_points : points that it rests on
    n_pairs : runs of them that both methods finished
    """

    axis: str
    value: str
    method: str
    ratio: float
    low: float
    high: float
    n_points: int
    n_pairs: int


@dataclass(frozen=True)
class RankRow:
    """A method in the table of ranks.

    Parameters
    ----------
    method : name
    rank_low, rank_high : ends of the interval of its rank
    n, n_failed : trials of all points, and how many of them failed
    ratio : to the baseline, over all points
    by_value : to the baseline, for every value of the axes with few values
    smallest, largest : of the ratios to the baseline for the values of the longest axis; None without a sweep
    better, worse : values of the longest axis whose interval lies below and above 1
    """

    method: str
    rank_low: int
    rank_high: int
    n: int
    n_failed: int
    ratio: Ratio
    by_value: tuple[Ratio, ...]
    smallest: Ratio | None
    largest: Ratio | None
    better: int
    worse: int


@dataclass(frozen=True, eq=False)
class Ranking:
    """The table of ranks.

    Parameters
    ----------
    rows : the methods, those with the smallest ranks first
    ratios : of all parts of the sweep, in its order
    level : level of each interval of the ratios over all points; together they have that of the experiment
    longest : the axis whose values are the units of `better` and `worse`; empty without a sweep
    n_values : number of its values
    """

    rows: tuple[RankRow, ...]
    ratios: tuple[Ratio, ...]
    level: float
    longest: str
    n_values: int


def ranking(trials: Trials) -> Ranking | None:
    """Rank the methods of an experiment that asks for ranks.

    None where it does not, there is only one method or no run, or a value of the primary metric has no logarithm.
    """
    info = trials.primary_info
    if trials.ranked is None or info is None or len(trials.methods) < 2 or not len(trials.frame):
        return None
    found = losses(trials, info)
    if found is None:
        return None
    baseline = found.methods.index(trials.baseline)
    groups = _groups(trials)
    ranked = ranks(found, trials.confidence, trials.seed)
    ratios = _ratios(found, baseline, groups, trials)
    lengths = {axis: sum(each[0] == axis for each in groups) for axis, _, _ in groups}
    longest = max(lengths, key=lambda axis: lengths[axis], default="")
    rows = [_row(found, ranked, baseline, number, ratios, longest) for number in range(len(found.methods))]
    rows.sort(key=lambda row: (row.rank_low + row.rank_high, row.n_failed, _rounded(row.ratio.ratio)))
    return Ranking(tuple(rows), tuple(ratios), ranked.level, longest, lengths.get(longest, 0))


def _groups(trials: Trials) -> list[tuple[str, str, list[int]]]:
    """Return axis, value and places of the points, for every value of every axis; nothing without a sweep."""
    found = []
    for paths in trials.ranked or ():
        values = [point.point[paths[0]] for point in trials.points]
        for value in dict.fromkeys(values):
            found.append((paths[0], value, [number for number, each in enumerate(values) if each == value]))
    return found


def _ratios(found: Losses, baseline: int, groups: Sequence[tuple[str, str, list[int]]], trials: Trials) -> list[Ratio]:
    parts = [points for _, _, points in groups]
    compared = group_intervals(found, baseline, parts, trials.confidence, trials.seed) if parts else []
    return [
        _ratio(axis, value, method, *found_there)
        for (axis, value, _), row in zip(groups, compared, strict=True)
        for method, found_there in zip(found.methods, row, strict=True)
        if method != trials.baseline
    ]


def _row(found: Losses, ranked: Ranks, baseline: int, number: int, ratios: Sequence[Ratio], longest: str) -> RankRow:
    method = found.methods[number]
    own = [each for each in ratios if each.method == method]
    units = [each for each in own if each.axis == longest and math.isfinite(each.ratio)]
    few = {axis for axis in {each.axis for each in own} if 1 < sum(each.axis == axis for each in own) <= MOST_VALUES}
    failed, finished = found.failed[:, number], np.isfinite(found.logs[:, number])
    if number == baseline:
        total = Ratio("", "", method, 1.0, math.nan, math.nan, len(finished), int(finished.sum()))
    else:
        total = _ratio("", "", method, *ranked.against(number, baseline))
    return RankRow(
        method=method,
        rank_low=int(ranked.low[number]),
        rank_high=int(ranked.high[number]),
        n=int((failed | finished).sum()),
        n_failed=int(failed.sum()),
        ratio=total,
        by_value=tuple(each for each in own if each.axis in few),
        smallest=min(units, key=lambda each: _rounded(each.ratio), default=None),
        largest=max(units, key=lambda each: _rounded(each.ratio), default=None),
        better=sum(each.high < 1 for each in units),
        worse=sum(each.low > 1 for each in units),
    )


def _ratio(axis: str, value: str, method: str, difference: Difference, interval: Interval) -> Ratio:
    mean = float(difference.per_run.mean())
    ratio, low, high = (math.exp(each) for each in (mean, *interval))
    return Ratio(axis, value, method, ratio, low, high, difference.n_points, difference.n_pairs)


def _rounded(ratio: float) -> float:
    """Round a ratio so that equal ones have the same order on every CPU; one that is unknown comes last."""
    return math.inf if math.isnan(ratio) else round(ratio, 9)
