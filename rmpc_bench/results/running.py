"""The comparison of the primary metric while runs are still computed, from sums over the runs that are there.

It needs no table (no pandas) and keeps no value of a run that is paired.  The final comparison, that of
`rmpc_bench.analysis.comparison`, is computed from the stored trials.  Its intervals are simultaneous for all methods
and therefore wider.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from rmpc_bench.analysis.pairs import distance_from_best, relative_change
from rmpc_bench.types import Array, MetricInfo, Status

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.engines.tasks import Done, Task
    from rmpc_bench.store.store import Store


_Part: TypeAlias = tuple[int, Array]
"""Index of the first run, and values of consecutive runs."""


class RunningMean(NamedTuple):
    """Number, mean and sum of squared deviations of the finite values so far."""

    n: int = 0
    mean: float = 0.0
    m2: float = 0.0  # sum of (value - mean)^2
    n_other: int = 0  # values that are infinite or missing: an event that did not occur, or a failed run

    @property
    def se(self) -> float:
        """Standard error of the mean; NaN with fewer than two values."""
        return math.sqrt(self.m2 / (self.n - 1) / self.n) if self.n > 1 else math.nan

    def interval(self, confidence: float) -> tuple[float, float]:
        """Return the Student interval of the mean; NaN below two values."""
        # scipy.stats takes half a second to import.
        from scipy.special import stdtrit

        if self.n < 2:
            return math.nan, math.nan
        reach = float(stdtrit(self.n - 1, (1 + confidence) / 2)) * self.se
        return self.mean - reach, self.mean + reach

    def joined(self, other: RunningMean) -> RunningMean:
        """Return the record of both sets of values; no digits are lost where the mean is large."""
        n, n_other = self.n + other.n, self.n_other + other.n_other
        if not (self.n and other.n):
            return (self if self.n else other)._replace(n_other=n_other)
        difference = other.mean - self.mean
        mean = self.mean + difference * other.n / n
        m2 = self.m2 + other.m2 + difference * difference * self.n * other.n / n
        return RunningMean(n, mean, m2, n_other)


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


class Compared(NamedTuple):
    """A method against its baseline so far; of an experiment with one method its mean."""

    point: str
    """The point of the sweep in words; empty without a sweep."""
    method: str
    baseline: str
    """Empty for a mean."""
    metric: str
    n: int
    """Runs that count: those that both methods have finished, for ``wins`` all that both have."""
    n_failed: int
    """Runs that are there and in which one of the two has failed."""
    kind: str
    """``change`` of the geometric mean [%], ``difference`` or ``mean`` in the unit of the metric, or ``wins`` of a
    metric without mean: share of the runs in which the method is better [%], ties counting half."""
    value: float
    low: float
    high: float
    """Interval of each comparison by itself; NaN below two runs."""
    unit: str

    @property
    def text(self) -> str:
        """The comparison in words, such as ``R-MPC1 -10.9 % [-12.1, -9.7]``; empty where nothing is known yet."""
        if math.isnan(self.value):
            return ""
        digits = _digits(self.low, self.high)
        sign = "" if self.kind in ("mean", "wins") else "+"
        value, low, high = (f"{each:{sign}.{digits}f}" for each in (self.value, self.low, self.high))
        unit = f" {self.unit}" if self.unit else ""
        ends = "" if math.isnan(self.low) else f" [{low}, {high}]"
        return f"{self.method}{' wins' if self.kind == 'wins' else ''} {value}{unit}{ends}"


class RunningComparison:
    """Sums over the pairs of runs of all methods with their baseline, at all points of a sweep.

    Blocks may come in any order and at any length.  Only values whose partner is not there yet are kept.  `points` has
    the title of every point, and method -> key of its trials, which points may share.
    """

    def __init__(
        self, metric: MetricInfo, points: Sequence[tuple[str, Mapping[str, str]]], baseline: str, confidence: float
    ) -> None:
        self.metric, self._confidence = metric, confidence
        self._pairs: list[_Pair] = []
        self._of_key: dict[str, list[tuple[_Pair, int]]] = {}
        for title, keys in points:
            others = [name for name in keys if name != baseline] if baseline in keys else [*keys]
            for name in others or [baseline]:
                pair = _Pair(title, name, baseline if name != baseline and baseline in keys else "")
                self._pairs.append(pair)
                for side, method in enumerate((pair.method, pair.baseline)):
                    if method:
                        self._of_key.setdefault(keys[method], []).append((pair, side))

    def add(self, key: str, first: int, values: Array, status: Array) -> None:
        """Add the primary metric and the status of consecutive runs of a method, whose trials have a key."""
        known = self._of_key.get(key)
        if known:
            values = distance_from_best(np.array(values, dtype=float), self.metric.direction)
            values[np.asarray(status) != Status.OK] = np.nan
            for pair, side in known:
                pair.add(side, first, values, higher=self.metric.direction == "higher")

    def rows(self) -> list[Compared]:
        """Return the comparisons of all methods and points so far."""
        return [self._row(pair) for pair in self._pairs]

    def text(self, most: int = 3) -> str:
        """Say how some methods compare so far, at the first point of a sweep; empty where nothing is known."""
        first = [row for row in self.rows() if row.point == self._pairs[0].point] if self._pairs else []
        texts = [row.text for row in first if row.text]
        if not texts:
            return ""
        against = f" vs {first[0].baseline}" if first[0].baseline else ""
        more = f", {len(texts) - most} more" if len(texts) > most else ""
        return f"{self.metric.name}{against}: {', '.join(texts[:most])}{more}"

    def _row(self, pair: _Pair) -> Compared:
        kind, unit, sums, scale = "difference", self.metric.unit, pair.differences, 1.0
        if not pair.baseline:
            kind = "mean"
        elif self.metric.may_not_occur or pair.n_infinite:
            kind, unit, sums, scale = "wins", "%", pair.scores, 100.0
        elif self.metric.direction != "zero" and not pair.n_not_positive:
            kind, unit, sums = "change", "%", pair.logs
        ends = [sums.mean if sums.n else math.nan, *sums.interval(self._confidence)]
        if kind == "change":
            ends = [100 * relative_change(end) for end in ends]
        value, low, high = (scale * end for end in ends)
        names = pair.point, pair.method, pair.baseline, self.metric.name
        return Compared(*names, sums.n, pair.n_failed, kind, value, low, high, unit)


def running_comparison(config: ExperimentConfig) -> RunningComparison:
    """Return the comparison of an experiment without any run."""
    metric = next(info for info in config.experiment.metric_infos if info.name == config.primary)
    points = [(point.title, point.method_keys) for point in config.points]
    return RunningComparison(metric, points, config.baseline, config.statistics.confidence)


def add_done(running: RunningComparison, config: ExperimentConfig, done: Done) -> None:
    """Add the runs of a finished task."""
    key = config.points[done.task.point].method_keys[done.task.method]
    place = [info.name for info in config.experiment.metric_infos].index(config.primary)
    running.add(key, done.task.first, done.block.metrics[place], done.block.status)


def add_stored(running: RunningComparison, config: ExperimentConfig, store: Store, tasks: Sequence[Task] = ()) -> None:
    """Add the runs that are stored already, without those of `tasks`, which are computed again."""
    again = {config.points[task.point].method_keys[task.method]: set[int]() for task in tasks}
    for task in tasks:
        again[config.points[task.point].method_keys[task.method]].update(task.runs)
    metrics = {key: point.metric_keys[config.primary] for point in config.points for key in point.method_keys.values()}
    words = {status.word: int(status) for status in Status}
    for key, metric in metrics.items():
        stored, statuses = store.column(key, config.experiment.n_runs)
        runs = np.asarray(stored, dtype=np.int64)
        values = np.asarray(store.values(key, metric, stored), dtype=float)
        status = np.array([words[str(word)] for word in statuses], dtype=np.int8)
        # A run without this metric is computed again.
        known = (~np.isnan(values) | (status != Status.OK)) & ~np.isin(runs, [*again.get(key, ())])
        runs, values, status = runs[known], values[known], status[known]
        ends = [0, *(np.flatnonzero(np.diff(runs) != 1) + 1), len(runs)]
        for low, high in pairwise(ends):
            if low < high:
                running.add(key, int(runs[low]), values[low:high], status[low:high])


class _Pair:
    """A method and its baseline: sums of the runs that both have, and the values that wait for their partner."""

    def __init__(self, point: str, method: str, baseline: str) -> None:
        self.point, self.method, self.baseline = point, method, baseline
        self.logs = self.differences = self.scores = RunningMean()
        self.n_failed = self.n_infinite = self.n_not_positive = 0
        self._waiting: tuple[list[_Part], list[_Part]] = ([], [])

    def add(self, side: int, first: int, values: Array, *, higher: bool) -> None:
        """Add values of the method (side 0) or of the baseline (side 1)."""
        if not self.baseline:
            self.n_failed += int(np.isnan(values).sum())
            self.differences = self.differences.joined(mean_of(values))
            return
        theirs, left, covered = self._waiting[1 - side], list[_Part](), list[tuple[int, int]]()
        for start, other in theirs:
            low, high = max(first, start), min(first + len(values), start + len(other))
            if low >= high:
                left.append((start, other))
                continue
            pair = values[low - first : high - first], other[low - start : high - start]
            self._compare(*(pair[::-1] if side else pair), higher=higher)
            left += [(start, other[: low - start]), (high, other[high - start :])]
            covered.append((low, high))
        theirs[:] = [part for part in left if len(part[1])]
        ends = [first, *(end for span in sorted(covered) for end in span), first + len(values)]
        gaps = zip(ends[::2], ends[1::2], strict=True)
        self._waiting[side].extend((low, values[low - first : high - first]) for low, high in gaps if low < high)

    def _compare(self, a: Array, b: Array, *, higher: bool) -> None:
        """Add pairs; a failed run loses against a finished one, and its size is left out."""
        failed_a, failed_b = np.isnan(a), np.isnan(b)
        self.n_failed += int((failed_a | failed_b).sum())
        worse, better = (a < b, a > b) if higher else (a > b, a < b)
        won = (better | (failed_b & ~failed_a)).astype(float) - (worse | (failed_a & ~failed_b))
        self.scores = self.scores.joined(mean_of((1 + won) / 2))
        finite = np.isfinite(a) & np.isfinite(b)
        self.n_infinite += int((np.isinf(a) | np.isinf(b)).sum())
        a, b = a[finite], b[finite]
        self.differences = self.differences.joined(mean_of(a - b))
        positive = (a > 0) & (b > 0)
        self.n_not_positive += int((~positive).sum())
        self.logs = self.logs.joined(mean_of(np.log(a[positive]) - np.log(b[positive])))


def _digits(low: float, high: float) -> int:
    """Decimals of a number with an interval: two significant digits of half its width."""
    half = (high - low) / 2
    return max(0, 1 - math.floor(math.log10(half))) if 0 < half < math.inf else 3
