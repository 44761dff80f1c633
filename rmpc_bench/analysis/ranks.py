"""Ranks of methods and ratios to the baseline, over all points of a sweep and in parts, with simultaneous intervals.

Score   The mean over the points of the logarithm of the primary metric; the difference of two methods is the logarithm
        of the geometric mean of their ratios.  The unit is the run: a run has the same random numbers for all methods
        and, where the points have one seed, at all points, so the points of a run are averaged first.
Rank    The interval of the rank of a method begins at 1 + the number of better methods, and ends at the number of all
        methods minus that of the worse ones.  Intervals of all pairs of methods decide which is better.  They hold
        simultaneously (`rmpc_bench.analysis.levels`).  All ranks then lie in their intervals simultaneously with
        at least the level of the experiment.
Failed  Failed runs come first.  A method that fails more often than another is worse, whatever its accuracy, where the
        interval of the difference of the shares excludes 0.  Otherwise accuracy decides, on the runs that both
        finished.  A method with more failed runs than the other is better only if that stays so with every failed run
        as the worst finished one of its point, and as ten times worse than its partner.
Source  Mogstad, Romano, Shaikh and Wilhelm, Inference for ranks, Review of Economic Studies 91, 2024, 476-518.
Limit   Two methods: the paired comparison.  No run failed: accuracy alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rmpc_bench.analysis.intervals import NONE, Interval, mean_interval
from rmpc_bench.analysis.levels import held_level
from rmpc_bench.analysis.pairs import distance_from_best
from rmpc_bench.analysis.rounding import NEGLIGIBLE, without_noise
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.verdict import FACTOR, sign_of
from rmpc_bench.types import Array, MetricInfo


@dataclass(frozen=True, eq=False)
class Ranks:
    """Ranks of all methods."""

    methods: tuple[str, ...]
    better: Bool[Array, "methods methods"]  # whether the method of the row is better than that of the column
    level: float  # level of each interval of a pair; together they have that of the experiment
    # pair of places -> difference of the mean logarithms, the first minus the second, with its interval
    differences: Mapping[tuple[int, int], tuple[Difference, Interval]]

    @property
    def low(self) -> Int[Array, " methods"]:
        """Smallest rank of every method."""
        return np.asarray(1 + self.better.sum(axis=0))

    @property
    def high(self) -> Int[Array, " methods"]:
        """Largest rank of every method."""
        return np.asarray(len(self.methods) - self.better.sum(axis=1))

    def against(self, method: int, other: int) -> tuple[Difference, Interval]:
        """Return the difference of two methods, the first minus the second, with its interval."""
        if (method, other) in self.differences:
            return self.differences[method, other]
        found, (low, high) = self.differences[other, method]
        return found._replace(per_run=-found.per_run), (-high, -low)


def ranks(losses: Losses, confidence: float, seed: int) -> Ranks:
    """Rank methods; all intervals together have the level `confidence`."""
    pairs = list(combinations(range(len(losses.methods)), 2))
    accuracy = [losses.difference(*pair) for pair in pairs]
    columns = [each.per_run for each in accuracy]
    has_failed = bool(losses.failed.any())
    if has_failed:
        columns += [losses.difference(*pair, failed="worst").per_run for pair in pairs]
        columns += [losses.failures(*pair) for pair in pairs]
    level = held_level(np.stack(columns, axis=1), confidence, seed) if columns else confidence
    found = [interval_of(column, level, seed) for column in columns]
    n = len(pairs)
    better = np.zeros((len(losses.methods), len(losses.methods)), dtype=bool)
    for number, (a, b) in enumerate(pairs):
        sign = sign_of(found[number])
        if has_failed:
            n_failed = int(losses.failed[:, a].sum()), int(losses.failed[:, b].sum())
            sign = _with_failures(sign, sign_of(found[n + number]), sign_of(found[2 * n + number]), n_failed)
        better[a, b], better[b, a] = sign < 0, sign > 0
    return Ranks(losses.methods, better, level, dict(zip(pairs, zip(accuracy, found[:n], strict=True), strict=True)))


def _with_failures(accuracy: int, counted: int, failures: int, n_failed: tuple[int, int]) -> int:
    """Return -1 where the first of two methods is better, 1 where the second is, else 0."""
    # `accuracy` and `counted` are signs of the difference of the mean logarithms, with failed runs left out and as the
    # worst; `failures` is that of the difference of the shares of failed runs.
    if failures:
        return failures
    fails_more = (n_failed[0] > n_failed[1], n_failed[1] > n_failed[0])
    is_doubtful = (accuracy < 0 and fails_more[0]) or (accuracy > 0 and fails_more[1])
    return 0 if is_doubtful and counted != accuracy else accuracy


def interval_of(per_run: Array, level: float, seed: int) -> Interval:
    """Interval of a mean difference of logarithms, with the digits that another CPU reproduces.

    For eight equal methods with log-normal deviations all intervals of bootstrap-t alone hold together in 0.85 of 150
    experiments with 20 runs and 0.88 of 100 with 100 runs; with Student's as the least width in 0.97 and 0.94.
    """
    if np.isnan(per_run).any():
        return NONE
    low, high = mean_interval(per_run, level, seed)
    return without_noise(low, 1.0), without_noise(high, 1.0)


def group_intervals(
    losses: Losses, baseline: int, groups: Sequence[Sequence[int]], confidence: float, seed: int
) -> list[list[tuple[Difference, Interval]]]:
    """Compare every method with the baseline in groups of points, by intervals that hold simultaneously for all."""
    methods = range(len(losses.methods))
    found = [[losses.difference(method, baseline, group) for method in methods] for group in groups]
    columns = [row[method].per_run for row in found for method in methods if method != baseline]
    level = held_level(np.stack(columns, axis=1), confidence, seed) if columns else confidence
    return [[(each, interval_of(each.per_run, level, seed)) for each in row] for row in found]


class Difference(NamedTuple):
    """The difference of the mean logarithms of two methods, distributed over the runs."""

    per_run: Float[Array, " runs"]  # numbers whose mean is the difference; NaN where no point is used
    n_points: int  # points that it rests on
    n_pairs: int  # runs of these points that both methods finished


@dataclass(frozen=True, eq=False)
class Losses:
    """Logarithms of a metric at all points of a sweep, smaller ones better."""

    methods: tuple[str, ...]  # names of axis 1
    logs: Float[Array, "points methods runs"]  # NaN where the run failed or is not there
    failed: Bool[Array, "points methods runs"]  # whether the run failed

    def difference(
        self, method: int, other: int, points: Sequence[int] | None = None, *, failed: str = "left out"
    ) -> Difference:
        """Average the differences of two methods over points with equal weights.

        Every point counts by its own mean, whatever the number of runs that both methods finished there.  The deviation
        of a run from that mean has the weight (number of runs)/(number of pairs).  Failed runs are ``left out`` or
        ``worst``: as the worst finished run at the point, and worse than its partner.
        """
        chosen = slice(None) if points is None else list(points)
        a, b = self.logs[chosen, method], self.logs[chosen, other]
        if failed == "worst":
            worst, step = self._worst[chosen][:, None], np.log(FACTOR)
            of_a, of_b = np.fmax(worst, b + step), np.fmax(worst, a + step)
            a, b = np.where(self.failed[chosen, method], of_a, a), np.where(self.failed[chosen, other], of_b, b)
        gap = a - b
        # Two values that differ by rounding errors only are equal.
        gap = np.where(np.abs(gap) <= NEGLIGIBLE, 0.0, gap)
        there = np.isfinite(gap)
        n = there.sum(axis=1)
        used = n > 0
        if not used.any():
            return Difference(np.full(gap.shape[1], np.nan), 0, 0)
        gap, there, n = gap[used], there[used], n[used][:, None]
        mean = np.where(there, gap, 0.0).sum(axis=1, keepdims=True) / n
        parts = mean + np.where(there, gap - mean, 0.0) * (gap.shape[1] / n)
        return Difference(parts.mean(axis=0), int(used.sum()), int(there.sum()))

    def failures(self, method: int, other: int) -> Float[Array, " runs"]:
        """Return the share of points at which a method fails, minus that of another one, of every run."""
        gap = self.failed[:, method].astype(float) - self.failed[:, other]
        return np.asarray(gap.mean(axis=0))

    @property
    def _worst(self) -> Float[Array, " points"]:
        """The largest logarithm of all methods at every point; 0 where no run is finished."""
        finite = np.isfinite(self.logs)
        largest = np.where(finite, self.logs, -np.inf).max(axis=(1, 2), initial=-np.inf)
        return np.where(finite.any(axis=(1, 2)), largest, 0.0)


def losses(trials: Trials, info: MetricInfo) -> Losses | None:
    """Collect the logarithms of a metric; None where a finished run has a value without one: 0, negative or inf."""
    methods = trials.methods
    runs = np.unique(np.concatenate([point.runs for point in trials.each]))
    shape = (len(trials.each), len(methods), len(runs))
    values, failed = np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    for number, point in enumerate(trials.each):
        places = np.searchsorted(runs, point.runs)
        for column, name in enumerate(methods):
            values[number, column, places] = distance_from_best(point.column(info.name, name), info.direction)
            failed[number, column, places] = point.failed(name)
    values[failed] = np.nan
    known = ~np.isnan(values)
    if not (known.any() and np.isfinite(values[known]).all() and (values[known] > 0).all()):
        return None
    sign = -1.0 if info.direction == "higher" else 1.0
    return Losses(methods, sign * np.log(values), failed)


MOST_VALUES = 6
"""Values of a swept axis that have a ratio of their own in the tables; of more the smallest and the largest one."""


@dataclass(frozen=True)
class Ratio:
    """Geometric mean of the ratios of the metric of a method to that of the baseline."""

    axis: str  # axis, value: the part of the sweep, such as ``noise`` and ``biased``; both empty for all points
    value: str
    method: str  # name
    ratio: float  # ratio, low, high: the geometric mean with its interval; NaN without a pair
    low: float
    high: float
    n_points: int  # points that it rests on
    n_pairs: int  # runs of them that both methods finished


@dataclass(frozen=True)
class RankRow:
    """A method in the table of ranks."""

    method: str  # name
    rank_low: int  # rank_low, rank_high: ends of the interval of its rank
    rank_high: int
    n: int  # n, n_failed: trials of all points, and how many of them failed
    n_failed: int
    ratio: Ratio  # to the baseline, over all points
    by_value: tuple[Ratio, ...]  # to the baseline, for every value of the axes with few values
    # smallest, largest: of the ratios to the baseline for the values of the longest axis; None without a sweep
    smallest: Ratio | None
    largest: Ratio | None
    better: int  # better, worse: values of the longest axis whose interval lies below and above 1
    worse: int


@dataclass(frozen=True, eq=False)
class Ranking:
    """The table of ranks."""

    rows: tuple[RankRow, ...]  # the methods, those with the smallest ranks first
    ratios: tuple[Ratio, ...]  # of all parts of the sweep, in its order
    level: float  # level of each interval of the ratios over all points; together they have that of the experiment
    longest: str  # the axis whose values are the units of `better` and `worse`; empty without a sweep
    n_values: int  # number of its values


def ranking(trials: Trials) -> Ranking | None:
    """Rank the methods of an experiment that asks for ranks.

    None where it does not, there is only one method or no run, or a value of the primary metric has no logarithm.
    """
    info = trials.primary_info
    if not trials.ranks or info is None or len(trials.methods) < 2 or not len(trials.runs):
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
    for paths in trials.axes:
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
