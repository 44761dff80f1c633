"""Panels of a sweep: a line per method over a number, cells of points and methods, or of two swept values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.result_rows import BETTER, INCONCLUSIVE, MARKS, WORSE
from rmpc_bench.analysis.shown_numbers import MINUS, Estimate, number, places, short
from rmpc_bench.figures.axes import NONE, Axis, change_axis, draw_no_change, scaled_axis, set_axis, stacked_panels
from rmpc_bench.figures.labels import (
    LINEAR,
    literal,
    name_of,
    names_of_columns,
    on_two_lines,
    shortened,
    typeset,
    width,
    with_unit,
    wrapped,
)
from rmpc_bench.figures.palette import DIM, GROUND, INK, PRINT, LineStyle, line_styles
from rmpc_bench.figures.row_columns import VERDICT_COLOURS
from rmpc_bench.figures.style import FONT_SIZE, LINE_HEIGHT, POINTS_PER_INCH, fix_layout, lay_out, new_figure, style
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.text import Annotation

    from rmpc_bench.analysis.result_rows import ResultRow, ResultTable
    from rmpc_bench.figures.sweep_content import SweepContent
    from rmpc_bench.types.figure import Figure


MOST_TICKS = 8  # ticks of the axis of changes in per cent
ALPHA = 0.13  # of the bands
NAME_SHARE = 0.3  # share of the width of the figure that a name may take before it is cut
BEYOND = {-1: " ▼", 1: " ▲"}  # behind the name of a line that ends below or above the axis


class Name(NamedTuple):
    """A name at the end of a line."""

    text: str
    place: float  # height, 0 at the lower end of the axis and 1 at the upper one
    color: str
    gid: str | None


def draw_lines(content: SweepContent, size: tuple[float, float]) -> MplFigure:
    """Draw the panels from top to bottom, on common axes."""
    axis, styles = _axis(content), line_styles(content.trials.all_methods, content.methods)
    with style():
        figure = new_figure(size)
        panels = stacked_panels(figure, len(content.panels))
        title, found = _title(content, 0.75 * size[0] * POINTS_PER_INCH, is_log=axis.log), []
        for axes, panel in zip(panels, content.panels, strict=True):
            axes.set_title("\n".join(filter(None, [*title, literal(panel)])), loc="left")
            title = []
            found.append((axes, _draw_panel(axes, content, panel, axis, styles)))
        panels[-1].set_xlabel("\n".join(wrapped(content.axis.label, 0.6 * size[0] * POINTS_PER_INCH)))
        texts = [_write_names(axes, names, NAME_SHARE * size[0] * POINTS_PER_INCH) for axes, names in found]
        lay_out(figure)
        for (axes, _), written in zip(found, texts, strict=True):
            content.axis.scale(axes)
            _move_apart(axes, written)
        fix_layout(figure)
    return figure


def _title(content: SweepContent, room: float, *, is_log: bool) -> list[str]:
    """Say what is drawn, and which side is better where that fits on the line."""
    text = typeset(content.words)
    unit = content.info.unit if content.show == "value" or content.form == "difference" else ""
    text = with_unit(text, unit) + (LINEAR if content.log is True and not is_log else "")
    longer = text + content.better_if
    return [longer] if width(longer) <= room else wrapped(text, room)


def _axis(content: SweepContent) -> Axis:
    """Choose the vertical axis, the same for all panels."""
    found = [content.number(table, name) for table in content.tables for name in content.methods]
    if content.show == "value":
        return scaled_axis([end for each in found for end in each], content.log)
    return change_axis(content.form, found, content.margin, MOST_TICKS)


def _draw_panel(axes: Axes, content: SweepContent, panel: str, axis: Axis, styles: dict[str, LineStyle]) -> list[Name]:
    """Draw the lines of a panel and return the names for their ends."""
    set_axis(axes, axis, upright=True)
    names = []
    if content.show == "change":
        base = content.trials.baseline
        draw_no_change(axes, content.form, content.margin, upright=True, gid=f"method-{base}")
        place = axis.place(NONE.get(content.form, 0.0))
        names.append(Name(name_of(content.trials, base), place, INK, f"method-{base}"))
    for name in content.methods:
        line = content.line(panel, name)
        if not line:
            continue
        look = styles[name]
        x = np.array([at for at, _ in line])
        middle, low, high = (_drawable(column, axis) for column in np.array([value for _, value in line]).T)
        known = np.isfinite(low) & np.isfinite(high)
        if known.any():
            axes.fill_between(x, low, high, where=known, color=look.color, alpha=ALPHA, lw=0, zorder=1.5, gid=look.gid)
        if len(x) == 1:
            axes.vlines(x, low, high, color=look.color, lw=0.9, zorder=2.4, gid=look.gid)
        marks: dict[str, Any] = {} if look.color == DIM else {"marker": look.marker, "ms": 3.2}
        axes.plot(x, middle, **look.line(), **marks)
        names.append(Name(name_of(content.trials, name), axis.place(float(middle[-1])), look.color, look.gid))
    return names


def _drawable(values: Array, axis: Axis) -> Array:
    """Limit numbers to ten lengths of the axis beyond its ends, which is all that can be drawn."""
    reach = 10 * (axis.high - axis.low)
    ends = np.array([axis.low - reach, axis.high + reach])
    low, high = np.exp(np.clip(ends, -200, 200)) if axis.log else ends
    return np.where(np.isnan(values), np.nan, np.clip(values, low, high))


def _write_names(axes: Axes, names: Sequence[Name], limit: float) -> list[Annotation]:
    """Write names at the right of a panel, each at the end of its line, with an arrow where it leaves the axis."""
    found = []
    for name in names:
        text = shortened(name.text, limit) + BEYOND.get((name.place > 1) - (name.place < 0), "")
        place = 1.02, min(max(name.place, 0.0), 1.0)
        look: dict[str, Any] = {"color": name.color, "gid": name.gid, "va": "center", "annotation_clip": False}
        found.append(axes.annotate(text, place, xycoords="axes fraction", **look))
    return found


def _move_apart(axes: Axes, texts: Sequence[Annotation]) -> None:
    """Move the names at the ends of lines apart; of more than fit, those of grey lines are left out first."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    gap = LINE_HEIGHT / (POINTS_PER_INCH * figure.get_figheight() * axes.get_position().height)
    most = 1 + int(1 / gap)
    kept = sorted(texts, key=lambda text: text.get_color() == DIM)[:most] if len(texts) > most else texts
    for text in texts:
        text.set_visible(text in kept)
    for text, place in zip(kept, apart([text.xy[1] for text in kept], gap), strict=True):
        text.xy = (text.xy[0], place)
        text.set_position(text.xy)


