"""Differences of two tables of trials, paired by point of the sweep, method and run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array


class Largest(NamedTuple):
    """The run in which two values of a metric differ most."""

    size: float
    run: int
    a: float
    b: float


@dataclass(frozen=True)
class MetricDifference:
    """Differences of one metric of one method at one point."""

    point: str  # the point of the sweep in words; empty without a sweep
    method: str
    metric: str
    n: int  # runs that ended equally in both tables, and have a value in one of them at least
    n_differ: int  # those of them whose values differ by more than the tolerance
    relative: Largest  # largest difference relative to the larger of the two values, of finite ones
    absolute: Largest  # largest difference in the unit of the metric, of finite values
    n_apart: int  # runs in which one of the two values is missing or infinite and the other is not equal to it
    apart: Largest  # the first of them


@dataclass(frozen=True)
class StatusDifference:
    """A run that ended differently in two tables."""

    point: str
    method: str
    run: int
    a: str
    b: str


@dataclass(frozen=True)
class RunsInOne:
    """Runs that only one of two tables has."""

    point: str
    method: str
    runs_a: tuple[int, ...]
    runs_b: tuple[int, ...]


@dataclass(frozen=True)
class TrialDifferences:
    """How two tables of trials differ."""

    # methods, metrics, points: names that only the first and only the second table has
    methods: tuple[tuple[str, ...], tuple[str, ...]]
    metrics: tuple[tuple[str, ...], tuple[str, ...]]
    points: tuple[tuple[str, ...], tuple[str, ...]]
    runs: tuple[RunsInOne, ...]  # runs that only one of them has
    statuses: tuple[StatusDifference, ...]  # runs that ended differently
    values: tuple[MetricDifference, ...]  # one record per common point, method and metric
    n_trials: int  # trials that both tables have
    n_values: int  # values that were compared
    tolerance: float  # largest relative difference of equal values

    @property
    def differing(self) -> tuple[MetricDifference, ...]:
        """The metrics whose values differ by more than the tolerance."""
        return tuple(each for each in self.values if each.n_differ)

    @property
    def equal(self) -> bool:
        """Whether both tables have the same trials, with equal statuses and, up to the tolerance, equal values."""
        alone = (*self.methods, *self.metrics, *self.points, self.runs)
        return not (any(alone) or self.statuses or self.differing) and self.n_trials > 0


def trial_differences(a: Trials, b: Trials, tolerance: float = 0.0) -> TrialDifferences:
    """Compare two tables of trials, with the largest relative difference of values that count as equal."""
    common = common_points(a, b)
    runs: list[RunsInOne] = []
    statuses: list[StatusDifference] = []
    values: list[MetricDifference] = []
    n_trials = 0
    metrics = [info.name for info in a.metrics if info.name in {other.name for other in b.metrics}]
    for one, other in common:
        for method in (name for name in one.methods if name in other.methods):
            words_a, words_b = one.statuses(method), other.statuses(method)
            both = sorted(words_a.keys() & words_b.keys())
            n_trials += len(both)
            alone = (tuple(sorted(words_a.keys() - words_b.keys())), tuple(sorted(words_b.keys() - words_a.keys())))
            if any(alone):
                runs.append(RunsInOne(one.title, method, *alone))
            statuses += [
                StatusDifference(one.title, method, run, words_a[run], words_b[run])
                for run in both
                if words_a[run] != words_b[run]
            ]
            alike = np.array([run for run in both if words_a[run] == words_b[run]], dtype=np.int64)
            values += [_values(one, other, method, metric, alike, tolerance) for metric in metrics]
    return TrialDifferences(
        methods=_alone(a.methods, b.methods),
        metrics=_alone([info.name for info in a.metrics], [info.name for info in b.metrics]),
        points=_alone([_title(each) for each in a.each], [_title(each) for each in b.each])
        if a.points or b.points
        else ((), ()),
        runs=tuple(runs),
        statuses=tuple(statuses),
        values=tuple(values),
        n_trials=n_trials,
        n_values=sum(each.n for each in values),
        tolerance=tolerance,
    )


def common_points(a: Trials, b: Trials) -> list[tuple[Trials, Trials]]:
    """Return the tables of the points that two experiments have in common, in the order of the first."""
    others = {_key(table.point): table for table in b.each}
    return [(table, others[_key(table.point)]) for table in a.each if _key(table.point) in others]


def _key(point: Mapping[str, str]) -> frozenset[tuple[str, str]]:
    return frozenset(point.items())


def _title(table: Trials) -> str:
    return table.title or "the only point"


def _alone(a: Sequence[str], b: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return tuple(name for name in a if name not in b), tuple(name for name in b if name not in a)


def _values(one: Trials, other: Trials, method: str, metric: str, runs: Array, tolerance: float) -> MetricDifference:
    """Compare one metric in runs that ended equally; two missing values are equal, and so are two infinite ones."""
    a, b = (
        table.column(metric, method)[np.searchsorted(table.runs, runs)] if len(runs) else np.zeros(0)
        for table in (one, other)
    )
    known = ~(np.isnan(a) & np.isnan(b))
    runs, a, b = runs[known], a[known], b[known]
    same = a == b
    with np.errstate(invalid="ignore", over="ignore"):
        absolute = np.where(same, 0.0, np.abs(a - b))
        relative = np.where(same, 0.0, absolute / np.maximum(np.maximum(np.abs(a), np.abs(b)), np.finfo(float).tiny))
    # A value that one of the two lacks differs from any other; so does a finite one from inf.
    apart = ~same & ~(np.isfinite(a) & np.isfinite(b))
    absolute, relative = np.where(apart, 0.0, absolute), np.where(apart, 0.0, relative)
    beyond = apart | (relative > tolerance)
    return MetricDifference(
        point=one.title,
        method=method,
        metric=metric,
        n=len(runs),
        n_differ=int(beyond.sum()),
        relative=_largest(relative, runs, a, b),
        absolute=_largest(absolute, runs, a, b),
        n_apart=int(apart.sum()),
        apart=_largest(apart.astype(float), runs, a, b),
    )


def _largest(sizes: Array, runs: Array, a: Array, b: Array) -> Largest:
    if not len(sizes):
        return Largest(0.0, -1, math.nan, math.nan)
    place = int(np.argmax(sizes))
    return Largest(float(sizes[place]), int(runs[place]), float(a[place]), float(b[place]))
