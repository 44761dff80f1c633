"""Signals over time, one panel each: the recorded run of every method, or median and band of several runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from rmpc_bench.analysis.trials import Traces, Trials
from rmpc_bench.figures import burst_bands, curves
from rmpc_bench.figures.curves import Look, Window
from rmpc_bench.figures.labels import symbol, with_unit
from rmpc_bench.figures.requirements import ERROR, OF_ERROR, usual
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.figures.sweep_points import MOST_SIGNALS
from rmpc_bench.types import Array, DesignError, Status

BAND = (0.05, 0.95)


class Shown(NamedTuple):
    """The recorded runs of a method that are shown."""

    rows: Array
    """Their places in the traces."""
    failed: bool
    """Whether all recorded runs failed, and these are shown for want of better ones."""
    n_failed: int


class Row(NamedTuple):
    """What a panel shows."""

    signal: str
    component: int
    label: str

    def values(self, traces: Traces) -> Array:
        """Values of the recorded runs, (runs, samples); a signal that is held has none at the last sample."""
        if self.signal == ERROR:
            return np.asarray(traces.r[:, self.component] - traces.signals[OF_ERROR][:, :, self.component])
        return traces.signals[self.signal][:, :, self.component]

    def is_shown(self, traces: Traces) -> bool:
        """Whether a method has it."""
        return (OF_ERROR if self.signal == ERROR else self.signal) in traces.signals

    def is_held(self, traces: Traces) -> bool:
        """Whether it is constant over a sample, as the input is and whatever else the controller says."""
        return self.is_shown(traces) and self.values(traces).shape[1] < len(traces.r)


def draw(
    point: Trials,
    title: str,
    methods: Sequence[str],
    rows: Sequence[Row],
    window: Window,
    n_single: int,
    size: tuple[float, float],
    *,
    edges: bool = False,
) -> Figure:
    """Draw the recorded runs; see `figures.trajectories`.

    Parameters
    ----------
    point : the table whose traces are shown
    title : the point of the sweep in words
    methods : methods from below to above
    rows : what the panels show, from top to bottom
    window : the samples to show
    n_single : number of single runs beside median and band
    size : width and height [in]
    edges : whether bands have lines around them
    """
    methods = [name for name in methods if any(row.is_shown(point.traces[name]) for row in rows)]
    looks = curves.looks(point.methods, methods)
    shown = {name: _shown(point, name) for name in methods}
    with style():
        figure = Figure(figsize=size, layout="constrained")
        panels = curves.panels(figure, len(rows))
        rough = [_is_rough(point, row, window, shown) for row in rows]
        handles: list[tuple[str, Artist]] = []
        for name in methods:
            failed = " (failed)" if shown[name].failed else ""
            sample = curves.sample(looks[name], rough=all(rough))
            handles.append((point.labels.get(name, name) + failed, sample))
        for axes, row, solid in zip(panels, rows, rough, strict=True):
            if row.signal == "y":
                reference = _draw_reference(axes, point.traces[methods[0]], row, window)
                handles += [("reference", reference)] if len(handles) == len(methods) else []
            _draw_panel(axes, point, row, window, shown, looks, n_single, rough=solid, edges=edges)
        bands = burst_bands.spans(burst_bands.bursts_of(point, {name: one.rows for name, one in shown.items()}), window)
        handles += burst_bands.shade(panels, bands)
        panels[-1].set_xlim(*window.limits)
        panels[-1].set_xlabel(window.label)
        note = _note(point, methods, shown, n_single)
        curves.finish(figure, handles, "\n".join(filter(None, [title, note])))
    return figure


def rows_of(point: Trials, methods: Sequence[str], signals: Sequence[str] | None) -> list[Row]:
    """Find the panels that signals such as ``y`` or ``x_hat.2`` ask for; a signal stands for all its components."""
    widths, shapes = _recorded(point, methods)
    known = widths | ({ERROR: widths[OF_ERROR]} if OF_ERROR in widths else {})
    found = []
    for text in usual(widths) if signals is None else signals:
        name, dot, index = text.partition(".")
        if name not in known:
            recorded = ", ".join(widths) or "none"
            raise DesignError(f"'{name}' is not a recorded signal (recorded: {recorded})", "signals")
        n = known[name]
        if dot and not (index.isdecimal() and int(index) < n):
            raise DesignError(f"'{text}' is not a component: those of {name} are {name}.0 to {name}.{n - 1}", "signals")
        for component in [int(index)] if dot else range(n):
            of = OF_ERROR if name == ERROR else name
            unit = point.units.get(f"{of}.{component}", point.units.get(of, ""))
            place = ",".join(map(str, np.unravel_index(component, shapes.get(name, (n,))))) if n > 1 else ""
            found.append(Row(name, component, with_unit(symbol(name, place), unit)))
    if not 1 <= len(found) <= MOST_SIGNALS:
        message = f"{len(found)} panels are asked for, there may be 1 to {MOST_SIGNALS}: choose components such as x.0"
        raise DesignError(message, "signals")
    return found


def _recorded(point: Trials, methods: Sequence[str]) -> tuple[dict[str, int], dict[str, tuple[int, ...]]]:
    """Numbers of components that every method has of a signal, if it has it, and shapes of what they report."""
    widths: dict[str, int] = {}
    shapes: dict[str, tuple[int, ...]] = {}
    for name in methods:
        traces = point.traces[name]
        for signal, values in traces.signals.items():
            widths[signal] = min(values.shape[2], widths.get(signal, values.shape[2]))
        shapes |= traces.shapes
    return widths, shapes


def _shown(point: Trials, method: str) -> Shown:
    """Take the recorded runs that ended well; all where there are none."""
    runs = point.traces[method].runs
    table = point.frame[point.frame["method"] == method]
    failed = np.isin(runs, table.loc[table["status"] != Status.OK.word, "run"].to_numpy())
    rows = np.arange(len(runs)) if failed.all() else np.flatnonzero(~failed)
    return Shown(rows, bool(failed.all()), int(failed.sum()))


def _curves(traces: Traces, row: Row, window: Window, rows: Array) -> tuple[Array, Array]:
    """Times and the values of the runs that count; an input, which is held, has a value at its end, too."""
    values = row.values(traces)[rows]
    missing = len(traces.r) - values.shape[1]
    values = np.concatenate([values, np.repeat(values[:, -1:], missing, axis=1)], axis=1)
    shown = slice(window.first, window.last + 1)
    return window.sample * np.arange(len(traces.r))[shown], curves.drawable(values[:, shown])


def _is_rough(point: Trials, row: Row, window: Window, shown: Mapping[str, Shown]) -> bool:
    """Whether some method's steps go up and down so much that dashes would be lost in them."""
    having = [name for name in shown if row.is_held(point.traces[name])]
    if not having:
        return False
    names = [name for name in having if not shown[name].failed] or having
    main = [np.median(_curves(point.traces[name], row, window, shown[name].rows)[1], axis=0) for name in names]
    return curves.are_rough(main)