def apart(places: Sequence[float], gap: float) -> list[float]:
    """Move places from 0 to 1 as little as possible, so that neighbours have a distance; they must fit.

    >>> apart([0.5, 0.5, 0.0], 0.25)
    [0.375, 0.625, 0.0]
    """
    order = sorted(range(len(places)), key=lambda k: places[k])
    blocks: list[list[float]] = []
    for rank, k in enumerate(order):
        blocks.append([places[k] - rank * gap])
        while len(blocks) > 1 and fmean(blocks[-2]) > fmean(blocks[-1]):
            blocks[-2:] = [blocks[-2] + blocks[-1]]
    highest = max(0.0, 1 - (len(places) - 1) * gap)
    fitted = [min(max(fmean(block), 0.0), highest) for block in blocks for _ in block]
    found = dict(zip(order, (place + rank * gap for rank, place in enumerate(fitted)), strict=True))
    return [found[k] for k in range(len(places))]


ROW, HEAD = 0.2, 0.4  # heights of a row of cells, and of a panel without its rows and the names of columns [in]
ROW_NAME_SHARE = 0.35  # share of the width that the name of a row may take before it is cut
PAD, SMALLEST = 2.0, 5.0
"""Free width of a cell beside its text, and smallest size of the text; below it cells have colours only [pt]."""
TINT, MOST_TINT = 0.16, 0.45  # opacity of the colour of a verdict, and of the largest value


class Cell(NamedTuple):
    """Text and colours of a cell."""

    text: str
    ink: str
    fill: str
    alpha: float
    gid: str


