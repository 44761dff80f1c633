"""Rows of methods: boxes of the runs beside the change against the baseline, means, shares of the runs, or ranks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rmpc_bench.figures.axes import Log
from rmpc_bench.figures.labels import (
    literal,
    name_of,
    on_two_lines,
    quantity,
    runs_sentence,
    sentence,
    short_title,
    shortened,
)
from rmpc_bench.figures.points import first_tables, shown_rows
from rmpc_bench.figures.style import POINTS_PER_INCH, fix_layout, lay_out, new_figure, style
from rmpc_bench.types.errors import Issue
from rmpc_bench.types.figure import Inches, SweepFigure
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.result_rows import ResultRow, ResultTable
    from rmpc_bench.analysis.trials import Trials

ROW, DENSE_ROW, DENSE = 0.28, 0.19, 10  # height of a row [in], of up to so many rows and of more
POINT, REST = 0.3, 0.5  # heights of a point without its rows, and of the labels below [in]
NAME_SHARE = 0.24  # share of the width that a name may take before it is broken
USUAL = ("values", "change")
WIDTHS: dict[str, float] = {"values": 1.0, "change": 1.25, "mean": 1.0, "share": 1.0, "rank": 0.7}
"""Columns with their relative widths."""
CAPTIONS = {
    "values": "boxes of the runs (median, quartiles, whiskers from 5 to 95 %)",
    "change": "changes against {baseline} with {level} intervals, beyond the axis as arrows",
    "mean": "means with {level} intervals",
    "share": "shares of the runs with {level} Wilson intervals",
    "rank": "ranks over all points as intervals",
}  # column -> what it shows


@dataclass(frozen=True, kw_only=True)
class Rows(SweepFigure):
    """A row per method, with one column or several side by side.

    `values` are boxes of the runs: median, quartiles, whiskers from 5 to 95 %. `change` is that against the baseline
    with its interval in the colour of the verdict, on a logarithmic axis; the margin of relevance is grey, a change
    beyond the axis an arrow.  `mean` has intervals; `share` is that of the runs in which a metric exceeds `above` or
    its event occurs.  `rank` has the ranks over all points of an experiment with `statistics: {ranks: true}`, with
    changes over all points.  More than 6 methods stand in the order of their change.  Of a sweep the first 6 points are
    drawn, one below the other.

    Parameters
    ----------
    metric : name of the metric; the primary one if not given
    show : columns from left to right, of values, change, mean, share and rank; values and change if not given
    log : logarithmic axis; `auto` where the largest value exceeds 20 times the smallest
    above : for shares: a run counts if its value is larger than this number
    width : width of the whole picture [in]
    height : height of the whole picture [in]; by the number of rows if not given
    order : methods to show, from top to bottom; all if not given
    at : points of the sweep, from top to bottom, each by values of its paths (default: the first 6)
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    metric: str | None = None
    show: str | list[str] | None = None
    log: Log = "auto"
    above: float = 0.0
    width: Inches = 6.6

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return (self.show,) if isinstance(self.show, str) else USUAL if self.show is None else tuple(self.show)

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: columns that stand beside each other, and another method for changes."""
        yield from super().check(layout)
        for name in self.columns:
            if name not in WIDTHS:
                yield Issue("show", f"{name!r} is not known; known: {', '.join(WIDTHS)}")
        if not self.columns or len(set(self.columns)) < len(self.columns):
            yield Issue("show", "must name at least one column, and each one once")
        if "rank" in self.columns and {"values", "mean", "share"} & {*self.columns}:
            yield Issue("show", "`rank` is over all points: beside it only `change` can stand")
        if "rank" in self.columns and self.at is not None:
            yield Issue("at", "ranks are over all points: leave `at` out")
        if self.columns == ("change",) and len(layout.methods) < 2:
            yield Issue("show", "compares methods with the baseline: needs at least two methods")

    def caption(self, results: Trials) -> str:
        """Say what the columns are, and count the runs; see `Figure.caption`."""
        tables, words = first_tables(self, self.metric, results)
        level = f"{100 * results.confidence:g} %"
        shown = [CAPTIONS[name].format(baseline=results.baseline, level=level) for name in self._columns(tables)]
        if "change" in self._columns(tables) and any(row.is_adjusted for table in tables for row in table.rows):
            shown.append("thin: intervals without the adjustment for the draws")
        runs = runs_sentence([table.trials for table in tables], self.order or results.methods)
        return sentence(f"{quantity(tables[0].info)}{words}: {', '.join(shown)}", runs)

    def draw(self, results: Trials) -> MplFigure:
        """Draw the rows of the points from top to bottom; see `Figure.draw`."""
        from rmpc_bench.figures.row_columns import Options, column_of

        tables, _ = first_tables(self, self.metric, results)
        shown = self._columns(tables)
        if "rank" in shown:
            tables = tables[:1]
        rows = [shown_rows(table, tables[0], self.order) for table in tables]
        n_rows = len(rows[0])
        height = n_rows * (ROW if n_rows <= DENSE else DENSE_ROW)
        size = self.size(REST + len(tables) * (height + POINT * (len(tables) > 1)))
        with style():
            options = Options(self.log, self.above, "rank" in shown)
            columns = [column_of(name, results, tables, rows, options) for name in shown]
            if "rank" in shown:
                order = next(column.order for column in columns if column.order)
                rows = [[row for name in order for row in rows[0] if row.method == name]]
            figure = new_figure(size)
            shape, widths = (len(tables), len(shown)), [WIDTHS[name] for name in shown]
            panels = figure.subplots(*shape, squeeze=False, sharex="col", sharey="row", width_ratios=widths)
            for line, table, there in zip(panels, tables, rows, strict=True):
                _name_rows(line, table, there, NAME_SHARE * size[0] * POINTS_PER_INCH)
                for axes, column in zip(line, columns, strict=True):
                    column.draw(axes, table, there)
                if len(tables) > 1:
                    line[0].set_title(literal(short_title(table.trials)), loc="left")
            lay_out(figure)
            for axes, column in zip(panels[-1], columns, strict=True):
                column.finish(axes)
            fix_layout(figure)
        return figure

    def _columns(self, tables: Sequence[ResultTable]) -> tuple[str, ...]:
        """Columns that have something to show: no change of a single method."""
        alone = all(table.form == "alone" for table in tables) and "rank" not in self.columns
        kept = tuple(name for name in self.columns if name != "change" or not alone)
        return kept or self.columns


def _name_rows(panels: Sequence[Axes], table: ResultTable, rows: Sequence[ResultRow], limit: float) -> None:
    """Name the rows at the left, an oracle in italics, and rule them."""
    first = panels[0]
    write = on_two_lines if len(rows) <= DENSE else shortened
    names = [write(name_of(table.trials, row.method), limit) for row in rows]
    first.set_yticks(range(len(rows)), names, linespacing=1.0)
    first.set_ylim(len(rows) - 0.4, -0.6)
    for label, row in zip(first.get_yticklabels(), rows, strict=True):
        label.set_gid(f"method-{row.method}")
        label.set_fontstyle("italic" if row.is_oracle else "normal")
    for axes in panels:
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.grid(axis="x", lw=0.4)
        axes.set_axisbelow(True)
