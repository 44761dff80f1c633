"""Curves of recorded runs in a panel over time: single runs, or median, band and some single runs of several."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.figures.line_styles import LineStyle, are_rough, paler
from rmpc_bench.figures.recorded_runs import PanelSignal, RunSelection
from rmpc_bench.figures.style import REFERENCE
from rmpc_bench.figures.window import TimeWindow
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

    from rmpc_bench.analysis.traces import Traces
    from rmpc_bench.analysis.trials import Trials

BAND = (0.05, 0.95)
HATCHED, HATCH_WIDTH = 0.35, 0.5
"""Share of white in the pattern of a band, and the width of its lines [points]."""


class CurveOptions(NamedTuple):
    """How recorded runs are drawn."""

    n_single: int
    """Single runs beside median and band."""
    edges: bool
    """Lines around the bands."""
    width: bool = False
    """The width of the band in place of median and band."""
    enlarged: bool = False
    """The first run in place of the median, which is smoother than any run."""


def is_rough(point: Trials, panel: PanelSignal, window: TimeWindow, runs: Mapping[str, RunSelection]) -> bool:
    """Whether some method's steps change direction so often that dashes would be lost in them."""
    having = [name for name in runs if panel.is_held(point.traces[name])]
    if not having:
        return False
    names = [name for name in having if not runs[name].failed] or having
    return are_rough(
        [np.median(panel.curves(point.traces[name], window, runs[name].rows)[1], axis=0) for name in names]
    )


def draw_curves(
    axes: Axes,
    point: Trials,
    panel: PanelSignal,
    window: TimeWindow,
    runs: Mapping[str, RunSelection],
    styles: Mapping[str, LineStyle],
    options: CurveOptions,
    *,
    rough: bool,
) -> None:
    """Draw the methods that have the signal of a panel, those that failed last; rough lines have no dashes."""
    having = [name for name in runs if panel.is_in(point.traces[name])]
    all_failed = all(each.failed for each in runs.values())
    for place, name in enumerate(sorted(having, key=lambda name: runs[name].failed)):
        t, values = panel.curves(point.traces[name], window, runs[name].rows)
        limits, look = axes.get_ylim(), styles[name]
        main = look.line(held=panel.is_held(point.traces[name]), rough=rough) | look.marks(len(t), rough=rough)
        if options.width:
            low, high = np.quantile(values, BAND, axis=0)
            axes.plot(t, high - low, **main)
            axes.axhline(
                float(np.mean(high - low)), color=look.color, ls=look.linestyle, lw=0.6, zorder=2.4, gid=look.gid
            )
        elif len(values) == 1:
            axes.plot(t, values[0], **main)
        else:
            _draw_band(axes, t, values, main, look, options, below=not place)
        if runs[name].failed and not all_failed:
            # The values of a failed run may be huge and must not shrink the other curves.
            axes.set_ylim(limits)


def _draw_band(
    axes: Axes,
    t: Array,
    values: Array,
    main: Mapping[str, Any],
    look: LineStyle,
    options: CurveOptions,
    *,
    below: bool,
) -> None:
    """Draw band, some single runs and median; only the first band is filled, as transparent ones would mix."""
    low, median, high = np.quantile(values, [BAND[0], 0.5, BAND[1]], axis=0)
    step: Any = "post" if main["drawstyle"] == "steps-post" else None
    inside: dict[str, Any] = {"color": paler(look.color, 0.82), "linewidth": 0}
    if not below:
        inside = {"facecolor": "none", "edgecolor": paler(look.color, HATCHED), "hatch": "////"}
        inside["linewidth"] = 0.0
    area = axes.fill_between(t, low, high, step=step, zorder=1.5 + (look.zorder - 2.5), gid=look.gid, **inside)
    area.set_hatch_linewidth(HATCH_WIDTH)
    thin = {key: value for key, value in main.items() if key not in ("marker", "ms", "mew", "mfc", "markevery")}
    for edge in (low, high) if options.edges else ():
        axes.plot(t, edge, **{**thin, "lw": 0.6, "zorder": main["zorder"] - 0.6})
    if options.enlarged:
        axes.plot(t, values[0], **main)
        return
    for run in values[: options.n_single]:
        axes.plot(t, run, **{**thin, "lw": 0.4, "ls": "-", "alpha": 0.8, "zorder": main["zorder"] - 0.5})
    axes.plot(t, median, **main)


def draw_reference(axes: Axes, traces: Traces, panel: PanelSignal, window: TimeWindow) -> Line2D:
    """Draw the reference of an output, dashed and grey."""
    t, r = window.sample * np.arange(len(traces.r)), traces.r[:, panel.component]
    look: dict[str, Any] = {"linestyle": (0, (4, 2)), "linewidth": 0.9, "drawstyle": "steps-post", "zorder": 2.0}
    (line,) = axes.plot(t[window.slice], r[window.slice], color=REFERENCE, **look)
    return line


def mean_widths(
    point: Trials, panel: PanelSignal, window: TimeWindow, runs: Mapping[str, RunSelection]
) -> dict[str, float]:
    """Return the mean width of every method's band over the samples of a window."""
    found = {}
    for name in runs:
        if panel.is_in(point.traces[name]):
            low, high = np.quantile(panel.curves(point.traces[name], window, runs[name].rows)[1], BAND, axis=0)
            found[name] = float(np.mean(high - low))
    return found


def explanation(point: Trials, runs: Mapping[str, RunSelection], options: CurveOptions) -> str:
    """Explain lines and bands and count failed runs; empty if every method shows one run that did not fail."""
    counts = [len(each.rows) for each in runs.values()]
    parts = []
    if max(counts) > 1:
        n_runs = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
        what = "width of the" if options.width else "median and"
        parts.append(f"{what} 5\N{EN DASH}95 % band of {n_runs} runs")
        single = {tuple(point.traces[name].runs[each.rows[: options.n_single]]) for name, each in runs.items()}
        if options.n_single and not options.width:
            parts.append("thin: " + _single(single))
        if options.width:
            parts.append("thin: its mean")
    n_failed = sum(each.n_failed for each in runs.values())
    return ", ".join([*parts, *([f"{n_failed} failed"] if n_failed else [])])


def _single(runs: set[tuple[int, ...]]) -> str:
    return "run " + ", ".join(map(str, *runs)) if len(runs) == 1 else "single runs"
