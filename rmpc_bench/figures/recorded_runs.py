"""Recorded runs and stored series of a figure: which of them it shows, in which window, and their values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from rmpc_bench.figures.axes import drawable
from rmpc_bench.figures.palette import BAND
from rmpc_bench.types import Array, DesignError, Status
from rmpc_bench.types.result_layout import empty_window, samples_between

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from rmpc_bench.analysis.traces import Traces
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.figures.legend import Handle


class TimeWindow(NamedTuple):
    """The samples that are shown, both ends included, and the length of one on the axis."""

    first: int
    last: int
    sample: float
    label: str
    """Label of the axis."""

    @property
    def limits(self) -> tuple[float, float]:
        """Both ends on the axis."""
        return self.first * self.sample, self.last * self.sample

    @property
    def slice(self) -> slice:
        """The same samples, for indexing."""
        return slice(self.first, self.last + 1)

    @property
    def in_seconds(self) -> bool:
        """Whether the axis shows seconds, and not samples."""
        return self.label != "$k$"

    @property
    def words(self) -> str:
        """The same samples in a caption, such as ``t = 0 to 20 s``."""
        first, last = (f"{end:g}" for end in self.limits)
        return f"t = {first} to {last} s" if self.in_seconds else f"k = {first} to {last}"


def window_of(point: Trials, last: int, start: float | None, stop: float | None) -> TimeWindow:
    """Find the samples between two times [s], both included; these are samples where the sampling time is not known.

    An end that is not given is that of the samples.  Raises a DesignError when less than two samples are left.
    """
    sample, label = (point.Ts, "$t$ [s]") if point.Ts else (1.0, "$k$")
    window = TimeWindow(*samples_between(start, stop, sample, last), sample, label)
    if window.first >= window.last:
        issue = empty_window(start, last * sample)
        raise DesignError(issue.message, issue.key)
    return window


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
    shown = np.concatenate([[False], bursts[window.first : window.last + 1], [False]]).astype(np.int64)
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


class Curve(NamedTuple):
    """Values of one component over the samples."""

    k: Array
    values: Array

    def at(self, k: int) -> float:
        """Value at a sample, NaN where there is none; a constant has it at every sample."""
        found = self.values if len(self.k) == 1 else self.values[self.k == k]
        return float(found[0]) if len(found) else np.nan


class SeriesComponent(NamedTuple):
    """A component of a series: its exact values, those from runs, or both."""

    exact: Curve | None
    runs: Curve | None
    n_runs: frozenset[int] = frozenset()
    """Numbers of runs, more than one where it changes from sample to sample."""
    counts: Array | None = None
    """(samples,) numbers of runs at the samples of `runs`."""

    @property
    def best(self) -> Curve:
        """The exact values where they exist, else those from runs."""
        found = self.exact or self.runs
        assert found is not None, "made from at least one row"
        return found


def component_of(rows: pd.DataFrame) -> SeriesComponent:
    """Read one component of one method; of values from runs, those from most runs count at every sample."""
    rows = rows.sort_values(["k", "n"])
    exact, sampled = rows[rows["n"] == 0], rows[rows["n"] > 0].drop_duplicates("k", keep="last")
    counts = sampled["n"].to_numpy(dtype=np.int64)
    return SeriesComponent(_curve(exact), _curve(sampled), frozenset(map(int, counts)), counts)


def components(
    point_series: pd.DataFrame, quantity: str, methods: Iterable[str]
) -> dict[str, dict[str, SeriesComponent]]:
    """Read all components of a quantity by method and component, without the methods that do not have it."""
    table = point_series[point_series["quantity"] == quantity]
    found: dict[str, dict[str, SeriesComponent]] = {}
    for name in methods:
        own = table[table["method"] == name]
        if len(own):
            found[name] = {
                str(component): component_of(rows) for component, rows in own.groupby("component", sort=False)
            }
    return found


def cut(curve: Curve, window: TimeWindow) -> Curve | None:
    """Cut a curve to a window: a constant covers it; None if the curve ends before it."""
    if len(curve.k) == 1:
        return Curve(np.array([window.first, window.last]), np.repeat(curve.values, 2))
    inside = (curve.k >= window.first) & (curve.k <= window.last)
    return Curve(curve.k[inside], curve.values[inside]) if inside.any() else None


def _curve(rows: pd.DataFrame) -> Curve | None:
    return Curve(rows["k"].to_numpy(dtype=np.int64), rows["value"].to_numpy(dtype=float)) if len(rows) else None


EDGE = 1e-9
"""Relative distance beyond the edge up to which a state counts as inside: rounding."""

_Value = TypeVar("_Value")


class Tube(NamedTuple):
    """States, estimates and reported sets of one run, at the samples that are shown."""

    x: Array
    """(samples, components) true states."""
    x_hat: Array
    """(samples, components)."""
    S: Array
    """(samples, components, components): x is reported to lie in E(x_hat, S)."""
    gaussian: bool
    """Whether S is the shape of a confidence ellipsoid."""
    status: str


def reported_set(values: Mapping[str, _Value]) -> _Value | None:
    """Choose the set M, else the covariance P, from values by quantity; None if there is neither."""
    return values.get("M", values.get("P"))


def tube_of(point: Trials, name: str, run: int, components: Sequence[int], window: TimeWindow, level: float) -> Tube:
    """Read the run of a method and the sets that it reports; a method without M has the ellipsoid of P at `level`."""
    row, status = find_run(point, name, run)
    x, x_hat = (point.traces[name].signals[signal][row] for signal in ("x", "x_hat"))
    S, gaussian = _shapes(point, name, level)
    S = S[window.slice] if len(S) > 1 else np.repeat(S, window.last + 1 - window.first, axis=0)
    chosen = list(components)
    # The projection of an ellipsoid has this part of its shape matrix.
    part = S[:, chosen][:, :, chosen]
    return Tube(x[window.slice][:, chosen], x_hat[window.slice][:, chosen], part, gaussian, status)


def _shapes(point: Trials, name: str, level: float) -> tuple[Array, bool]:
    """Return the shape matrices of the reported sets, axis 0 = k, and whether they are made from P."""
    known = point.series.loc[point.series["method"] == name, "quantity"].unique()
    quantity = reported_set({quantity: str(quantity) for quantity in known})
    assert quantity is not None, "the check of the figure requires one"
    values = point.matrix_series(quantity, name)
    return (_quantile(level, values.shape[-1]) * values, True) if quantity == "P" else (values, False)


def _quantile(level: float, n: int) -> float:
    """Return the quantile of chi-square with n degrees of freedom."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(n / 2.0, level))
