"""The tables of a whole experiment, of one point or of every point of a sweep, and comparisons with the baseline.

A comparison has its sentence, which can be quoted, and the table has data frame, Markdown, LaTeX and text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any

from rmpc_bench.analysis import comparison_text, statistics
from rmpc_bench.analysis.columns import Columns, Rows, data_frame, n_rows
from rmpc_bench.analysis.comparison import COLUMNS, WHOLE, comparisons, levels
from rmpc_bench.analysis.comparison_text import change_of, margin_of, size_text
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.result_rows import result_table
from rmpc_bench.analysis.shown_numbers import Estimate, interval_text
from rmpc_bench.analysis.statistics import pass_rates
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.tuning import pair_text
from rmpc_bench.report.latex import ALL_METRICS, WIDTH, capitalised
from rmpc_bench.report.notes import latex_tables, note_of
from rmpc_bench.report.page.rendering import said
from rmpc_bench.report.page.rows import rows_of
from rmpc_bench.report.point_tables import (
    AVERAGES,
    FrameTable,
    Points,
    PointSummary,
    html_table,
    markdown_page,
    markdown_table,
    stacked_points,
    texts_of,
)
from rmpc_bench.report.run_notes import counted, sections_of
from rmpc_bench.report.run_tables import REQUIREMENTS_NOTE, ensemble_markdown, requirement_columns, tail_columns
from rmpc_bench.types import DesignError, MetricInfo
from rmpc_bench.types.errors import unknown
from rmpc_bench.types.result_layout import Column
from rmpc_bench.types.texts import inert_markdown

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
        """Return the main table of the page, all points below each other, and its note."""
        tables = [result_table(*each, each.trials.primary_info or each.trials.metrics[0]) for each in self.with_runs]
        if not tables:
            return escape(repr(self))
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
        write = partial(said, names=columns["method"])
        return f"{html_table(columns, write)}<p>{write(capitalised(note))}</p>"

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


def sentence(row: Mapping[str, Any], info: MetricInfo, trials: Trials) -> str:
    """Say one row of `comparison.comparisons` in one sentence that can be pasted into a paper."""
    method, baseline, name = row["method"], row["baseline"], name_of_distance(info)
    word = comparison_text.seen_text(row, margin_of(trials, info, signed=row["average"] == "difference"))
    counts = f"won {row['won']}, lost {row['lost']}, tied {row['tied']}"
    origin = pair_text(trials, method, baseline)
    counts += f"; {origin}" if origin else ""
    changed, words, other_words = _changed(row, info), comparison_text.AVERAGE_WORDS, AVERAGES
    if trials.unpaired:
        n, n_baseline = (len(trials.runs) - trials.n_failed(each) for each in (method, baseline))
        pairs, counts = f"{n} and {n_baseline} runs", "; ".join(filter(None, ["not paired", origin]))
        words = other_words = comparison_text.UNPAIRED
    else:
        pairs = counted(int(row["n_pairs"]), "paired run")
    if not changed:
        text = f"{method} against {baseline} in {name} ({pairs}; {counts})"
    else:
        simultaneous = "simultaneous " if word and row["ci_level"] > trials.confidence else ""
        level = f"{simultaneous}{100 * trials.confidence:g} % interval"
        average = words[str(row["average"])]
        average = ", ".join(filter(None, [average, comparison_text.adjusted_for(row)]))
        text = f"{method} {changed} against {baseline} ({average}, {pairs}, {level}; {counts})"
    if word and comparison_text.contradicting(row):
        other = "mean" if row["average"] == "geometric" else "geometric"
        text += f"; the {other_words[other]} changes by {size_text(row, info, other)}"
    alone = ((method, row["failed_only"]), (baseline, row["baseline_failed_only"]))
    failed = ", ".join(f"{name} {'alone ' * (not trials.unpaired)}failed in {n}" for name, n in alone if n)
    bound = comparison_text.far_worse_bound([row], trials, info)
    text += f"; {failed}" if failed else ""
    return f"{text}{': ' + word if word else ''}{'; ' + bound if bound else ''}."


def _changed(row: Mapping[str, Any], info: MetricInfo) -> str:
    """Write verb, metric and size; empty where there is no size."""
    unit = info.unit if row["average"] == "difference" else "%"
    value, low, high = change_of(row)
    if math.isnan(value):
        return ""
    name = name_of_distance(info)
    if math.isnan(low):
        return f"changes {name} by {size_text(row, info)}, without an interval"
    verb, size = verb_and_size(Estimate(value, low, high), unit)
    return f"{verb} {name} by {size}"


def verb_and_size(change: Estimate, unit: str) -> tuple[str, str]:
    """Return the verb that the interval of a change supports, and the size; that of a reduction is positive."""
    value, low, high = change
    if low <= 0 <= high or not value:
        return "changes", interval_text(change, unit, sign=True)
    if value > 0:
        return "raises", interval_text(change, unit)
    return "lowers", interval_text(Estimate(-value, -high, -low), unit)


def explanation(trials: Trials) -> str:
    """Say how the columns of a comparison are computed."""
    if trials.unpaired:
        average = comparison_text.UNPAIRED[trials.headline]
        return f"Runs are not paired. Change: {average} of finished runs, with Welch's interval (together: Bonferroni)."
    return (
        f"Runs are paired with those of {trials.baseline}; a failed run is worse than any finished one, and averages "
        f"rest on the runs that both finished. Change: {AVERAGES[trials.headline]}. Tied: within "
        f"{100 * trials.relevant:g} %. Superiority: share of the runs in which the method is better; a tied run counts "
        "half. p: p value of the Wilcoxon signed-rank test, adjusted by Holm's method. Verdicts: for the primary "
        "metric only, from simultaneous intervals for all methods and all points of a sweep."
    )


@dataclass(frozen=True, eq=False, repr=False)
class ComparisonTable(FrameTable):
    """Paired comparisons of methods with a baseline."""

    summary: Summary  # of the compared methods and metrics, with the same comparisons
    sentences: tuple[str, ...]  # each row as one sentence that can be quoted
    notes: tuple[str, ...]  # what the columns mean: pairing, level of the intervals, relevant change

    whole = WHOLE

    @property
    def content(self) -> Columns:
        """Sweep columns, then the columns `comparison.COLUMNS`; one row per metric and method."""
        return self.summary.compared_columns

    def to_dict(self) -> list[dict[str, Any]]:
        """Return the rows as plain data; a missing number is None."""
        rows = [{**point.trials.point, **row} for point in self.summary.points for row in point.compared]
        return [{name: value if value == value else None for name, value in row.items()} for row in rows]

    def to_markdown(self) -> str:
        """Return the table with its notes as Markdown, ending with a line end."""
        return inert_markdown("\n".join([markdown_table(texts_of(self.content)), "", *self.notes, ""]))

    def to_latex(
        self, metric: str | None = None, *, columns: Sequence[Column] | None = None, width: float = WIDTH
    ) -> str:
        """Return the table of a metric for a paper; see `Summary.to_latex`."""
        return self.summary.to_latex(metric, columns=columns, width=width)

    def __repr__(self) -> str:
        return f"<ComparisonTable: {n_rows(self.content)} comparisons with {self.summary.points[0].trials.baseline}>"

    def _repr_html_(self) -> str:
        return self.summary._repr_html_()

    def __str__(self) -> str:
        return "\n".join([*self.sentences, *self.notes])


def _check_ranges(relevant: float | None, confidence: float | None) -> None:
    """Refuse a relevant change or a level that is no share."""
    if confidence is not None and not 0 < confidence < 1:
        raise DesignError(f"confidence must lie between 0 and 1 (got {confidence:g})", "confidence")
    if relevant is not None and not 0 <= relevant < 1:
        raise DesignError(f"relevant must be at least 0 and below 1 (got {relevant:g})", "relevant")


def comparison_table(
    trials: Trials,
    *,
    metric: str | None = None,
    methods: Sequence[str] | None = None,
    baseline: str | None = None,
    relevant: float | None = None,
    confidence: float | None = None,
) -> ComparisonTable:
    """Compare methods with a baseline run by run, at every point of a sweep; see `rmpc_bench.compare`."""
    _check_ranges(relevant, confidence)
    infos = {info.name: info for info in trials.metrics}
    chosen = trials.baseline if baseline is None else baseline
    if metric is not None and metric not in infos:
        raise DesignError(f"metric: {unknown(metric, infos, 'metric')}", "metric")
    for argument, name in (("baseline", chosen), *(("methods", name) for name in methods or ())):
        if name not in trials.methods:
            raise DesignError(f"{argument}: {unknown(name, trials.methods, 'method')}", argument)
    shown = trials.methods if methods is None else (chosen, *(name for name in methods if name != chosen))
    points = [
        replace(
            point,
            baseline=chosen,
            methods=tuple(name for name in shown if name in point.methods),
            metrics=trials.metrics if metric is None else (infos[metric],),
            relevant=trials.relevant if relevant is None else relevant,
            margins=trials.margins if relevant is None else {},
            confidence=trials.confidence if confidence is None else confidence,
        )
        for point in trials.each
    ]
    of = levels(replace(trials, points=tuple(points)) if trials.points else points[0])
    found = [PointSummary(point, statistics.summary(point), comparisons(point, of)) for point in points]
    return ComparisonTable(
        summary=Summary(found),
        sentences=tuple(
            (f"{point.title}: " if point.title else "") + sentence(row, infos[row["metric"]], point)
            for point, _, compared in found
            for row in compared
        ),
        notes=(explanation(points[0]),),
    )
