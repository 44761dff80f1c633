"""Trajectories: recorded signals over time, one panel each, as a single run or as median and band of several."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Le

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures import burst_bands
from rmpc_bench.figures.axes import stacked_panels
from rmpc_bench.figures.labels import component_label, symbol, unit_of, with_unit
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import LineStyle, are_rough, legend_sample, line_styles
from rmpc_bench.figures.recorded_runs import (
    ERROR,
    OUTPUT,
    PanelSignal,
    RunSelection,
    last_sample,
    select_runs,
)
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.figures.sweep_points import point_at
from rmpc_bench.figures.window import TimeWindow, window_of
from rmpc_bench.types import Array, NonNegative
from rmpc_bench.types.figure import OnePointFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout, Shape

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.lines import Line2D

    from rmpc_bench.analysis.traces import Traces
    from rmpc_bench.analysis.trials import Trials

SingleRuns = Annotated[int, Ge(0), Le(10)]
USUAL = ("y", "u")
"""Signals that are shown by default."""
MOST_SIGNALS = 8
"""Panels, which may be low: four inputs and three errors are usual."""
BAND = (0.05, 0.95)


@dataclass(frozen=True, kw_only=True)
class Trajectories(OnePointFigure):
    """Recorded signals over time, one panel each; the methods share a panel, and the reference is dashed.

    A single recorded run is drawn as it is.  Of several the figure shows the median (thick), the band from 5 to 95 %
    and single runs (thin), without the runs that failed.  Bursts of the noise are shaded if they are the same in all
    runs that are shown.  A method without a signal is left out of its panels.

    Parameters
    ----------
    signals : signals to show, from top to bottom, such as y, u, a signal that a method reports, the control error
        e = r - y or, a single component counted from 0, x_hat.2; the components of a matrix count row by row; y and u
        if not given
    from_ : first time to show [s]
    to : last time to show [s]
    runs : number of single runs to show beside median and band, from the first one on
    edges : lines around the bands, which distinguish overlapping bands of several methods
    height : height of the whole picture [in]; if not given 0.8 and 1.2 for every panel; legend and title add to it if
        they need more than a line
    order : methods to show, later ones above earlier ones; all that have recorded runs if not given
    """

    needs_runs: ClassVar[bool] = True

    signals: list[str] | None = None
    from_: NonNegative | None = None
    to: NonNegative | None = None
    runs: SingleRuns = 1
    edges: bool = False

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: recorded signals, as many as panels fit, in a window that holds samples."""
        yield from super().check(layout)
        yield from layout.require_signals()
        yield from layout.require_traces(self.order)
        if not layout.recorded:
            return
        issues, n_panels = [], 0
        for text in self._names(layout):
            shape, issue = _shape_of(layout, text)
            issues += [issue] if issue else []
            n_panels += 1 if "." in text or shape is None else math.prod(shape)
        yield from issues
        if not issues:
            advice = "choose components such as x.0"
            yield from layout.require_at_most(MOST_SIGNALS, n_panels, "panels", "signals", advice)
        if self.signals == []:
            yield Issue("signals", "must name at least one signal")
        yield from layout.require_window(self.from_, self.to)

    def draw(self, results: Trials) -> MplFigure:
        """Draw the recorded runs of one point; see `Figure.draw`."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods = self.order or list(layout.signals)
        components = [each for text in self._names(layout) for each in _components(point, layout, text)]
        window = window_of(point, last_sample(point, methods[0]), self.from_, self.to)
        size = self.size(0.8 + 1.2 * len(components))
        return _draw(point, title, methods, components, window, self.runs, size, edges=self.edges)

    def _names(self, layout: ResultLayout) -> Sequence[str]:
        """Signals to show; by default the usual ones that are recorded."""
        if self.signals is not None:
            return self.signals
        return tuple(name for name in USUAL if name in layout.signal_names) or USUAL


def _shape_of(layout: ResultLayout, text: str) -> tuple[Shape | None, Issue | None]:
    """Find the shape of a signal, None if it is not known, and what is wrong with a text such as ``x_hat.2``."""
    name, dot, index = text.partition(".")
    recorded = OUTPUT if name == ERROR and ERROR not in layout.signal_names else name
    shapes = [signals[recorded] for signals in layout.signals.values() if recorded in signals]
    if not shapes:
        return None, Issue("signals", f"{name!r} is not recorded (recorded: {', '.join(layout.signal_names)})")
    shape = None if None in shapes else min((each for each in shapes if each is not None), key=math.prod)
    n = None if shape is None else math.prod(shape)
    if dot and not (index.isdecimal() and (n is None or int(index) < n)):
        last = f" to {name}.{n - 1}" if n is not None else ""
        return shape, Issue("signals", f"{text!r} is not a component (they count from {name}.0{last})")
    return shape, None


def _components(point: Trials, layout: ResultLayout, text: str) -> list[PanelSignal]:
    """Find the panels of a text such as ``y`` or ``x_hat.2``; a signal stands for all its components."""
    name, dot, index = text.partition(".")
    shape, _ = _shape_of(layout, text)
    assert shape is not None, "recorded signals have known shapes"
    found = []
    for component in [int(index)] if dot else range(math.prod(shape)):
        place = ",".join(map(str, np.unravel_index(component, shape))) if math.prod(shape) > 1 else ""
        label = component_label(point, name, component, place)
        if name == ERROR:
            label = with_unit(symbol(name, place), unit_of(point, f"{OUTPUT}.{component}"))
        found.append(PanelSignal(name, component, label))
    return found


def _draw(
    point: Trials,
    title: str,
    methods: Sequence[str],
    components: Sequence[PanelSignal],
    window: TimeWindow,
    n_single: int,
    size: tuple[float, float],
    *,
    edges: bool,
) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure

    methods = [name for name in methods if any(each.is_in(point.traces[name]) for each in components)]
    styles = line_styles(point.all_methods, methods)
    runs = {name: select_runs(point, name) for name in methods}
    rough = [_is_rough(point, component, window, runs) for component in components]
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels = stacked_panels(figure, len(components))
        handles: list[Handle] = []
        for name in methods:
            failed = " (failed)" if runs[name].failed else ""
            sample = legend_sample(styles[name], rough=all(rough))
            handles.append((point.labels.get(name, name) + failed, sample))
        for axes, component, solid in zip(panels, components, rough, strict=True):
            if component.signal == OUTPUT:
                reference = _draw_reference(axes, point.traces[methods[0]], component, window)
                handles += [("reference", reference)] if len(handles) == len(methods) else []
            _draw_panel(axes, point, component, window, runs, styles, n_single, rough=solid, edges=edges)
        rows = {name: each.rows for name, each in runs.items()}
        handles += burst_bands.shade(panels, burst_bands.spans(burst_bands.bursts_of(point, rows), window))
        panels[-1].set_xlim(*window.limits)
        panels[-1].set_xlabel(window.label)
        finish(figure, handles, "\n".join(filter(None, [title, _note(point, runs, n_single)])))
    return figure


def _is_rough(point: Trials, component: PanelSignal, window: TimeWindow, runs: Mapping[str, RunSelection]) -> bool:
    """Whether some method's steps change direction so often that dashes would be lost in them."""
    having = [name for name in runs if component.is_held(point.traces[name])]
    if not having:
        return False
    names = [name for name in having if not runs[name].failed] or having
    return are_rough(
        [np.median(component.curves(point.traces[name], window, runs[name].rows)[1], axis=0) for name in names]
    )


