"""Signals and other quantities over time: a column of panels per method, a row per quantity, the same axes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import dress_small, make_logarithmic
from rmpc_bench.figures.curves import Area, Cell, Choice, cell_of
from rmpc_bench.figures.labels import LINEAR, at_point, joined, literal, name_of, sentence, typeset, wrapped
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.palette import DIM, INK, LineStyle, grouped, line_styles, paler, sample
from rmpc_bench.figures.points import point_at
from rmpc_bench.figures.quantities import issue_of, methods_with, n_rows, quantities
from rmpc_bench.figures.recorded_runs import bursts_of, differences, middle_run, select_runs, shade, spans, window_of
from rmpc_bench.figures.signal_content import EDGES, QUIET, WORDS, Content, needed_points, reach_of, thinned
from rmpc_bench.figures.style import POINTS_PER_INCH, new_figure, style
from rmpc_bench.types import Array, DesignError, NonNegative
from rmpc_bench.types.errors import Issue
from rmpc_bench.types.figure import Inches, Index, OnePointFigure
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials


USUAL = ("y", "u")  # signals that are shown by default
MOST_ROWS = 8  # rows of panels, which may be low: four inputs and three errors are usual
MOST_METHODS = 9  # methods that are shown where none are named
MOST_PANELS = 28  # panels of all methods, about 3 kB each in an SVG
_LAST: list[tuple[Trials, str, Content]] = []  # one entry: a table, the keys of a figure, and what it shows


@dataclass(frozen=True, kw_only=True)
class Signals(OnePointFigure):
    """Signals and other quantities over time, a column per method and a row per quantity on the same axes.

    Recorded runs are thin lines, and the one with the middle value of the primary metric is thick.  The reference is
    dashed, near limits of the controller are dotted, bursts that all runs have are grey.  Failed runs are left out
    unless all failed.

    Quantities, besides recorded signals (``y``, ``u``, ``x``, what a method reports, and the control error
    ``e`` = r - y) and the series of series.csv (``L``, ``theta``, ``P.1,1``):

    - ``error``: x_hat - x with +-3 sqrt(P_ii) that the estimator reports and mean +-3 standard deviations over the
      ensemble, or over at least 10 recorded runs
    - ``variance``: variance of x - x_hat over the ensemble, and the reported one, which it should not exceed
    - ``mean``: mean of x and of x_hat over the ensemble
    - ``nees``, ``nis``: normalised square of error or innovation, averaged over the runs and divided by the degrees of
      freedom, with the chi-square band of a consistent estimator (Bar-Shalom, Li, Kirubarajan 2001, Section 5.4)
    - ``tube``: the true state and the estimate of the thick run, with the set M that the method reports about the
      estimate, else the ellipsoid of P at `level`; states outside of it are hollow circles

    Parameters
    ----------
    signals : quantities, from top to bottom; a single component, counted from 0, follows a dot (x_hat.2, error.0);
        y and u if not given
    show : of recorded signals the `runs`, their median with the `band` from 5 to 95 %, its `width`, or the `difference`
        from the same run of the baseline
    run : index of the thick run; that with the middle value of the primary metric if not given
    runs : number of thin runs, from the first one on; as many as fit if not given
    level : probability of the band of `nees` and `nis` and of the ellipsoid of P, such as 95%
    log : logarithmic axes, linear where a value is not positive; those of `nees` and `nis` only if not given
    from_ : first time to show [s]
    to : last time to show [s]
    height : height of the whole picture [in]; if not given 0.6 and 1.2 for every row of panels; the legend adds to it
    order : methods to show, from left to right; the first that have a quantity, 9 at most, if not given
    """

    width: Inches = 7.2
    signals: list[str] | None = None
    show: Literal["runs", "band", "width", "difference"] = "runs"
    run: Index | None = None
    runs: Annotated[int, Ge(0), Le(1000)] | None = None
    level: Annotated[float, Gt(0), Lt(1)] = 0.95
    log: bool | None = None
    from_: NonNegative | None = None
    to: NonNegative | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: quantities of the methods, as many as panels fit, in a window with samples."""
        yield from super().check(layout)
        if not layout.is_complete:
            return
        names = self._names(layout)
        if not layout.has_runs and any(not methods_with(layout, text) for text in names if text in USUAL):
            yield from layout.require_runs()
            return
        issues = list(dict.fromkeys(issue for text in names if (issue := issue_of(layout, text)) is not None))
        yield from issues
        if not names:
            yield Issue("signals", "must name at least one signal")
        having = {name for text in names for name in methods_with(layout, text)}
        if not issues:
            advice = "choose components such as x.0"
            n = n_rows(layout, names)
            yield from layout.require_at_most(MOST_ROWS, n, "rows of panels", "signals", advice)
            named = n * len(self.order or ())
            yield from layout.require_at_most(MOST_PANELS, named, "panels", "order", "name fewer methods or signals")
            those = ", ".join(sorted(having)) or "none"
            lacking = [name for name in self.order or () if name in layout.methods and name not in having]
            for name in lacking if len(layout.points) <= 1 else ():
                yield Issue("order", f"'{name}' has none of {', '.join(names)} (those that have: {those})")
        if self.run is not None:
            yield from layout.require_recorded(self.run)
        if self.show == "difference" and len(layout.methods) < 2:
            yield Issue("show", "compares methods with the baseline: needs at least two methods")
        yield from layout.require_window(self.from_, self.to)

    def caption(self, results: Trials) -> str:
        """Say what the rows, the thin and the thick lines are; see `Figure.caption`."""
        made = self._content(results)
        names = joined(dict.fromkeys(quantity.label(made.point) for quantity in made.rows))
        failed = [name_of(made.point, name) for name, each in made.selections.items() if each.failed]
        kinds = made.kinds()
        return sentence(
            f"{names} over time, {made.window.words}{at_point(made.title)}, of "
            f"{joined(name_of(made.point, n) for n in made.cells)} on the same axes",
            f"the first {len(made.cells)} methods are shown" if made.left_out else "",
            *(f"{WORDS[kind].look}: {made.words(kind)}" for kind in WORDS if kind in kinds),
            f"all recorded runs of {joined(failed)} failed" if failed else "",
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw the panels of one point; see `Figure.draw`."""
        made = self._content(results)
        columns = made.columns(self.width)
        return draw_panels(made, self.size(0.6 + 1.2 * len(made.rows) * -(-len(made.cells) // columns)), columns)

    def _content(self, results: Trials) -> Content:
        """Return what is shown; the caption of a picture that was just drawn computes nothing again."""
        if not (_LAST and _LAST[0][0] is results and _LAST[0][1] == repr(self)):
            _LAST[:] = [(results, repr(self), self._compute(results))]
        return _LAST[0][2]

    def _compute(self, results: Trials) -> Content:
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        names = self._names(layout)
        having = {name for text in names for name in methods_with(layout, text)}
        methods = [name for name in self.order or layout.methods if name in having]
        if self.show == "difference":
            methods = [name for name in methods if name != point.baseline]
            if not methods:
                raise DesignError(f"no run of a method besides the baseline '{point.baseline}' is recorded", "show")
            point = differences(point, methods)
        rows = tuple(quantities(layout, names))
        most = min(MOST_METHODS, MOST_PANELS // len(rows))
        left_out = () if self.order else methods[most:]
        methods = methods if self.order else methods[:most]
        selections = {name: select_runs(point, name) for name in methods if name in point.traces}
        if any(each.failed for each in selections.values()):
            point = replace(point, traces=point.exported_traces())
        window = window_of(point, _last(point, methods), self.from_, self.to)
        cells: dict[str, list[Cell | None]] = {}
        for name in methods:
            chosen = selections.get(name)
            middle = 0 if chosen is None else middle_run(point, name, chosen.rows, self.run)
            choice = Choice(self.show, chosen, middle, self.runs, self.level, self.log)
            found = [cell_of(point, name, row, window, choice) for row in rows]
            cells |= {name: found} if any(each is not None for each in found) else {}
        if not cells:
            raise DesignError(f"no method has a finished run with {joined(names)}", "signals")
        return Content(point, title, rows, cells, window, selections, self.log, self.level, self.run, bool(left_out))

    def _names(self, layout: ResultLayout) -> Sequence[str]:
        """Quantities to show; by default the usual signals that are recorded."""
        if self.signals is not None:
            return self.signals
        return tuple(name for name in USUAL if name in layout.signal_names) or USUAL


def _last(point: Trials, methods: Sequence[str]) -> int:
    """Find the last sample that any of the methods has."""
    recorded = [len(point.traces[name].r) - 1 for name in methods if name in point.traces]
    return max([0, *recorded, *(len(each.values) - 1 for each in point.over_time if each.method in methods)])


MANY = 30.0  # ratio of the ends of a logarithmic axis up to which it has more ticks than powers of ten
ALONE = 1.1  # width of a thick line without thin ones [pt]


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
