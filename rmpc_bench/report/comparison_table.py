"""Comparisons with the baseline: sentences that can be quoted, and the record with data frame, Markdown and text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rmpc_bench.analysis import comparison_text
from rmpc_bench.analysis.columns import Columns, n_rows
from rmpc_bench.analysis.comparison import WHOLE, comparisons, levels
from rmpc_bench.analysis.comparison_text import change_of, margin_of, size_text
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.shown_numbers import Estimate, interval_text
from rmpc_bench.analysis.statistics import summary
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.tuning import pair_text
from rmpc_bench.report.latex import WIDTH
from rmpc_bench.report.point_tables import AVERAGES, FrameTable, PointSummary, markdown_table, texts_of
from rmpc_bench.report.run_notes import counted
from rmpc_bench.report.summary import Summary
from rmpc_bench.types import DesignError, MetricInfo
from rmpc_bench.types.errors import unknown
from rmpc_bench.types.result_layout import Column
from rmpc_bench.types.texts import inert_markdown


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
    found = [PointSummary(point, summary(point), comparisons(point, of)) for point in points]
    return ComparisonTable(
        summary=Summary(found),
        sentences=tuple(
            (f"{point.title}: " if point.title else "") + sentence(row, infos[row["metric"]], point)
            for point, _, compared in found
            for row in compared
        ),
        notes=(explanation(points[0]),),
    )
