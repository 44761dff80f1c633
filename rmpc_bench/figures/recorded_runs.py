"""Recorded runs of a figure: which of them are shown, and the values of their signals at the samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.figures.axes import drawable
from rmpc_bench.figures.window import TimeWindow
from rmpc_bench.types import Array, DesignError, Status

if TYPE_CHECKING:
    from rmpc_bench.analysis.traces import Traces
    from rmpc_bench.analysis.trials import Trials

ERROR, OUTPUT = "e", "y"
"""The control error r - y, which is computed from the recorded output."""


class RunSelection(NamedTuple):
    """The recorded runs of a method that are shown."""

    rows: Array
    """Their positions in the traces."""
    failed: bool
    """Whether all recorded runs failed; they are shown then, as there are no others."""
    n_failed: int


class PanelSignal(NamedTuple):
    """A component of a recorded signal, the content of one panel."""

    signal: str
    component: int
    label: str

    def values(self, traces: Traces) -> Array:
        """Return the values of the recorded runs, (runs, samples); a held signal has none at the last sample."""
        if self.signal == ERROR:
            return np.asarray(traces.r[:, self.component] - traces.signals[OUTPUT][:, :, self.component])
        return traces.signals[self.signal][:, :, self.component]

    def is_in(self, traces: Traces) -> bool:
        """Whether the signal is recorded of a method."""
        return (OUTPUT if self.signal == ERROR else self.signal) in traces.signals

    def is_held(self, traces: Traces) -> bool:
        """Whether the signal is constant over a sample, as the input and all that a controller reports are."""
        return self.is_in(traces) and self.values(traces).shape[1] < len(traces.r)

    def curves(self, traces: Traces, window: TimeWindow, rows: Array) -> tuple[Array, Array]:
        """Return times (samples,) and values (runs, samples) in a window; a held signal is continued to the last one.

        The rows are positions of runs in the traces.
        """
        values = self.values(traces)[rows]
        missing = len(traces.r) - values.shape[1]
        values = np.concatenate([values, np.repeat(values[:, -1:], missing, axis=1)], axis=1)
        times = window.sample * np.arange(len(traces.r))
        return times[window.slice], drawable(values[:, window.slice])


def select_runs(point: Trials, method: str) -> RunSelection:
    """Select the recorded runs that ended well, or all of them if none did."""
    runs = point.traces[method].runs
    table = point.frame[point.frame["method"] == method]
    failed = np.isin(runs, table.loc[table["status"] != Status.OK.word, "run"].to_numpy())
    rows = np.arange(len(runs)) if failed.all() else np.flatnonzero(~failed)
    return RunSelection(rows, bool(failed.all()), int(failed.sum()))


def differences(point: Trials, methods: Sequence[str]) -> Trials:
    """Subtract the baseline's signals of the same run from those of other methods; the reference becomes 0.

    Each has the runs and signals that the baseline has too, as far as the baseline finished them.  Raises a DesignError
    when the baseline and a method share no recorded run.
    """
    base = point.traces.get(point.baseline)
    if base is None:
        raise DesignError(f"no run of the baseline '{point.baseline}' is recorded", "difference")
    table = point.frame[point.frame["method"] == point.baseline]
    finished = table.loc[table["status"] == Status.OK.word, "run"].to_numpy()
    traces = {}
    for name in methods:
        own = point.traces[name]
        shared = np.intersect1d(own.runs, base.runs[np.isin(base.runs, finished)])
        if not len(shared):
            raise DesignError(f"'{name}' and the baseline '{point.baseline}' share no recorded run", "difference")
        rows, others = np.searchsorted(own.runs, shared), np.searchsorted(base.runs, shared)
        signals = {
            signal: values[rows] - base.signals[signal][others]
            for signal, values in own.signals.items()
            if signal in base.signals and base.signals[signal].shape[1:] == values.shape[1:]
        }
        traces[name] = own._replace(runs=shared, signals=signals, r=np.zeros_like(own.r))
    return replace(point, traces=traces)


def find_run(point: Trials, method: str, run: int) -> tuple[int, str]:
    """Return the position of a recorded run in the traces of its method, and its status."""
    table = point.frame[(point.frame["method"] == method) & (point.frame["run"] == run)]
    return int(np.flatnonzero(point.traces[method].runs == run)[0]), str(table["status"].iloc[0])


def last_sample(point: Trials, method: str) -> int:
    """Return the index of the last recorded sample."""
    return len(point.traces[method].r) - 1