class Block(NamedTuple):
    """Cells with the names of their rows and columns; no cell where the sweep leaves a point out."""

    title: str
    rows: Sequence[str]
    columns: Sequence[str]
    cells: Sequence[Sequence[Cell | None]]
    head: float = 0.0  # height of title and names of columns [in]
    how: Mapping[str, Any] = {}  # how ticks have the names of columns

    @property
    def placed(self) -> list[tuple[int, int, Cell]]:
        """Column, row and cell of all that exist."""
        return [(x, y, cell) for y, row in enumerate(self.cells) for x, cell in enumerate(row) if cell is not None]

    @property
    def n_lines(self) -> int:
        """Most lines that the name of a row has."""
        return max(1 + name.count("\n") for name in self.rows)


def draw_cells(content: SweepContent, keys: Figure) -> MplFigure:
    """Draw a matrix of points and methods, or a panel of cells per method."""
    blocks = _grids(content) if content.down is not None else [_matrix(content)]
    with style():
        limit = ROW_NAME_SHARE * keys.size(1.0)[0] * POINTS_PER_INCH
        blocks = [_with_heads(block, limit) for block in blocks]
    heights = [block.head + ROW * len(block.rows) * block.n_lines for block in blocks]
    size = keys.size(0.3 + sum(heights))
    with style():
        figure = new_figure(size)
        panels = figure.subplots(len(blocks), squeeze=False, height_ratios=heights)[:, 0]
        for axes, block in zip(panels, blocks, strict=True):
            _draw_block(axes, block)
        if content.down is not None:
            panels[-1].set_xlabel(content.axis.label)
            panels[-1].xaxis.set_label_position("bottom")
            for axes in panels:
                axes.set_ylabel("\n".join(wrapped(content.down.label, 1.2 * POINTS_PER_INCH)))
        unit = content.info.unit if content.show == "value" or content.form == "difference" else ""
        title = wrapped(with_unit(typeset(content.words), unit), 0.9 * size[0] * POINTS_PER_INCH)
        figure.suptitle("\n".join(title), fontsize=FONT_SIZE)
        lay_out(figure)
        for axes, block in zip(panels, blocks, strict=True):
            _write_cells(axes, block, size)
        figure.set_layout_engine(None)
    return figure


def _matrix(content: SweepContent) -> Block:
    """Arrange points and methods; the longer ones go down, and the means of the baseline are first."""
    (points,) = content.panels.values()
    cell = _cells(content)
    names = [name_of(content.trials, name) for name in content.methods]
    cells = [[cell(table, name) for name in content.methods] for table in points.values()]
    base = content.trials.baseline
    if content.show == "change":
        names = [f"{name_of(content.trials, base)}, mean", *names]
        cells = [[_mean(table, base), *row] for row, table in zip(cells, points.values(), strict=True)]
    titles = [literal(text) for text in points]
    if len(titles) >= len(content.methods):
        return Block("", titles, names, cells)
    return Block("", names, titles, [list(column) for column in zip(*cells, strict=True)])


def _grids(content: SweepContent) -> list[Block]:
    """Arrange the two swept values, method by method."""
    assert content.down is not None
    cell, across, down = _cells(content), content.axis.texts, content.down.texts
    found = []
    for name in content.methods:
        tables = [[content.panels[y].get(x) for x in across] for y in down]
        cells = [[None if table is None else cell(table, name) for table in row] for row in tables]
        title = name_of(content.trials, name)
        found.append(Block(title, [literal(text) for text in down], [literal(text) for text in across], cells))
    return found


def _cells(content: SweepContent) -> Any:
    """Return the function that makes the cell of a method in a table."""
    if content.show == "change":
        return lambda table, name: _changed(content, table, table.row_of(name))
    values = {(id(t), name): content.number(t, name) for t in content.tables for name in content.methods}
    finite = [each.value for each in values.values() if math.isfinite(each.value)] or [0.0]
    low, high = min(finite), max(finite)
    log = (high > 20 * low > 0) if content.log == "auto" else content.log and low > 0
    scale = math.log if log else float

    def cell(table: ResultTable, name: str) -> Cell:
        value = values[id(table), name]
        at = (scale(value.value) - scale(low)) / (scale(high) - scale(low)) if low < value.value < math.inf else 0.0
        return Cell(_text(value), INK, PRINT["better"], MOST_TINT * at, f"method-{name}")

    return cell


