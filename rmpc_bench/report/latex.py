"""Tables of the metrics for a paper: bodies in LaTeX with booktabs, without a float.

``tables/METRIC.tex`` has a row per method and, in a sweep, a group of rows per point.  With a single column a sweep is
laid out with a row per point and a column per method.  ``tables/all-metrics.tex`` has a column per metric.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.sweep_points import short_title
from rmpc_bench.report import cells
from rmpc_bench.report.cells import MetricTable, metric_table
from rmpc_bench.report.latex_numbers import number_latex
from rmpc_bench.report.latex_text import one_line, to_latex, unit_latex
from rmpc_bench.report.run_notes import held_cells
from rmpc_bench.report.summary import PointSummary, Summary
from rmpc_bench.types import MetricInfo
from rmpc_bench.types.report_choices import Column

USUAL: tuple[Column, ...] = ("mean", "change", "counts", "verdict")
"""Columns of a table unless others are chosen, as far as the experiment has them."""
ALL_METRICS = "all-metrics"
"""Name of the table with a column per metric; no metric can have this name."""
MOST_POINTS = 50
"""Points of a sweep that a table shows; with more of them there is no table."""
_STACKED = r"\begin{{tabular}}[b]{{@{{}}c@{{}}}}{}\end{{tabular}}"
_GAP = r"@{\hspace{0.9em}}"


class Body(NamedTuple):
    """A table before it is written: a head, and groups of rows; the first cell of a row is a text."""

    head: Sequence[str]
    groups: Sequence[tuple[str, Sequence[Sequence[str]]]]
    """Title of the group, empty without one, and its rows; all cells are LaTeX."""


def latex_tables(
    summary: Summary, comments: Sequence[str] = (), columns: Sequence[Column] | None = None
) -> dict[str, str]:
    """Return name -> LaTeX of the table of every metric, and of all metrics together where there are several.

    Parameters
    ----------
    summary : the statistics, with the methods and metrics to show
    comments : lines at the head: version, hash, seed, number of runs, command
    columns : columns behind the name of the method; `USUAL` if None
    """
    points = shown_points(summary)
    if not points:
        return {}
    bodies = {info.name: body_of(points, info, columns) for info in points[0].trials.metrics}
    if len(bodies) > 1:
        bodies[ALL_METRICS] = _all_metrics(points)
    return {name: _written(body, comments, name) for name, body in bodies.items()}


def shown_points(summary: Summary) -> list[PointSummary]:
    """Return the points with runs, or all of them together where they are many plants; empty if there are too many."""
    points = [summary.pooled] if summary.pooled else list(summary.points)
    points = [point for point in points if len(point.trials.frame)]
    return points if len(points) <= MOST_POINTS else []


def body_of(points: Sequence[PointSummary], info: MetricInfo, columns: Sequence[Column] | None) -> Body:
    """Lay out the table of one metric.

    Parameters
    ----------
    points : one, or the points of a sweep
    info : the metric
    columns : columns behind the name of the method; `USUAL` if None
    """
    tables = [metric_table(*point, info) for point in points]
    there = [columns_of(table) for table in tables]
    wanted = [name for name in columns or USUAL if name != "label" and any(name in each for each in there)]
    wanted = wanted or ["mean"]
    if len(points) > 1 and len(wanted) == 1:
        return _methods_as_columns(tables, there, wanted[0])
    head = ["Method", *(head_of(tables[0], name) for name in wanted)]
    groups = []
    for table, cells_of in zip(tables, there, strict=True):
        absent = ["--"] * len(table.lines)
        rows = [*zip(*([_names(table)] + [cells_of.get(name, absent) for name in wanted]), strict=True)]
        groups.append((_title(table.trials), rows))
    return Body(head, groups)


def columns_of(table: MetricTable) -> dict[Column, list[str]]:
    """Return the columns that a table has, each as LaTeX.

    Parameters
    ----------
    table : of one metric at one point
    """
    trials = table.trials
    found: dict[Column, list[str]] = {"mean": cells.means(table), "median": cells.medians(table)}
    if table.with_comparisons and trials.with_verdicts:
        found["change"] = cells.changes(table)
        if other := cells.other_average(table):
            found["other"] = cells.changes(table, other)
        found["counts"] = cells.counts(table)
        found["superiority"] = cells.superiorities(table)
        found["p"] = cells.p_values(table)
        # What is needed for a decision stands in summary.md; the caption defines the margin.
        words = [word.partition(" (")[0] for word in cells.verdicts(table)]
        found |= {"verdict": [word or "-" for word in words]} if any(words) else {}
        found["pairs"] = cells.pairs(table)
    found["n"] = cells.sizes(table)
    if held := held_cells(trials, [line.method for line in table.lines]):
        found["held"] = held
    # A column of hyphens says nothing.
    return {
        name: [number_latex(cell) for cell in texts]
        for name, texts in found.items()
        if name == "mean" or any(cell != "-" for cell in texts)
    }


def head_of(table: MetricTable, column: Column) -> str:
    """Return the head of a column as LaTeX.

    Parameters
    ----------
    table : of one metric
    column : which one
    """
    average = cells.average_of(table)
    unit = f"[{unit_latex(table.info.unit)}]" if table.info.unit else ""
    if column == "mean":
        return "Did not occur" if table.may_not_occur else _stacked("Mean", unit)
    if column == "other":
        return _stacked("Geometric", "mean") if average == "mean" else _stacked("Ratio of", "the means")
    heads: dict[Column, str] = {
        "median": _stacked("Median", f"[quartiles] {unit}".strip()),
        "change": "Difference" if average == "difference" else "Change",
        "counts": _stacked("Won/lost/", "tied"),
        "superiority": "Superiority",
        "p": "$p$",
        "verdict": "Verdict",
        "n": _stacked("Runs/", "failed"),
        "held": _stacked("Held", "steps"),
        "pairs": "Pairs",
    }
    return heads[column]


def _stacked(above: str, below: str) -> str:
    """Put the words of a head below each other, so that a column is as narrow as its numbers."""
    return _STACKED.format(rf"{above}\\{{}}{below}") if below else above


def _names(table: MetricTable) -> list[str]:
    return [_label(table.trials, line.method) for line in table.lines]


def _label(trials: Trials, method: str) -> str:
    label = trials.labels.get(method, method)
    marked = label if "(oracle)" in label or method not in trials.oracles else f"{label} (oracle)"
    return to_latex(marked)


def _title(trials: Trials) -> str:
    """Name a point of a sweep; empty without one."""
    return to_latex((short_title(trials) if trials.point else trials.title).replace("$", r"\$"))


def _methods_as_columns(
    tables: Sequence[MetricTable], there: Sequence[Mapping[Column, Sequence[str]]], column: Column
) -> Body:
    """Lay a sweep out with a row per point and a column per method."""
    methods = list(dict.fromkeys(line.method for table in tables for line in table.lines))
    head = [head_of(tables[0], column), *(_label(tables[0].trials, method) for method in methods)]
    rows = []
    for table, cells_of in zip(tables, there, strict=True):
        by_method = dict(zip((line.method for line in table.lines), cells_of.get(column, ()), strict=False))
        rows.append([_title(table.trials), *(by_method.get(method, "--") for method in methods)])
    return Body(head, [("", rows)])


def _all_metrics(points: Sequence[PointSummary]) -> Body:
    """Lay out the means of all metrics, or the number of runs without the event."""
    infos = points[0].trials.metrics
    units = [f"[{unit_latex(info.unit)}]" if info.unit else "" for info in infos]
    head = ["Method", *(_stacked(to_latex(info.name), unit) for info, unit in zip(infos, units, strict=True))]
    groups = []
    for point in points:
        tables = [metric_table(*point, info) for info in infos]
        columns = [[number_latex(cell) for cell in cells.means(table)] for table in tables]
        groups.append((_title(point.trials), [*zip(_names(tables[0]), *columns, strict=True)]))
    return Body(head, groups)


def _written(body: Body, comments: Sequence[str], name: str) -> str:
    """Write a table with its comments; all columns but the first are aligned to the right."""
    n = len(body.head)
    needs = rf"needs \usepackage{{booktabs}}; caption: {name}.caption.tex"
    lines = [f"% {one_line(text)}" for text in [*comments, needs]]
    lines += [rf"\begin{{tabular}}{{@{{}}l{(_GAP + 'r') * (n - 1)}@{{}}}}", r"\toprule", _row(body.head), r"\midrule"]
    for number, (title, rows) in enumerate(body.groups):
        lines += [r"\addlinespace"] if number and title else []
        lines += [rf"\multicolumn{{{n}}}{{@{{}}l}}{{\textit{{{title}}}}} \\"] if title else []
        lines += [_row(row) for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _row(row: Sequence[str]) -> str:
    """Write a row; braces keep LaTeX from reading a bracket or a star at its beginning as an option of the last row."""
    first = f"{{}}{row[0]}" if row[0].startswith(("[", "*")) else row[0]
    return " & ".join([first, *row[1:]]) + r" \\"
