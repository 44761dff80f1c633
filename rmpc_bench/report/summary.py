"""The tables of a whole experiment: of one point, or of every point of a sweep below each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING

from rmpc_bench.analysis import statistics
from rmpc_bench.analysis.columns import Columns, Rows, data_frame
from rmpc_bench.analysis.comparison import COLUMNS, WHOLE, comparisons, levels
from rmpc_bench.analysis.result_rows import result_table
from rmpc_bench.analysis.statistics import pass_rates
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.latex import ALL_METRICS, WIDTH, capitalised
from rmpc_bench.report.notes import latex_tables, note_of
from rmpc_bench.report.page.rendering import said
from rmpc_bench.report.page.rows import rows_of
from rmpc_bench.report.point_tables import (
    Points,
    PointSummary,
    html_table,
    markdown_page,
    markdown_table,
    stacked_points,
)
from rmpc_bench.report.run_notes import counted, sections_of
from rmpc_bench.report.run_tables import REQUIREMENTS_NOTE, ensemble_markdown, requirement_columns, tail_columns
from rmpc_bench.types import DesignError
from rmpc_bench.types.errors import unknown
from rmpc_bench.types.result_layout import Column

if TYPE_CHECKING:
    import pandas as pd


def summary_markdown(trials: Trials, summary: Rows, comparisons: Rows) -> str:
    """Write the page of tables: per metric all columns of the page, then the worst and the failed runs."""
    n, level = len(trials.runs), 100 * trials.confidence
    name = f"{trials.name}: {' '.join(trials.title.split())}" if trials.title else trials.name
    size = f"{counted(n, 'run')} per method, seed {trials.seed}, intervals at {level:g} %."
    parts = [f"# {name}", f"One run of each method at each of {n} points, all there are." if trials.alike else size]
    for info in trials.metrics:
        table = result_table(trials, summary, comparisons, info)
        rows = rows_of(table, everything=True)
        best = {"zero": "best at 0", "one": "best at 1"}.get(info.direction, f"{info.direction} is better")
        name = f"{info.label} ({info.name})" if info.label else info.name
        parts.append(f"## {name}{f' [{info.unit}]' if info.unit else ''}, {best}")
        parts += filter(None, [markdown_table(rows.columns), note_of([table], n, rows)])
    demanded = requirement_columns(trials, pass_rates(trials))
    parts += ["## Requirements", markdown_table(demanded), REQUIREMENTS_NOTE] if demanded else []
    worst = tail_columns(trials)
    parts += ["## Worst runs", markdown_table(worst)] if worst else []
    for head, entries in sections_of(trials).items():
        parts += [f"## {head}", "\n".join(f"- {text}" for text in entries)] if entries else []
    return markdown_page(parts)


MOST_ON_SCREEN = 6  # points of single runs that are shown one by one; of more all runs are taken together
MOST_PAGES = 50  # points of a sweep that get a page in tables/summary.md; summary.csv has all


def main_table(points: Points) -> str:
    """Return the main table of the page as HTML, all points below each other, and its note; empty without runs."""
    tables = [result_table(*each, each.trials.primary_info or each.trials.metrics[0]) for each in points.with_runs]
    if not tables:
        return ""
    rows: list[dict[str, str]] = []
    for table in tables:
        found, title = rows_of(table).columns, table.trials.title
        at = {"point": title} if title else {}
        rows += [at | dict(zip(found, cells, strict=True)) for cells in zip(*found.values(), strict=True)]
    heads = dict.fromkeys(head for row in rows for head in row)
    columns = {head: [row.get(head, "") for row in rows] for head in heads}
    first = tables[0]
    drawn_none = rows_of(first, everything=True)
    note = f"{first.info.words} against {first.baseline}. {note_of(tables, len(first.trials.runs), drawn_none)}"

    def write(text: str) -> str:
        return said(text, columns["method"])

    return f"{html_table(columns, write)}<p>{write(capitalised(note))}</p>"


class Summary(Points):
    """A table of trials with its statistics, point by point."""

    __slots__ = ()

    @property
    def described_columns(self) -> Columns:
        """Sweep columns, then one row per method and metric."""
        return stacked_points([(point.trials, point.described) for point in self.points], statistics.SUMMARY)

    @property
    def compared_columns(self) -> Columns:
        """Sweep columns, then one row per comparison with the baseline."""
        return stacked_points([(point.trials, point.compared) for point in self.points], COLUMNS)

    @property
    def described(self) -> pd.DataFrame:
        """Sweep columns, then one row per method and metric."""
        return data_frame(self.described_columns)

    @property
    def compared(self) -> pd.DataFrame:
        """Sweep columns, then one row per comparison with the baseline."""
        return data_frame(self.compared_columns, WHOLE)

    def shown(self, order: Sequence[str] | None = None, metrics: Sequence[str] | None = None) -> Summary:
        """Return the same statistics with fewer or reordered methods and metrics in the tables; all where None."""
        points = [_reordered(point, order, metrics) for point in self.points]
        return Summary(points, self.pooled and _reordered(self.pooled, order, metrics))

    def to_frame(self) -> pd.DataFrame:
        """Return the table `described`."""
        return self.described

    def __repr__(self) -> str:
        trials = self.points[0].trials
        return f"<Summary of {trials.name!r}: {len(trials.methods)} methods, {len(self.points)} points>"

    def _repr_html_(self) -> str:
        return main_table(self) or escape(repr(self))

    def to_markdown(self) -> str:
        """Return the pages of tables: of all points together where there are many, and of each."""
        pages = [self.pooled] if self.pooled else []
        tables = [summary_markdown(*page) for page in [*pages, *self.points[:MOST_PAGES]] if len(page.trials.runs)]
        tables += [text for point in self.points[:MOST_PAGES] if (text := ensemble_markdown(point.trials))]
        return "\n".join(tables)

    def to_latex(
        self, metric: str | None = None, *, columns: Sequence[Column] | None = None, width: float = WIDTH
    ) -> str:
        """Return a table for a paper: a body for the package booktabs, without a float.

        Parameters
        ----------
        metric : name of the metric; the primary one if None; ``all-metrics`` for the means of all of them
        columns : columns behind the name of the method; the usual ones that fit if None
        width : of a column of the paper, to which the usual columns are limited [pt, of which an inch has 72.27]

        Raises
        ------
        DesignError
            If there is no such metric, or there are too many points of a sweep for a table.
        """
        trials = self.points[0].trials
        wanted = metric or (trials.primary_info or trials.metrics[0]).name
        known = [*(info.name for info in trials.metrics), *([ALL_METRICS] if len(trials.metrics) > 1 else [])]
        if wanted not in known:
            raise DesignError(unknown(wanted, known, "metric"), "metric")
        tables = latex_tables(self, (), columns, width)
        if wanted not in tables:
            raise DesignError("there is no table in LaTeX: no run, or too many points of a sweep; summary.csv has all")
        return tables[wanted].body


def _reordered(point: PointSummary, order: Sequence[str] | None, metrics: Sequence[str] | None) -> PointSummary:
    """Choose methods and metrics of a table whose statistics are computed."""
    trials, infos = point.trials, {info.name: info for info in point.trials.metrics}
    methods = trials.methods if order is None else tuple(name for name in order if name in trials.methods)
    chosen = trials.metrics if metrics is None else tuple(infos[name] for name in metrics)
    if methods == trials.methods and chosen == trials.metrics:
        # What is known of its rows stays known.
        return point
    return point._replace(trials=replace(trials, methods=methods, metrics=chosen))


def summarise(trials: Trials) -> Summary:
    """Describe every method and compare it with the baseline, at every point of a sweep."""
    of, pooled = levels(trials), None
    if len(trials.points) > MOST_ON_SCREEN and trials.is_population:
        # Nothing is estimated where the points are all there are, so there are no errors, intervals and tests.
        every, none = trials.pooled(), {"se": math.nan, "ci_low": math.nan, "ci_high": math.nan}
        pooled = PointSummary(every, [{**row, **none} for row in statistics.summary(every)], [])
    points = [PointSummary(point, statistics.summary(point), comparisons(point, of)) for point in trials.each]
    return Summary(points, pooled)
