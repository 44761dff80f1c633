"""Panels of estimation errors: one per state and method, with the reported band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.estimation_errors import ErrorMoments, ErrorRuns
from rmpc_bench.figures.axes import STEPS, drawable
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, symbol, typeset, unit_of, with_unit, wrapped
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import line_styles, paler
from rmpc_bench.figures.method_groups import grouped
from rmpc_bench.figures.style import BLACK, GREY, REFERENCE, style
from rmpc_bench.figures.window import TimeWindow
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

INSIDE = "#f0f0f0"
"""Colour of the reported band, paler than the grid."""
EDGE: dict[str, Any] = {"color": BLACK, "ls": (0, (4, 2)), "lw": 0.9, "zorder": 2.7}
SINGLE: dict[str, Any] = {"lw": 0.5, "zorder": 2.2}
SPREAD: dict[str, Any] = {"lw": 0.8, "zorder": 2.5}
MEAN_LINE: dict[str, Any] = {"lw": 1.4, "zorder": 2.6}


class ErrorLines(NamedTuple):
    """Errors of a method and its reported band."""

    single: Array
    """(runs, samples, n) errors of the runs that are shown one by one."""
    moments: ErrorMoments | None
    """Of the ensemble, None where there are none."""
    band: Array
    """(samples, n) three reported standard deviations."""
    recorded: ErrorRuns | None
    """All recorded runs, None where there are none."""
    own: bool
    """Whether every run has its own covariance."""


def draw_errors(
    point: Trials,
    title: str,
    methods: Mapping[str, ErrorLines],
    states: Sequence[int],
    window: TimeWindow,
    size: tuple[float, float],
    n_columns: int,
) -> MplFigure:
    """Draw a panel per state and method; one column puts the methods below each other, else each is a column."""
    from matplotlib.figure import Figure as MplFigure

    styles = line_styles(point.all_methods, list(methods))
    side_by_side = n_columns > 1
    n_rows = len(states) * (1 if side_by_side else len(methods))
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        sharey: Any = "row" if side_by_side else False
        grid: Any = figure.subplots(n_rows, n_columns, sharex=True, sharey=sharey, squeeze=False)
        for number, (name, lines) in enumerate(methods.items()):
            first = 0 if side_by_side else number * len(states)
            for row, state in enumerate(states, first):
                axes = grid[row, number if side_by_side else 0]
                with grouped(axes, styles[name].gid):
                    _draw_panel(axes, lines, state, window, styles[name].color)
                if not side_by_side or number == 0:
                    axes.set_ylabel(_label(point, state, len(lines.band[0])))
            text = typeset(point.labels.get(name, name))
            head = grid[first, number if side_by_side else 0]
            title_of = head.set_title("\n".join(wrapped(text, 0.9 * size[0] * POINTS_PER_INCH / n_columns)))
            title_of.set_gid(styles[name].gid)
        grid[0, 0].set_xlim(*window.limits)
        for axes in grid[-1]:
            axes.set_xlabel(window.label)
        finish(figure, _keys(methods.values()), literal(title), columns=True)
    return figure


def _draw_panel(axes: Axes, lines: ErrorLines, state: int, window: TimeWindow, color: str) -> None:
    """Draw band, single runs, mean and spread of a state."""
    from matplotlib.ticker import MaxNLocator

    axes.grid(color=GREY, linewidth=0.4)
    axes.set_axisbelow(True)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
    t = window.sample * np.arange(window.first, window.last + 1)
    band = drawable(lines.band[window.slice, state])
    axes.fill_between(t, -band, band, color=INSIDE, lw=0, zorder=0.2)
    axes.axhline(0.0, color=REFERENCE, lw=0.6, zorder=2.1)
    for edge in (-band, band):
        axes.plot(t, edge, **EDGE)
    for run in lines.single:
        shade = color if lines.moments is None else paler(color, 0.35)
        axes.plot(t, drawable(run[window.slice, state]), color=shade, **SINGLE)
    if lines.moments is not None:
        mean = lines.moments.mean[window.slice, state]
        std = lines.moments.std[window.slice, state]
        for edge in (mean - 3 * std, mean + 3 * std):
            axes.plot(t, drawable(edge), color=color, **SPREAD)
        axes.plot(t, drawable(mean), color=color, **MEAN_LINE)


def _label(point: Trials, state: int, n: int) -> str:
    """Label a state's error by the difference of the two symbols, with its unit."""
    place = str(state) if n > 1 else ""
    difference = f"{symbol('x_hat', place)} \N{MINUS SIGN} {symbol('x', place)}"
    return with_unit(difference, unit_of(point, f"x.{state}"))


def _keys(methods: Any) -> list[Handle]:
    """Explain the lines, in grey."""
    from matplotlib.lines import Line2D

    lines: list[ErrorLines] = list(methods)
    found: list[Handle] = [(r"reported $\pm 3\sigma$", Line2D([], [], **EDGE))]
    if any(len(each.single) for each in lines):
        found.append(("single runs", Line2D([], [], color=paler(REFERENCE, 0.2), lw=0.7)))
    moments = [each.moments for each in lines if each.moments is not None]
    if moments:
        counts = sorted({each.n for each in moments})
        source = " or ".join(f"{n} runs" if n else "exact" for n in counts)
        found.append((f"mean ({source})", Line2D([], [], color=REFERENCE, lw=MEAN_LINE["lw"])))
        found.append((r"mean $\pm 3$ std", Line2D([], [], color=REFERENCE, lw=SPREAD["lw"])))
    return found
