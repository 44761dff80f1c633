"""The main table of one point as plain data: a row per method with its numbers and drawn cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from rmpc_bench.analysis.ranks import Ranking
from rmpc_bench.analysis.result_rows import BASELINE, BETTER, INCONCLUSIVE, WORSE, Form, ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate, change_texts
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.axes import Axis, Tick, change_axis, scaled_axis, spaced
from rmpc_bench.figures.labels import quantity
from rmpc_bench.figures.points import shown_change
from rmpc_bench.report.columns import COLUMNS, columns_of, runs_text, written
from rmpc_bench.report.ranks_table import part_columns

LABEL_GAP, LETTER = 0.03, 0.037
"""Space between two labels of the axis of runs, and the width of a letter, as shares of the narrowest column."""


class Line(NamedTuple):
    """A line of the grid."""

    left: str
    css: str  # `zero` where nothing changes
    label: str  # of the tick, with `odd` for one of those that are left out where the cell is narrow
    odd: bool


class Bar(NamedTuple):
    """A bar or a box from left to right."""

    css: str
    left: str
    width: str


class Strip(NamedTuple):
    """What is drawn in a cell."""

    grid: Sequence[Line]
    band: Bar | None = None
    bars: Sequence[Bar] = ()
    dot: str = ""  # place of the estimate
    middle: str = ""  # place of the median
    arrow: str = ""  # side on which the estimate, or a quantile, lies beyond the axis


def per_cent(share: float) -> str:
    """Write a place as CSS does."""
    return f"{100 * share:.2f}".rstrip("0").rstrip(".") + "%"


def grid_of(axis: Axis, nothing: float | None = None) -> list[Line]:
    """Return the lines of an axis, of which one may stand for no change."""
    ticks, size = axis.ticks, axis.high - axis.low
    middle = min(range(len(ticks)), key=lambda k: abs(ticks[k].at - (nothing or 0.0)), default=0)
    zeros = [nothing is not None and abs(tick.at - nothing) < 1e-12 for tick in ticks]
    return [
        Line(per_cent((tick.at - axis.low) / size), "zero" * zero, tick.label, (k - middle) % 2 == 1)
        for k, (tick, zero) in enumerate(zip(ticks, zeros, strict=True))
    ]


def _bar(css: str, low: float, high: float) -> Bar:
    low, high = min(max(low, 0.0), 1.0), min(max(high, 0.0), 1.0)
    return Bar(css, per_cent(low), per_cent(high - low))


class Changes(NamedTuple):
    """Cells of changes, on one axis."""

    axis: Axis
    grid: Sequence[Line]
    band: Bar | None

    @classmethod
    def of(cls, form: Form, changes: Sequence[Estimate], margin: float) -> Changes:
        """Choose the axis of changes, and draw the margin around no change as a band."""
        axis = change_axis(form, changes, margin)
        nothing = 0.5 if form == "share" else 0.0
        edge = 0.0 if form == "share" else margin if form == "difference" else math.log1p(margin)
        ends = [(nothing + end - axis.low) / (axis.high - axis.low) for end in (-edge, edge)]
        return cls(axis, grid_of(axis, nothing), _bar("", *ends) if edge else None)

    def strip(self, change: Estimate) -> Strip:
        """Draw a ratio, a difference or a share with its interval; the grid alone where there is none."""
        strip = Strip(self.grid, self.band)
        if math.isnan(change.value):
            return strip
        value, low, high = map(self.axis.place, change)
        if not 0 <= value <= 1:
            return strip._replace(arrow="right" if value > 1 else "left")
        bars = [] if math.isnan(change.half) else [_bar("", low, high)]
        return strip._replace(bars=bars, dot=per_cent(value))


def runs_strip(row: ResultRow, axis: Axis, grid: Sequence[Line]) -> Strip | None:
    """Draw the quantiles of the runs of a row; None without a finished run."""
    if not row.quantiles:
        return None
    first, low, middle, high, last = map(axis.place, row.quantiles)
    bars = [_bar("thin", first, low), _bar("thin", high, last), _bar("box", low, high)] if first < math.inf else []
    median = per_cent(middle) if math.isfinite(row.quantiles[2]) else ""
    return Strip(grid, None, bars, "", median, "" if math.isfinite(row.quantiles[4]) else "right")


MANY = 10  # methods above which rows are low and labels are cut
# Word of a verdict -> class of its cell, where it is not the word.
STYLES = {"fails more": "fails", BASELINE: "base", "not computed": "base", "failed": "fails"}
FIRST = ("mean", "change", "verdict")  # columns that are always shown, with drawings and remarks
UNKNOWN = "Infinity"  # sorts a cell without a number behind the others


class Cell(NamedTuple):
    """A cell of numbers or words."""

    css: str
    text: str = ""
    value: str = ""  # by which the script sorts
    remark: str = ""
    strip: Strip | None = None
    tip: str = ""


class Head(NamedTuple):
    """Head of a column."""

    text: str
    css: str
    sort: bool = False
    strip: Strip | None = None  # its ticks


class Row(NamedTuple):
    """A method."""

    method: str
    label: str
    css: str
    cells: Sequence[Cell]


class Rows(NamedTuple):
    """The main table."""

    heads: Sequence[Head]
    rows: Sequence[Row]
    everything: bool = False  # whether Markdown shows the columns on demand, too

    @property
    def css(self) -> str:
        """How high the rows are."""
        return "many" if len(self.rows) > MANY else "few"

    @property
    def has_more(self) -> bool:
        """Whether columns are shown on demand."""
        return any("more" in head.css for head in self.heads)

    @property
    def columns(self) -> dict[str, list[str]]:
        """Head -> texts of the columns that Markdown shows."""
        wanted = ("n m", "n c", "v", *(["n more"] if self.everything else []))
        shown = [k for k, head in enumerate(self.heads) if head.css in wanted]
        found = {"method": [row.method for row in self.rows]}
        for k in shown:
            cells = [row.cells[k] for row in self.rows]
            found[self.heads[k].text] = [" ".join(filter(None, [cell.text, cell.remark])) for cell in cells]
        return found


def row_of(trials: Trials, method: str, cells: Sequence[Cell]) -> Row:
    """Name a row by its method, with what its label says besides the key, which stands in front of it."""
    css = " ".join(["base"] * (method == trials.baseline) + ["oracle"] * (method in trials.oracles))
    label = trials.labels.get(method, "")
    rest = label.removeprefix(method)
    return Row(method, rest.lstrip(" ,:") if rest[:1] in (" ", ",", ":", "") else label, css, cells)


def rows_of(table: ResultTable, *, everything: bool = False) -> Rows:
    """Lay out the table of one point, for Markdown in the order of the configuration with every column."""
    shown, trials, form = [*table.rows] if everything else table.ordered, table.trials, table.form
    if not trials.with_verdicts:
        rows = [row_of(trials, row.method, [_verdict(row, len(shown))]) for row in shown]
        return Rows([Head("result", "v")], rows)
    axis = scaled_axis([each for row in shown for each in row.quantiles], "auto")
    axis = axis._replace(ticks=spaced(axis.ticks, partial(_are_apart, axis.high - axis.low)))
    grid = grid_of(axis) if any(row.n_occurred for row in shown) else []
    more = _more(table, shown, everything=everything)
    mean, change_head, verdict = (
        written(COLUMNS[name].head, table).format(quantity=quantity(table.info)) for name in FIRST
    )
    quantiles = f"runs: 5 %, quartiles, 95 %{' (log)' * axis.log}"
    heads = [Head(mean, "n m", True), Head(quantiles, "d0", strip=Strip(grid))]
    changes = Changes.of(form, [shown_change(row, form) for row in table.rows], table.margin)
    if form != "alone":
        heads += [Head(_change_head(table), "s0", strip=Strip(changes.grid))]
        heads += [Head(change_head, "n c", True), Head(verdict, "v")]
    rows = []
    for k, row in enumerate(shown):
        style = STYLES.get(row.word, row.word) if not row.is_baseline else ""
        cells = [Cell("n m", table.mean_text(row), _number(row.mean.value))]
        cells.append(Cell(f"d0 {style}", strip=runs_strip(row, axis, grid)))
        if form != "alone":
            strip = changes.strip(shown_change(row, form)) if row.n else None
            place = -table.rank(row) if form == "share" else 0.0 if row.is_baseline else row.change.value
            change = Cell("n c", table.change_text(row) if row.n else "", _number(place))
            cells += [Cell(f"s0 {style}", strip=strip), change, _verdict(row, len(shown))]
        cells += [Cell("n more", texts[k]) for texts in more.values()]
        rows.append(row_of(trials, row.method, cells))
    return Rows([*heads, *(Head(head, "n more") for head in more)], rows, everything)


def _are_apart(size: float, tick: Tick, last: Tick) -> bool:
    """Whether the labels of two ticks have room in the column of runs, which a phone does not show."""
    return abs(tick.at - last.at) >= size * (LABEL_GAP + LETTER * (len(tick.label) + len(last.label)) / 2)


def _number(value: float) -> str:
    return UNKNOWN if math.isnan(value) else f"{value:.6g}"


def _change_head(table: ResultTable) -> str:
    if table.form == "share":
        return f"better than {table.baseline}, share of the runs"
    unit = f" [{table.info.unit}]" if table.form == "difference" and table.info.unit else ""
    what = "difference from" if table.form == "difference" else "change against"
    return f"{what} {table.baseline}{unit}, {'higher' if table.info.direction == 'higher' else 'lower'} is better"


def _verdict(row: ResultRow, n: int) -> Cell:
    remark = row.remark if n <= MANY else ""
    return Cell(f"v {STYLES.get(row.word, row.word)}", row.word, "", remark, tip=row.remark if not remark else "")


def _more(table: ResultTable, shown: Sequence[ResultRow], *, everything: bool) -> dict[str, list[str]]:
    """Return head -> cells of the columns that are shown on demand."""
    columns, elsewhere = columns_of(table, shown), "page" if everything else "file"
    names = [name for name in columns if name not in FIRST and COLUMNS[name].only != elsewhere]
    return {head: columns[name] for name in names if (head := written(COLUMNS[name].head, table))}


def ranked_rows(found: Ranking, trials: Trials) -> Rows:
    """Lay out the ranks: a row per method with its ratio to the baseline over all points, and the rank as verdict."""
    ratios = [Estimate(row.ratio.ratio, row.ratio.low, row.ratio.high) for row in found.rows]
    changes, info = Changes.of("ratio", ratios, trials.relevant), trials.primary_info
    what = f"{info.words if info else 'metric'} against {trials.baseline}, all points"
    heads = [Head(what, "s0", strip=Strip(changes.grid)), Head("change", "n c", True), Head("rank", "v")]
    more = part_columns(found, trials.baseline) | {"runs": [runs_text(row.n, row.n_failed) for row in found.rows]}
    heads += [Head(text, "n more") for text in more]
    rows = []
    for k, (row, ratio) in enumerate(zip(found.rows, ratios, strict=True)):
        base, change = row.method == trials.baseline, Estimate(*(100 * (end - 1) for end in ratio))
        style = "" if base else BETTER if change.high < 0 else WORSE if change.low > 0 else INCONCLUSIVE
        text = "" if base else " ".join(filter(None, change_texts(change)))
        cells = [Cell(f"s0 {style}", strip=changes.strip(Estimate() if base else ratio))]
        cells.append(Cell("n c", text, _number(0.0 if base else change.value)))
        rank = f"{row.rank_low} to {row.rank_high}" if row.rank_low < row.rank_high else f"{row.rank_low}"
        cells.append(Cell(f"v {style}", rank, f"{row.rank_low}"))
        rows.append(row_of(trials, row.method, [*cells, *(Cell("n more", texts[k]) for texts in more.values())]))
    return Rows(heads, rows)