def _draw_panel(
    axes: Axes,
    point: Trials,
    row: Row,
    window: Window,
    shown: Mapping[str, Shown],
    looks: Mapping[str, Look],
    n_single: int,
    *,
    rough: bool,
    edges: bool,
) -> None:
    """Draw the methods that have the signal of a panel."""
    having = [name for name in shown if row.is_shown(point.traces[name])]
    all_failed = all(one.failed for one in shown.values())
    for name in sorted(having, key=lambda name: shown[name].failed):
        t, values = _curves(point.traces[name], row, window, shown[name].rows)
        limits = axes.get_ylim()
        main = looks[name].line(held=row.is_held(point.traces[name]), rough=rough)
        _draw_runs(axes, t, values, main, n_single, edges=edges)
        if shown[name].failed and not all_failed:
            axes.set_ylim(limits)  # what fails may go far away; it must not shrink the others
    axes.set_ylabel(row.label)


def _draw_runs(axes: Axes, t: Array, values: Array, main: Mapping[str, Any], n_single: int, *, edges: bool) -> None:
    """Draw one run as it is; of several the band, some single runs and the median."""
    if len(values) == 1:
        axes.plot(t, values[0], **main)
        return
    low, median, high = np.quantile(values, [BAND[0], 0.5, BAND[1]], axis=0)
    step: Any = "post" if main["drawstyle"] == "steps-post" else None
    axes.fill_between(t, low, high, step=step, color=main["color"], alpha=0.18, linewidth=0, zorder=1.5)
    for edge in (low, high) if edges else ():
        axes.plot(t, edge, **{**main, "lw": 0.6, "zorder": main["zorder"] - 0.6})
    for run in values[:n_single]:
        axes.plot(t, run, **{**main, "lw": 0.4, "ls": "-", "alpha": 0.8, "zorder": main["zorder"] - 0.5})
    axes.plot(t, median, **main)


def _draw_reference(axes: Axes, traces: Traces, row: Row, window: Window) -> Line2D:
    shown = slice(window.first, window.last + 1)
    t, r = window.sample * np.arange(len(traces.r)), traces.r[:, row.component]
    (line,) = axes.plot(
        t[shown], r[shown], color=REFERENCE, linestyle=(0, (4, 2)), linewidth=0.9, drawstyle="steps-post", zorder=2.0
    )
    return line


def _note(point: Trials, methods: Sequence[str], shown: Mapping[str, Shown], n_single: int) -> str:
    """Say what lines and bands are, and how many runs failed; nothing where every method has one run that is shown."""
    counts = [len(shown[name].rows) for name in methods]
    parts = []
    if max(counts) > 1:
        n_runs = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
        parts.append(f"median and 5\N{EN DASH}95 % band of {n_runs} runs")
        single = {tuple(point.traces[name].runs[shown[name].rows[:n_single]]) for name in methods}
        if n_single:
            parts.append("thin: run " + ", ".join(map(str, *single)) if len(single) == 1 else "thin: single runs")
    n_failed = sum(one.n_failed for one in shown.values())
    return ", ".join([*parts, *([f"{n_failed} failed"] if n_failed else [])])
