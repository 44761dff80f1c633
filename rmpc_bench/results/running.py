"""The comparison of the primary metric while runs are still computed, from the runs that are there.

The final comparison, that of `rmpc_bench.analysis.comparison`, is computed from the stored trials.  Its intervals are
simultaneous for all methods and therefore wider.
The comparison so far keeps the primary metric of every run, 9 bytes for each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.analysis.pairs import distance_from_best, relative_change
from rmpc_bench.types import Array, MetricInfo, Status

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.engines.tasks import Done, Task
    from rmpc_bench.store.store import Store


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

    point: str  # the point of the sweep in words; empty without a sweep
    method: str
    baseline: str  # empty for a mean
    metric: str
    n: int  # runs that count: those that both methods have finished, for ``wins`` all that both have
    n_failed: int  # runs that are there and in which one of the two has failed
    # ``change`` of the geometric mean [%], ``difference`` or ``mean`` in the unit of the metric, or ``wins`` of a
    # metric without mean: share of the runs in which the method is better [%], ties counting half
    kind: str
    value: float
    low: float  # low, high: interval of each comparison by itself; NaN below two runs
    high: float
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
    """The runs so far of all methods beside those of their baseline, at all points of a sweep.

    They may come in any order.  `points` has the title of every point, and method -> key of its trials, which points
    may share.
    """

    def __init__(
        self, metric: MetricInfo, points: Sequence[tuple[str, Mapping[str, str]]], baseline: str, confidence: float
    ) -> None:
        self.metric, self._confidence = metric, confidence
        self._pairs: list[_Pair] = []
        for title, keys in points:
            base = baseline if baseline in keys else ""
            for name in [name for name in keys if name != base] or [base]:
                against = base if name != base else ""
                self._pairs.append(_Pair(title, name, against, keys[name], keys.get(against, "")))
        self._of_key: dict[str, list[_Pair]] = {}
        for pair in self._pairs:
            for key in filter(None, {pair.key, pair.baseline_key}):
                self._of_key.setdefault(key, []).append(pair)
        self._values: dict[str, Array] = {key: np.empty(0) for key in self._of_key}
        self._there: dict[str, Array] = {key: np.empty(0, dtype=bool) for key in self._of_key}
        self._known: dict[_Pair, Compared] = {}  # without those that have got a run since they were computed

    def add(self, key: str, runs: Sequence[int] | Array, values: Array, status: Array) -> None:
        """Add the primary metric and the status of some runs of a method, whose trials have a key."""
        places = np.asarray(runs, dtype=np.int64)
        if key not in self._values or not len(places):
            return
        missing = int(places.max()) + 1 - len(self._values[key])
        if missing > 0:
            # Twice as much as there is, so that few blocks are copied.
            missing = max(missing, len(self._values[key]))
            self._values[key] = np.concatenate([self._values[key], np.full(missing, np.nan)])
            self._there[key] = np.concatenate([self._there[key], np.zeros(missing, dtype=bool)])
        values = distance_from_best(np.array(values, dtype=float), self.metric.direction)
        values[np.asarray(status) != Status.OK] = np.nan
        self._values[key][places], self._there[key][places] = values, True
        for pair in self._of_key[key]:
            self._known.pop(pair, None)

    def rows(self) -> list[Compared]:
        """Return the comparisons of all methods and points so far."""
        return [self._row(pair) for pair in self._pairs]

    def text(self, most: int = 3) -> str:
        """Say how some methods compare so far, at the first point of a sweep; empty where nothing is known."""
        first = [self._row(pair) for pair in self._pairs if pair.point == self._pairs[0].point]
        texts = [row.text for row in first if row.text]
        if not texts:
            return ""
        against = f" vs {first[0].baseline}" if first[0].baseline else ""
        more = f", {len(texts) - most} more" if len(texts) > most else ""
        return f"{self.metric.name}{against}: {', '.join(texts[:most])}{more}"

    def _row(self, pair: _Pair) -> Compared:
        if pair not in self._known:
            self._known[pair] = self._compared(pair)
        return self._known[pair]

    def _compared(self, pair: _Pair) -> Compared:
        """Compare the runs that both have; a failed run loses against a finished one, and its size is left out."""
        kind, unit, scale, keys = "difference", self.metric.unit, 1.0, [pair.key, *filter(None, [pair.baseline_key])]
        n = min(len(self._values[key]) for key in keys)
        there = np.all([self._there[key][:n] for key in keys], axis=0)
        known = [self._values[key][:n][there] for key in keys]
        failed = np.any(np.isnan(known), axis=0)
        a, b = (each[np.all(np.isfinite(known), axis=0)] for each in (known[0], known[-1]))
        if not pair.baseline:
            kind, sums = "mean", mean_of(known[0])
        elif self.metric.may_not_occur or np.isinf(known).any():
            kind, unit, scale, sums = "wins", "%", 100.0, mean_of(self._scores(*known))
        elif self.metric.direction != "zero" and (a > 0).all() and (b > 0).all():
            kind, unit, sums = "change", "%", mean_of(np.log(a) - np.log(b))
        else:
            sums = mean_of(a - b)
        ends = [sums.mean if sums.n else math.nan, *sums.interval(self._confidence)]
        if kind == "change":
            ends = [100 * relative_change(end) for end in ends]
        value, low, high = (scale * end for end in ends)
        names = pair.point, pair.method, pair.baseline, self.metric.name
        return Compared(*names, sums.n, int(failed.sum()), kind, value, low, high, unit)

    def _scores(self, a: Array, b: Array) -> Array:
        """Return 1 for every run in which the method is better, 0 where it is worse, ties counting half."""
        failed_a, failed_b = np.isnan(a), np.isnan(b)
        worse, better = (a < b, a > b) if self.metric.direction == "higher" else (a > b, a < b)
        won = (better | (failed_b & ~failed_a)).astype(float) - (worse | (failed_a & ~failed_b))
        return (1 + won) / 2


class _Pair(NamedTuple):
    """A method and its baseline, with the keys of their trials; without a baseline these are empty."""

    point: str
    method: str
    baseline: str
    key: str
    baseline_key: str


def running_comparison(config: ExperimentConfig) -> RunningComparison:
    """Return the comparison of an experiment without any run."""
    metric = next(info for info in config.experiment.metric_infos if info.name == config.primary)
    points = [(point.title, point.method_keys) for point in config.points]
    return RunningComparison(metric, points, config.baseline, config.statistics.confidence)


def add_done(running: RunningComparison, config: ExperimentConfig, done: Done) -> None:
    """Add the runs of a finished task."""
    key = config.points[done.task.point].method_keys[done.task.method]
    place = [info.name for info in config.experiment.metric_infos].index(config.primary)
    running.add(key, done.task.runs, done.block.metrics[place], done.block.status)


def add_stored(running: RunningComparison, config: ExperimentConfig, store: Store, tasks: Sequence[Task] = ()) -> None:
    """Add the runs that are stored already, without those of `tasks`, which are computed again."""
    again: dict[str, list[int]] = {}
    for task in tasks:
        again.setdefault(config.points[task.point].method_keys[task.method], []).extend(task.runs)
    metrics = {key: point.metric_keys[config.primary] for point in config.points for key in point.method_keys.values()}
    for key, metric in metrics.items():
        runs, status = store.statuses(key, config.experiment.n_runs)
        values = store.values(key, metric, runs)
        # A run without this metric is computed again.
        known = (~np.isnan(values) | (status != Status.OK)) & ~np.isin(runs, again.get(key, []))
        running.add(key, runs[known], values[known], status[known])


def _digits(low: float, high: float) -> int:
    """Decimals of a number with an interval: two significant digits of half its width."""
    half = (high - low) / 2
    return max(0, 1 - math.floor(math.log10(half))) if 0 < half < math.inf else 3