def _draw_panel(
    axes: Axes,
    point: Trials,
    component: PanelSignal,
    window: TimeWindow,
    runs: Mapping[str, RunSelection],
    styles: Mapping[str, LineStyle],
    n_single: int,
    *,
    rough: bool,
    edges: bool,
) -> None:
    """Draw the methods that have the signal of a panel, those that failed last."""
    having = [name for name in runs if component.is_in(point.traces[name])]
    all_failed = all(each.failed for each in runs.values())
    for name in sorted(having, key=lambda name: runs[name].failed):
        t, values = component.curves(point.traces[name], window, runs[name].rows)
        limits = axes.get_ylim()
        main = styles[name].line(held=component.is_held(point.traces[name]), rough=rough)
        _draw_runs(axes, t, values, main, n_single, edges=edges)
        if runs[name].failed and not all_failed:
            # The values of a failed run may be huge and must not shrink the other curves.
            axes.set_ylim(limits)
    axes.set_ylabel(component.label)


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


def _draw_reference(axes: Axes, traces: Traces, component: PanelSignal, window: TimeWindow) -> Line2D:
    t, r = window.sample * np.arange(len(traces.r)), traces.r[:, component.component]
    look: dict[str, Any] = {"linestyle": (0, (4, 2)), "linewidth": 0.9, "drawstyle": "steps-post", "zorder": 2.0}
    (line,) = axes.plot(t[window.slice], r[window.slice], color=REFERENCE, **look)
    return line


def _note(point: Trials, runs: Mapping[str, RunSelection], n_single: int) -> str:
    """Explain lines and bands and count failed runs; empty if every method shows one run that did not fail."""
    counts = [len(each.rows) for each in runs.values()]
    parts = []
    if max(counts) > 1:
        n_runs = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
        parts.append(f"median and 5\N{EN DASH}95 % band of {n_runs} runs")
        single = {tuple(point.traces[name].runs[each.rows[:n_single]]) for name, each in runs.items()}
        if n_single:
            parts.append("thin: run " + ", ".join(map(str, *single)) if len(single) == 1 else "thin: single runs")
    n_failed = sum(each.n_failed for each in runs.values())
    return ", ".join([*parts, *([f"{n_failed} failed"] if n_failed else [])])
