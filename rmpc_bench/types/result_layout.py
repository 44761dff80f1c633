"""Layout of an experiment's results: files, names and sizes, which are known before the experiment runs.

Figures check their keys against it, and the dry run of a claim creates placeholder data from it.  Requirements that
several kinds of figures share are the methods ``require_*``; each yields an `Issue` if the results do not satisfy it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from rmpc_bench.types.errors import Issue, no_such_component, unknown
from rmpc_bench.types.sweep_points import lies_at, no_such_point, value_text

CONFIG = "config.yaml"
"""Copy of the configuration."""
RESOLVED = "config.resolved.yaml"
"""The configuration with every key."""
COPIES = "code"
"""Directory of the copies of Python files."""
SHARDS = "shards"
"""Directory of the results of every shard."""
Font = Literal["dejavu", "stix", "times"]
Style = Literal["bench", "paper"]
Format = Literal["svg", "pdf", "png", "pgf"]
_Compared = Literal["change", "other", "plain", "counts", "superiority", "p", "verdict", "pairs"]
Column = Literal["mean", "lost", "median", _Compared, "n", "held", "steps"]
"""Columns of the LaTeX table of a metric behind the label of the method; `other` is the change of the other average,
`plain` the one that is not adjusted."""
DEFAULT_FORMATS: tuple[Format, ...] = ("svg", "pdf")
LEAST_WIDTH, MOST_WIDTH = 1.0, 100.0
"""Narrowest and widest figure [in]."""
Shape: TypeAlias = tuple[int, ...]
NO_MOMENTS = "needs ensemble moments: evaluate: [runs, moments]"
NO_P = "no method reports a covariance P"
NO_RECORDED_RUN = "no run is recorded; record some with `record: {runs: 1}`"
# A time that is a multiple of the sampling time is one only up to rounding, in samples.
ROUNDING = 1e-9


@dataclass(frozen=True)
class ResultLayout:
    """Names and sizes of the results of an experiment."""

    methods: tuple[str, ...] = ()  # names in the order of the configuration
    metrics: tuple[str, ...] = ()  # names of the metric columns
    # path -> text of the value, of every point of the sweep; one point without paths where nothing is swept, empty
    # where the points are not known
    points: tuple[Mapping[str, str], ...] = ()
    # method -> hash of its trials, of every point; points with an equal hash share the trials; empty where the hashes
    # are not known
    trials: tuple[Mapping[str, str], ...] = ()
    has_runs: bool = True  # whether single runs are evaluated
    is_uncertain: bool = True  # whether runs have stored values of uncertain quantities
    # method -> recorded signal -> shape of one sample, None where it is not known
    signals: Mapping[str, Mapping[str, Shape | None]] = field(default_factory=dict)
    recorded: Sequence[int] = ()  # indices of the runs whose signals are recorded
    # series of the designs and of the ensemble -> shape of one sample
    series: Mapping[str, Shape] = field(default_factory=dict)
    # method -> series at the first point -> shape; axis 0 = k, of length 1 where it is the same at all k
    arrays: Mapping[str, Mapping[str, Shape]] = field(default_factory=dict)
    # last time, in seconds or samples as the experiment's `time` is given; 0 where it is not known, or where a window
    # may reach beyond it because the experiment was shortened
    end: float = 0.0
    Ts: float = 1.0  # sampling time in the unit of `end`
    is_complete: bool = True  # whether more than the names of methods, metrics and points is known
    tuned: tuple[str, ...] = ()  # methods whose parameters are tuned

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Names of the signals that are recorded of some method."""
        return tuple(dict.fromkeys(name for signals in self.signals.values() for name in signals))

    def methods_having(self, *names: str) -> list[str]:
        """Methods that have all of these series."""
        return [method for method in self.methods if set(names) <= set(self.arrays.get(method, {}))]

    def n_states(self, order: Sequence[str] | None, *names: str) -> int | None:
        """Count the states that these series have in all methods to show; None where there is no such series."""
        shown = [arrays for method, arrays in self.arrays.items() if order is None or method in order]
        sizes = [arrays[name][1] for arrays in shown for name in names if name in arrays]
        sizes = sizes or [self.series[name][0] for name in names if name in self.series]
        return min(sizes, default=None)

    def n_points_at(self, at: Sequence[Mapping[str, Any]] | None) -> int:
        """Count the points of the sweep that have the wanted values, each once; all of them for None."""
        if at is None:
            return len(self.points)
        wanted = [texts_of(values) for values in at]
        return sum(any(lies_at(point, texts) for texts in wanted) for point in self.points)

    def require_runs(self) -> Iterator[Issue]:
        """Single runs are evaluated."""
        if not self.has_runs:
            yield Issue("", "shows runs, but no runs are evaluated: add `runs` to `evaluate`")

    def require_metric(self, name: str | None, key: str) -> Iterator[Issue]:
        """There is a metric of this name; None means the primary metric, which always exists."""
        if name is not None and name not in self.metrics:
            yield Issue(key, unknown(name, self.metrics, "metric of this configuration"))

    def require_methods(self, order: Sequence[str] | None) -> Iterator[Issue]:
        """The key `order` names methods, at least one and each one once."""
        if order is None:
            return
        if not order or len(set(order)) < len(order):
            yield Issue("order", "must name at least one method, and each one once")
        for name in order:
            if name not in self.methods:
                yield Issue("order", unknown(name, self.methods, "method"))

    def require_points(self, at: Sequence[Mapping[str, Any]] | None) -> Iterator[Issue]:
        """The key `at` names points of the sweep, at least one."""
        if at is not None and not at:
            yield Issue("at", "must name at least one point")
        for values in at or ():
            message = no_such_point(self.points, texts_of(values))
            if message:
                yield Issue("at", message)

    def require_at_most(self, most: int, n: int, what: str, key: str, advice: str) -> Iterator[Issue]:
        """The figure shows at most a given number of items."""
        if n > most:
            yield Issue(key, f"{n} {what} do not fit into one figure (at most {most}): {advice}")

    def require_component(self, noun: str, indices: Sequence[int], n: int | None, key: str) -> Iterator[Issue]:
        """All indices of components, which count from 0, are below n; any will do where n is None."""
        for index in indices:
            if n is not None and not 0 <= index < n:
                yield Issue(key, no_such_component(noun, index, n))
                return

    def require_pair(self, noun: str, indices: Sequence[int], key: str, n: int = 2) -> Iterator[Issue]:
        """At least n indices are different."""
        if len(set(indices)) < n:
            yield Issue(key, f"must be two different {noun}s")

    def require_signals(self, *names: str) -> Iterator[Issue]:
        """Some runs are recorded, with these signals."""
        if not self.recorded and not names:
            yield Issue("", NO_RECORDED_RUN)
        elif not self.recorded or not set(names) <= set(self.signal_names):
            yield Issue("", f"needs recorded {' and '.join(names)}: record: {{runs: 1, signals: [{', '.join(names)}]}}")

    def require_recorded(self, run: int) -> Iterator[Issue]:
        """A run is recorded."""
        if self.recorded and run not in self.recorded:
            yield Issue("run", f"run {run} is not recorded (recorded: {_listed(self.recorded)})")

    def require_traces(self, order: Sequence[str] | None) -> Iterator[Issue]:
        """Every method to show has recorded runs."""
        for name in order or ():
            if name in self.methods and self.signals and name not in self.signals:
                yield Issue("order", f"no run of '{name}' is recorded (recorded: {', '.join(self.signals)})")

    def require_series(self, *names: str) -> Iterator[Issue]:
        """Some method has each of these ensemble moments, or reports the covariance P."""
        lacking = [name for name in names if name not in self.series]
        if lacking:
            yield Issue("", NO_P if lacking == ["P"] else NO_MOMENTS)

    def require_series_of(self, order: Sequence[str] | None, *names: str) -> Iterator[Issue]:
        """Some method has all of these series, and so have all methods to show.

        Of a sweep nothing is required of single methods, since what they have is known at the first point only.
        """
        if len(self.points) > 1 or not set(names) <= set(self.series):
            return
        having = self.methods_having(*names)
        if not having:
            yield Issue("", f"no method has both {' and '.join(names)}")
        for method in order or ():
            if having and method in self.methods and method not in having:
                lacking = ", ".join(name for name in names if name not in self.arrays.get(method, {}))
                yield Issue("order", f"'{method}' has no {lacking} (those that have: {', '.join(having)})")

    def require_window(self, start: float | None, stop: float | None) -> Iterator[Issue]:
        """At least two samples lie in a window from `from` to `to`."""
        if self.end:
            first, last = samples_between(start, stop, self.Ts, round(self.end / self.Ts))
            if first >= last:
                yield empty_window(start, self.end)


def texts_of(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts of the values by path that a configuration gives."""
    return {path: value_text(value) for path, value in values.items()}


def samples_between(start: float | None, stop: float | None, Ts: float, end: int) -> tuple[int, int]:
    """Find the first and the last sample of a window, both included; no more than one sample if first >= last.

    The ends are in the unit of Ts, None for those of the experiment, whose last sample is `end`.
    """
    first = 0 if start is None else max(0, math.ceil(start / Ts - ROUNDING))
    return first, end if stop is None else min(end, math.floor(stop / Ts + ROUNDING))


def empty_window(start: float | None, end: float) -> Issue:
    """Return the issue of a window with fewer than two samples."""
    message = f"fewer than two samples lie between `from` and `to` (there are 0 to {end:g})"
    return Issue("from" if start is not None else "to", message)


def _listed(runs: Sequence[int]) -> str:
    """List run indices; many successive ones by their ends."""
    if len(runs) > 6 and len(runs) == runs[-1] - runs[0] + 1:
        return f"{runs[0]} to {runs[-1]}"
    return ", ".join(map(str, runs))
