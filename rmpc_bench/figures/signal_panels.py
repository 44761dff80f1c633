"""The panels of quantities over time and their common axes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.figures.axes import dress_small, make_logarithmic
from rmpc_bench.figures.curves import Area, Cell
from rmpc_bench.figures.labels import LINEAR, literal, name_of, typeset, wrapped
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.palette import DIM, INK, LineStyle, grouped, line_styles, paler, sample
from rmpc_bench.figures.recorded_runs import bursts_of, shade, spans
from rmpc_bench.figures.signal_content import EDGES, QUIET, WORDS, Content, needed_points, reach_of, thinned
from rmpc_bench.figures.style import POINTS_PER_INCH, new_figure, style
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure


MANY = 30.0
"""Ratio of the ends of a logarithmic axis up to which it has more ticks than powers of ten."""
ALONE = 1.1
"""Width of a thick line without thin ones [pt]."""


def draw_panels(made: Content, size: tuple[float, float], n_columns: int) -> MplFigure:
    """Draw a block of rows for as many methods as there are columns, and further blocks below it."""
    methods, n = list(made.cells), len(made.rows)
    styles = line_styles(made.point.all_methods, methods)
    n_blocks = -(-len(methods) // n_columns)
    with style():
        figure = new_figure(size)
        grid: Any = figure.subplots(n * n_blocks, n_columns, sharex=True, squeeze=False)
        shown = [[cell for cells in made.cells.values() if (cell := cells[row]) is not None] for row in range(n)]
        heights = [float(np.ptp(reach_of(cells)[0])) if cells else 0.0 for cells in shown]
        thin = thinned([*zip(heights, shown, strict=True)])
        for place in range(n_columns * n_blocks):
            block, column = divmod(place, n_columns)
            for row in range(n):
                axes = grid[block * n + row, column]
                cell = made.cells[methods[place]][row] if place < len(methods) else None
                if cell is None:
                    axes.set_visible(False)
                    continue
                with grouped(axes, styles[methods[place]].gid):
                    _draw_cell(axes, cell, thin, styles[methods[place]], heights[row])
                dress_small(axes, clip_on=False)
                axes.tick_params(bottom=False, left=False, labelbottom=False, labelleft=False)
            if place < len(methods):
                panels = [grid[block * n + row, column] for row in range(n)]
                top = next((axes for axes in panels if axes.get_visible()), panels[0])
                words = typeset(name_of(made.point, methods[place]))
                lines = wrapped(words, 0.8 * size[0] / n_columns * POINTS_PER_INCH)
                top.set_title("\n".join(lines), loc="left", weight="bold").set_gid(styles[methods[place]].gid)
        _align(made, grid, n, n_columns)
        _label_edges(made, grid, n)
        grid[0, 0].set_xlim(*made.window.limits)
        keys = _keys(made)
        rows = {name: each.rows for name, each in made.selections.items() if name in made.cells}
        if rows:
            panels = [axes for axes in grid.flat if axes.get_visible()]
            keys += shade(panels, spans(bursts_of(made.point, rows), made.window))
        finish(figure, keys, literal(made.title), columns=True)
    return figure


def _draw_cell(axes: Axes, cell: Cell, thin: Mapping[int, Array], look: LineStyle, height: float) -> None:
    """Draw areas, levels and lines; `height` is that of the panel in the unit of the quantity."""
    for area in cell.areas:
        how = dict(WORDS[area.kind].style)
        colour = how.pop("color") or paler(look.color, 0.75)
        _fill(axes, area, height, color=colour, lw=0, **how)
        ink = INK if area.kind == "reported" else look.color
        for edge in (area.low, area.high) if area.kind in EDGES else ():
            axes.plot(area.t, edge, color=ink, lw=0.7, ls=EDGES[area.kind], zorder=2.4)
    for kind, value in cell.levels:
        if kind != "limit":
            axes.axhline(value, **_coloured(QUIET[kind] if kind in QUIET else WORDS[kind].style, look))
    runs = [line for line in cell.lines if line.kind == "run" and len(thin[id(line)])]
    for line in cell.lines:
        if line.kind != "run":
            kept = thin.get(id(line), slice(None))
            (artist,) = axes.plot(line.t[kept], line.values[kept], **_coloured(WORDS[line.kind].style, look))
            if line.kind == "main" and not runs:
                artist.set_linewidth(ALONE)
    if runs:
        # One line with gaps has a fifth of the bytes of many lines.
        shown = [(line, thin[id(line)]) for line in runs]
        t = np.concatenate([np.append(line.t[own], np.nan) for line, own in shown])
        values = np.concatenate([np.append(line.values[own], np.nan) for line, own in shown])
        axes.plot(t, values, **WORDS["run"].style)


def _fill(axes: Axes, area: Area, height: float, **how: Any) -> None:
    """Fill an area, with few points where it has no gaps."""
    if not (np.isfinite(area.low).all() and np.isfinite(area.high).all()):
        axes.fill_between(area.t, area.low, area.high, **how)
        return
    below, above = (needed_points(area.t, edge, height) for edge in (area.low, area.high))
    outline = np.append(area.t[below], area.t[above][::-1]), np.append(area.low[below], area.high[above][::-1])
    axes.fill(*outline, **how)


def _coloured(how: Mapping[str, Any], look: LineStyle) -> dict[str, Any]:
    return {**how, "color": how["color"] or look.color}


def _label_edges(made: Content, grid: Any, n: int) -> None:
    """Label the outermost panels of every block: the first one of a row, the last one of a column."""
    for start in range(0, len(grid), n):
        for row, quantity in enumerate(made.rows):
            for axes in [axes for axes in grid[start + row] if axes.get_visible()][:1]:
                axes.tick_params(left=True, labelleft=True)
                linear = made.log and axes.get_yscale() == "linear"
                axes.set_ylabel(quantity.label(made.point) + (LINEAR if linear else ""))
        for column in range(grid.shape[1]):
            for axes in [axes for axes in grid[start : start + n, column] if axes.get_visible()][-1:]:
                axes.tick_params(bottom=True, labelbottom=True)
                axes.set_xlabel(made.window.label)


def _align(made: Content, grid: Any, n: int, n_columns: int) -> None:
    """Give the panels of a quantity the same vertical axis, and draw the limits that lie in its reach."""
    failed = {name for name, each in made.selections.items() if each.failed}
    for row, quantity in enumerate(made.rows):
        shown = {
            name: (grid[place // n_columns * n + row, place % n_columns], cell)
            for place, (name, cells) in enumerate(made.cells.items())
            if (cell := cells[row]) is not None
        }
        if not shown:
            continue
        good = [cell for name, (_, cell) in shown.items() if name not in failed]
        ends, limits = reach_of(good or [cell for _, cell in shown.values()])
        log = quantity.kind in ("nees", "nis") if made.log is None else made.log
        log = log and ends[0] > 0
        for axes, cell in shown.values():
            if log:
                _make_logarithmic(axes, *_padded(*ends, log=True))
            for level in limits:
                if ("limit", level) in cell.levels:
                    axes.axhline(level, **WORDS["limit"].style)
            axes.set_ylim(*_padded(*ends, log=log))


def _make_logarithmic(axes: Axes, low: float, high: float) -> None:
    """Make the vertical axis logarithmic; a low panel has room for powers of ten where it spans several."""
    from matplotlib.ticker import LogLocator, NullLocator

    axes.set_ylim(low, high)
    make_logarithmic(axes)
    if high > MANY * low:
        axes.yaxis.set_major_locator(LogLocator(numticks=5))
    axes.yaxis.set_minor_locator(NullLocator())


def _padded(low: float, high: float, *, log: bool) -> tuple[float, float]:
    """Limits of an axis with some room at both ends."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return 0.0, 1.0
    if log:
        pad = (high / low) ** 0.05 if high > low else 2.0
        return low / pad, high * pad
    pad = 0.05 * (high - low) or 0.5 * abs(low) or 1.0
    return low - pad, high + pad


def _keys(made: Content) -> list[Handle]:
    """Explain the kinds of lines and areas, in grey what has the colour of its method."""
    from matplotlib.patches import Patch

    found: list[Handle] = []
    areas = {area.kind for cells in made.cells.values() for cell in cells if cell for area in cell.areas}
    kinds = made.kinds()
    for kind in WORDS:
        if kind not in kinds:
            continue
        how = dict(WORDS[kind].style)
        colour = how.pop("color") or DIM
        if kind in areas:
            found.append((made.words(kind), Patch(color=paler(DIM, 0.75), lw=0)))
        else:
            found.append((made.words(kind), sample(color=colour, **how)))
    return found
