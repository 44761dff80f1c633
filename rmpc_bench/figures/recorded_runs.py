"""Recorded runs and stored series of a figure: which of them it shows, in which window, and their values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from rmpc_bench.analysis.pairs import distance_from_best
from rmpc_bench.figures.axes import drawable
from rmpc_bench.figures.palette import BAND
from rmpc_bench.types import Array, DesignError, Status
from rmpc_bench.types.result_layout import empty_window, samples_between

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from rmpc_bench.analysis.traces import Traces
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.figures.legend import Handle


class TimeWindow(NamedTuple):
    """The samples that are shown, both ends included, and the length of one on the axis."""

    first: int
    last: int
    sample: float
    unit: str  # unit of the time; empty where samples are counted

    @property
    def limits(self) -> tuple[float, float]:
        """Both ends on the axis."""
        return self.first * self.sample, self.last * self.sample

    @property
    def slice(self) -> slice:
        """The same samples, for indexing."""
        return slice(self.first, self.last + 1)

    @property
    def times(self) -> Array:
        """Times of the samples."""
        return self.sample * np.arange(self.first, self.last + 1)

    @property
    def label(self) -> str:
        """Label of the axis."""
        return f"$t$ [{self.unit}]" if self.unit else "$k$"

    @property
    def words(self) -> str:
        """The same samples in a caption, such as ``t = 0 to 20 s``."""
        first, last = (f"{end:g}" for end in self.limits)
        return f"t = {first} to {last} {self.unit}" if self.unit else f"k = {first} to {last}"


def window_of(point: Trials, last: int, start: float | None, stop: float | None) -> TimeWindow:
    """Find the samples between two times, both included; these are samples where the sampling time is not known.

    An end that is not given is that of the samples.  Raises a DesignError when less than two samples are left.
    """
    sample, unit = (point.Ts, point.time_unit) if point.Ts else (1.0, "")
    window = TimeWindow(*samples_between(start, stop, sample, last), sample, unit)
    if window.first >= window.last:
        issue = empty_window(start, last * sample)
        raise DesignError(issue.message, issue.key)
    return window


_Value = TypeVar("_Value")
ERROR, OUTPUT = "e", "y"  # the control error r - y, which is computed from the recorded output


class RunSelection(NamedTuple):
    """The recorded runs of a method that are shown."""

    rows: Array  # their positions in the traces
    failed: bool  # whether all recorded runs failed; they are shown then, as there are no others


def signal_of(traces: Traces, name: str, component: int) -> Array | None:
    """Return a component of a signal, (runs, samples), None if not recorded; a held one has none at the last sample."""
    recorded = traces.signals.get(OUTPUT if name == ERROR else name)
    values = None if recorded is None else recorded[:, :, component]
    if values is None or name != ERROR:
        return values
    return traces.difference(OUTPUT, traces.r[:, [component]], values[:, :, None], [component])[:, :, 0]


def shown_part(values: Array, traces: Traces, window: TimeWindow) -> Array:
    """Return the samples in a window of a signal, (runs, samples); a held signal is continued to the last one."""
    missing = len(traces.r) - values.shape[1]
    values = np.concatenate([values, np.repeat(values[:, -1:], missing, axis=1)], axis=1)
    return drawable(values[:, window.slice])


def select_runs(point: Trials, method: str) -> RunSelection:
    """Select the recorded runs that ended well, or all of them if none did."""
    runs = point.traces[method].runs
    failed = np.isin(runs, point.runs[point.failed(method)])
    rows = np.arange(len(runs)) if failed.all() else np.flatnonzero(~failed)
    return RunSelection(rows, bool(failed.all()))


def differences(point: Trials, methods: Sequence[str]) -> Trials:
    """Subtract the baseline's signals of the same run from those of other methods; the reference becomes 0.

    Each has the runs and signals that the baseline has too, as far as the baseline finished them.  Raises a DesignError
    when the baseline and a method share no recorded run.
    """
    base = point.traces.get(point.baseline)
    if base is None:
        raise DesignError(f"no run of the baseline '{point.baseline}' is recorded", "difference")
    finished = [run for run, word in point.statuses(point.baseline).items() if word == Status.OK.word]
    traces = {}
    for name in methods:
        own = point.traces[name]
        shared = np.intersect1d(own.runs, base.runs[np.isin(base.runs, finished)])
        if not len(shared):
            raise DesignError(f"'{name}' and the baseline '{point.baseline}' share no recorded run", "difference")
        rows, others = np.searchsorted(own.runs, shared), np.searchsorted(base.runs, shared)
        signals = {
            signal: own.difference(signal, values[rows], base.signals[signal][others])
            for signal, values in own.signals.items()
            if signal in base.signals and base.signals[signal].shape[1:] == values.shape[1:]
        }
        traces[name] = own._replace(runs=shared, signals=signals, r=np.zeros_like(own.r))
    return replace(point, traces=traces)


def find_run(point: Trials, method: str, run: int) -> tuple[int, str]:
    """Return the position of a recorded run in the traces of its method, and its status where it failed, else empty."""
    status = point.statuses(method)[run]
    return int(np.flatnonzero(point.traces[method].runs == run)[0]), "" if status == Status.OK.word else status


def middle_run(point: Trials, method: str, rows: Array, run: int | None) -> int:
    """Find the recorded run to draw thick: the given one, else the one with the middle value of the primary metric."""
    runs = point.traces[method].runs
    if run is not None:
        return find_run(point, method, run)[0]
    info = point.primary_info or point.metrics[0]
    column = point.column(info.name, method)[np.searchsorted(point.runs, runs[rows])]
    values = distance_from_best(column, info.direction)
    return int(rows[np.argsort(values, kind="stable")[len(rows) // 2]])


SIGNAL = "bursts"


def bursts_of(point: Trials, rows: Mapping[str, Array]) -> Array | None:
    """Find the samples at which the noise of the shown runs is in a burst; None if not recorded, or if the runs differ.

    `rows` has the places of the shown runs in the traces of each method.
    """
    if not all(SIGNAL in point.traces[name].signals for name in rows):
        return None
    kept = [point.traces[name].signals[SIGNAL][shown] for name, shown in rows.items()]
    if not sum(map(len, kept)):
        return None
    flags = np.concatenate(kept)[:, :, 0] > 0.5
    return np.asarray(flags[0]) if (flags == flags[0]).all() else None


def spans(bursts: Array | None, window: TimeWindow) -> list[tuple[float, float]]:
    """Find where bursts begin and end on the axis: half a sample beyond their samples, but not outside the window."""
    if bursts is None:
        return []
    shown = np.concatenate([[False], bursts[window.slice], [False]]).astype(np.int64)
    starts, stops = (window.first + np.flatnonzero(np.diff(shown) == step) for step in (1, -1))
    low, high = window.limits
    return [
        (max(low, (start - 0.5) * window.sample), min(high, (stop - 0.5) * window.sample))
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True)
    ]


def shade(panels: Iterable[Axes], bands: Sequence[tuple[float, float]]) -> list[Handle]:
    """Draw the bands of `spans` behind the curves of panels over time; return their legend entry."""
    from matplotlib.patches import Patch

    for axes in panels:
        for start, end in bands:
            axes.axvspan(start, end, color=BAND, lw=0, zorder=0.2)
    return [("burst", Patch(color=BAND, lw=0))] if bands else []


def reported_set(values: Mapping[str, _Value]) -> _Value | None:
    """Choose the set M, else the covariance P, from values by quantity; None if there is neither."""
    return values.get("M", values.get("P"))