def _text(value: Estimate) -> str:
    """Write a value with the digits that its interval supports, at most four."""
    if not math.isfinite(value.half) or not math.isfinite(value.value):
        return short(value.value)
    digits = places(value.half)
    size = math.floor(math.log10(abs(value.value))) if value.value else 0
    return number(value.value, digits) if 0 <= digits and digits + size < 4 and size < 5 else short(value.value)


def _changed(content: SweepContent, table: ResultTable, row: ResultRow | None) -> Cell | None:
    """Make the cell of a change: without decimals, with the colour of the verdict."""
    if row is None or not row.n + row.n_failed:
        return None
    value = content.number(table, row.method)
    if math.isnan(value.value):
        return Cell(table.short_change(row), INK, GROUND, 0.0, f"method-{row.method}")
    text = table.short_change(row._replace(word=""))
    if content.form == "difference":
        # The unit stands in the title.
        text = ("+" if value.value > 0 else "") + _text(value)
    word = row.word or _direction(content, value)
    colour = VERDICT_COLOURS.get(word)
    text = f"{text} {MARKS.get(word, '')}".strip()
    return Cell(text, colour or INK, colour or GROUND, TINT if colour else 0.0, f"method-{row.method}")


def _direction(content: SweepContent, value: Estimate) -> str:
    """Find the word of a metric without verdict: to which side of no change its interval lies."""
    none = NONE.get(content.form, 0.0)
    if not (value.low > none or value.high < none):
        return INCONCLUSIVE
    wanted = content.info.direction == "higher" or content.form == "share"
    return BETTER if (value.low > none) == wanted else WORSE


def _mean(table: ResultTable, method: str) -> Cell | None:
    row = table.row_of(method)
    if row is None or not row.n:
        return None
    mean = row.quantiles[2] if table.may_not_occur else row.mean.value
    return Cell(short(mean), INK, GROUND, 0.0, f"method-{method}")


def _with_heads(block: Block, limit: float) -> Block:
    """Write the names of rows on two lines at most, and those of columns above them."""
    rows = [on_two_lines(name, limit) for name in block.rows]
    widest = max(width(line) for name in rows for line in name.split("\n"))
    slot = (limit / ROW_NAME_SHARE - widest - 2 * FONT_SIZE) / len(block.columns)
    columns, how, tall = names_of_columns(block.columns, slot)
    how |= {"ha": "left"} if "ha" in how else {}
    return block._replace(rows=rows, columns=columns, how=how, head=HEAD + tall / POINTS_PER_INCH)


def _draw_block(axes: Axes, block: Block) -> None:
    """Draw the cells of a panel with the names of rows and columns, the latter on top."""
    from matplotlib.patches import Rectangle

    for x, y, cell in block.placed:
        if cell.alpha:
            axes.add_patch(Rectangle((x, y), 1, 1, facecolor=cell.fill, alpha=cell.alpha, lw=0, gid=cell.gid))
    axes.set_xlim(0, len(block.columns))
    axes.set_ylim(len(block.rows), 0)
    axes.hlines(range(len(block.rows) + 1), 0, len(block.columns), color=PRINT["line"], lw=0.5, clip_on=False)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.set_yticks([y + 0.5 for y in range(len(block.rows))], block.rows, linespacing=1.0)
    axes.set_xticks([x + 0.5 for x in range(len(block.columns))], block.columns, **block.how)
    if block.title:
        axes.set_title(typeset(block.title), loc="left", fontweight="bold")


def _write_cells(axes: Axes, block: Block, size: tuple[float, float]) -> None:
    """Write the texts into the cells, as large as all of them fit."""
    place = axes.get_position()
    wide = place.width * size[0] * POINTS_PER_INCH / len(block.columns) - PAD
    tall = place.height * size[1] * POINTS_PER_INCH / len(block.rows)
    widest = max((width(cell.text) for *_, cell in block.placed), default=1.0)
    font = min(FONT_SIZE, FONT_SIZE * wide / widest, 0.8 * tall)
    for x, y, cell in block.placed if font >= SMALLEST else ():
        look: dict[str, Any] = {"color": cell.ink, "fontsize": font, "gid": cell.gid}
        axes.text(x + 0.5, y + 0.5, cell.text.replace("-", MINUS), ha="center", va="center", **look)
