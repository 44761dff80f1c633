"""Columns of a figure of rows: their axis, and what they draw of every row, such as the box of its runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import wilson
from rmpc_bench.analysis.ranks import ranking
from rmpc_bench.analysis.result_rows import BETTER, FAILS_MORE, WORSE, Form, ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, change_texts, difference_texts
from rmpc_bench.figures.axes import Axis, Log, Tick, change_axis, draw_no_change, scaled_axis, set_axis, spaced
from rmpc_bench.figures.labels import LINEAR, metric_label, name_of, typeset, width, with_unit, wrapped
from rmpc_bench.figures.palette import BAND, GROUND, INK, PRINT
from rmpc_bench.figures.points import common_form, shown_change
from rmpc_bench.figures.style import POINTS_PER_INCH
from rmpc_bench.types import DesignError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from rmpc_bench.analysis.trials import Trials

VERDICT_COLOURS = {BETTER: PRINT["better"], WORSE: PRINT["worse"], FAILS_MORE: PRINT["fail"]}
"""Word of a verdict -> colour; that of any other is the ink."""
WIDTH, CAP = 0.56, 0.28  # widths of a box and of the end of a whisker, as shares of the distance of two boxes
TINT = 0.18  # opacity of the colour of a verdict in a box
THIN, MEDIAN = 0.8, 1.8  # widths of the lines of a box and of its median [pt]


def draw_box(axes: Axes, row: ResultRow, place: float, axis: Axis, *, upright: bool = False) -> None:
    """Draw the box of a method; a box or whisker without end has an arrow at the end of the axis."""
    from matplotlib.patches import Rectangle

    if not row.quantiles:
        return
    back = math.exp if axis.log else float
    first, last = back(axis.low), back(axis.high)
    low, q1, median, q3, high = (min(max(each, first), last) for each in row.quantiles)
    gid = f"method-{row.method}"
    colour = VERDICT_COLOURS.get(row.word)
    face: Any = (colour, TINT) if colour else BAND
    corner, size = (q1, place - WIDTH / 2), (q3 - q1, WIDTH)
    corner, size = (corner[::-1], size[::-1]) if upright else (corner, size)
    axes.add_patch(Rectangle(corner, *size, facecolor=face, edgecolor=INK, lw=THIN, gid=gid, zorder=2.2))
    whiskers = [(low, q1, 0.0), (q3, high, 0.0)]
    whiskers += [(end, end, CAP) for end, known in ((low, low), (high, row.quantiles[-1])) if math.isfinite(known)]
    for parts, thick in ((whiskers, THIN), ([(median, median, WIDTH)], MEDIAN)):
        # One line with gaps takes less of a file than several.
        values = np.array([[start, end, math.nan] for start, end, _ in parts]).ravel()
        places = np.array([[place - across / 2, place + across / 2, math.nan] for *_, across in parts]).ravel()
        x, y = (places, values) if upright else (values, places)
        axes.plot(x, y, color=INK, lw=thick, solid_capstyle="butt", gid=gid, zorder=2.3)
    if not math.isfinite(row.quantiles[-1]):
        point, marker = ((place, last), "^") if upright else ((last, place), ">")
        axes.plot(*point, ls="", marker=marker, ms=4, color=INK, clip_on=False, gid=gid, zorder=2.4)


PALE = 0.6  # opacity of an interval without the adjustment, which is thin
LINE, DOT = 2.0, 4.5  # width of an interval and size of its middle [pt]
APART = 4.0  # free width between the labels of two ticks [pt]
LEFT, RIGHT = "◀", "▶"
COMPARED = {"ratio": "change against {}", "difference": "difference from {}", "share": "share of runs better than {}"}


class Options(NamedTuple):
    """Keys of the figure that its columns need."""

    log: Log
    above: float
    ranked: bool  # whether the changes are those over all points


class Column(NamedTuple):
    """A column of a figure."""

    axis: Axis
    label: str
    draw_row: Callable[[Axes, ResultTable, ResultRow, int], None]
    reference: Callable[[Axes], None] = lambda axes: None  # draws what stands behind the rows
    order: Sequence[str] = ()  # methods from top to bottom, where the column gives the order

    def draw(self, axes: Axes, table: ResultTable, rows: Sequence[ResultRow]) -> None:
        """Draw the rows of a point."""
        set_axis(axes, self.axis)
        self.reference(axes)
        for place, row in enumerate(rows):
            self.draw_row(axes, table, row, place)

    def finish(self, axes: Axes) -> None:
        """Label the axis below the last point, with as many ticks as have room."""
        figure = axes.get_figure(root=True)
        assert figure is not None
        room = axes.get_position().width * figure.get_figwidth() * POINTS_PER_INCH
        back = math.exp if self.axis.log else float
        ticks = with_room(self.axis, room)
        axes.set_xticks([back(tick.at) for tick in ticks], [tick.label for tick in ticks])
        axes.set_xlabel("\n".join(wrapped(self.label, room)))


def with_room(axis: Axis, room: float) -> tuple[Tick, ...]:
    """Leave out ticks whose labels would touch."""
    scale = room / (axis.high - axis.low)
    labels = {tick: width(tick.label) / 2 for tick in axis.ticks}
    return spaced(axis.ticks, lambda tick, last: abs(tick.at - last.at) * scale >= labels[tick] + labels[last] + APART)


def column_of(
    name: str, results: Trials, tables: Sequence[ResultTable], rows: Sequence[Sequence[ResultRow]], keys: Options
) -> Column:
    """Prepare a column for the rows of all points."""
    if name == "change":
        return _ratios(results) if keys.ranked else _changes(tables, rows)
    return _ranks(results) if name == "rank" else _COLUMNS[name](tables, rows, keys)


def _values(tables: Sequence[ResultTable], rows: Sequence[Sequence[ResultRow]], keys: Options) -> Column:
    """Boxes of the runs."""
    axis, label = _value_axis(tables[0], [end for shown in rows for row in shown for end in row.quantiles], keys)
    return Column(axis, label, lambda axes, table, row, place: draw_box(axes, row, place, axis))


def _means(tables: Sequence[ResultTable], rows: Sequence[Sequence[ResultRow]], keys: Options) -> Column:
    """Means of the runs that have a value, with their intervals."""
    axis, label = _value_axis(tables[0], [end for shown in rows for row in shown for end in row.mean], keys)
    return Column(
        axis, f"mean {label}", lambda axes, table, row, place: _interval(axes, row.mean, place, INK, row.method)
    )


def _value_axis(table: ResultTable, values: Sequence[float], keys: Options) -> tuple[Axis, str]:
    """Return the axis of values of the metric, and its label."""
    axis = scaled_axis(values, keys.log)
    return axis, metric_label(table.info) + (LINEAR if keys.log is True and not axis.log else "")


def _interval(axes: Axes, value: Estimate, place: float, colour: str, method: str) -> None:
    """Draw a mark with its interval; the axis cuts what lies beyond it."""
    look: dict[str, Any] = {"color": colour, "gid": f"method-{method}"}
    if not math.isnan(value.half):
        axes.plot([value.low, value.high], [place, place], lw=LINE, solid_capstyle="butt", zorder=2.3, **look)
    if math.isfinite(value.value):
        axes.plot([value.value], [place], ls="", marker="o", ms=DOT, zorder=2.4, **look)


def _changes(tables: Sequence[ResultTable], rows: Sequence[Sequence[ResultRow]]) -> Column:
    """Changes against the baseline, in the form that all points have."""
    form, first = common_form(tables), tables[0]
    margin = max(table.margin for table in tables) if form != "share" else 0.0
    shown = [(table, row) for table, there in zip(tables, rows, strict=True) for row in there]
    shown = [(table, row) for table, row in shown if row.compared and row.quantiles]
    found = [shown_change(row, form) for _, row in shown]
    found += [_unadjusted(row, form) for _, row in shown if row.is_adjusted and form != "share"]
    axis = change_axis(form, found, margin)
    unit = first.info.unit if form == "difference" else ""
    label = with_unit(typeset(COMPARED[form].format(name_of(first.trials, first.baseline))), unit)

    def draw(axes: Axes, table: ResultTable, row: ResultRow, place: int) -> None:
        if row.compared and row.quantiles:
            value = shown_change(row, form)
            colour = VERDICT_COLOURS.get(row.word, INK)
            if row.is_adjusted and form != "share":
                wide = _unadjusted(row, form)
                look: dict[str, Any] = {"lw": THIN, "alpha": PALE, "gid": f"method-{row.method}"}
                axes.plot([wide.low, wide.high], [place, place], color=colour, zorder=2.2, **look)
            _change(axes, axis, value, _text(form, value, unit), place, colour, row.method)

    return Column(axis, label, draw, lambda axes: draw_no_change(axes, form, margin))


def _unadjusted(row: ResultRow, form: Form) -> Estimate:
    return shown_change(row._replace(change=row.plain), form)


def _text(form: str, value: Estimate, unit: str) -> str:
    """Write a change beyond the axis."""
    if form == "difference":
        return difference_texts(value, unit)[0]
    return change_texts(Estimate(*(100 * (end - 1) for end in value)))[0]


def _change(axes: Axes, axis: Axis, value: Estimate, text: str, place: int, colour: str, method: str) -> None:
    """Draw a change with its interval, or its size with an arrow where it lies beyond the axis."""
    if not math.isfinite(value.value):
        return
    at = axis.place(value.value)
    if 0 <= at <= 1:
        _interval(axes, value, place, colour, method)
        return
    words, side, end = (f"{text} {RIGHT}", "right", 1.0) if at > 1 else (f"{LEFT} {text}", "left", 0.0)
    look: dict[str, Any] = {"color": colour, "gid": f"method-{method}", "ha": side, "va": "center", "zorder": 3}
    look |= {"bbox": {"facecolor": GROUND, "edgecolor": "none", "pad": 1.0}}
    axes.annotate(words, (end, place), xycoords=axes.get_yaxis_transform(), **look)


def _shares(tables: Sequence[ResultTable], rows: Sequence[Sequence[ResultRow]], keys: Options) -> Column:
    """Shares of the runs that exceed a number, or in which the event of the metric occurs, with the counts."""
    info, counts = tables[0].info, {}
    occurs = any(table.may_not_occur for table in tables)
    binary = keys.above == 0.0
    for table in tables:
        for row in table.rows:
            values = table.trials.column(info.name, row.method)
            values = values[~np.isnan(values)]
            binary = binary and bool(np.isin(values, (0.0, 1.0)).all())
            k = int(np.count_nonzero(np.isfinite(values) if occurs else values > keys.above))
            ends = [100 * end for end in wilson(k, len(values), table.trials.confidence)]
            share = Estimate(100 * k / len(values), *ends) if len(values) else Estimate()
            counts[id(table), row.method] = share, f"{k} of {len(values)}"
    axis = scaled_axis([0.0, *(end for share, _ in counts.values() for end in share)], log=False)
    words = info.words if occurs or binary else f"{info.words} above {keys.above:g} {info.unit}".rstrip()

    def draw(axes: Axes, table: ResultTable, row: ResultRow, place: int) -> None:
        share, text = counts.get((id(table), row.method), (Estimate(), "no run"))
        _interval(axes, share, place, INK, row.method)
        look: dict[str, Any] = {"va": "center", "annotation_clip": False, "gid": f"method-{row.method}"}
        axes.annotate(text, (1.02, place), xycoords=axes.get_yaxis_transform(), **look)

    return Column(axis, f"runs with {typeset(words)} [%]", draw)


_COLUMNS = {"values": _values, "mean": _means, "share": _shares}


def _ranking(results: Trials) -> Any:
    found = ranking(results)
    if found is None:
        raise DesignError("ranks need `statistics: {ranks: true}` and a positive primary metric of two methods", "show")
    return found


def _ranks(results: Trials) -> Column:
    """Ranks over all points, as intervals."""
    rows = {row.method: row for row in _ranking(results).rows}
    ticks = tuple(Tick(float(place), f"{place}") for place in range(1, len(rows) + 1))

    def draw(axes: Axes, table: ResultTable, row: ResultRow, place: int) -> None:
        low, high = rows[row.method].rank_low, rows[row.method].rank_high
        look: dict[str, Any] = {"color": INK, "gid": f"method-{row.method}", "zorder": 2.3}
        axes.plot([low, high], [place, place], lw=LINE, marker="|", ms=DOT, **look)

    return Column(Axis(0.5, len(rows) + 0.5, ticks, log=False), "rank", draw, order=tuple(rows))


def _ratios(results: Trials) -> Column:
    """Changes over all points, with the intervals of the ranks."""
    ratios = {row.method: row.ratio for row in _ranking(results).rows if row.method != results.baseline}
    found = {name: Estimate(each.ratio, each.low, each.high) for name, each in ratios.items()}
    axis = change_axis("ratio", list(found.values()), results.relevant)

    def draw(axes: Axes, table: ResultTable, row: ResultRow, place: int) -> None:
        value = found.get(row.method, Estimate())
        word = BETTER if value.high < 1 else WORSE if value.low > 1 else ""
        _change(axes, axis, value, _text("ratio", value, ""), place, VERDICT_COLOURS.get(word, INK), row.method)

    label = typeset(COMPARED["ratio"].format(name_of(results, results.baseline)))
    return Column(axis, label, draw, lambda axes: draw_no_change(axes, "ratio", results.relevant))
