"""Tables of the metrics for a paper: bodies in LaTeX with booktabs, without a float.

``tables/METRIC.tex`` has a row per method and, in a sweep, a group of rows per point.  With a single column a sweep is
laid out with a row per point and a column per method.  ``tables/all-metrics.tex`` has a column per metric.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rmpc_bench.analysis.result_rows import ResultTable, result_table
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import printed, short_title, typeset, wrapped
from rmpc_bench.report.columns import COLUMNS, USUAL, columns_of, value_text, written
from rmpc_bench.report.latex_text import bracketed, number_latex, one_line, printed_latex, table_width, to_latex
from rmpc_bench.report.point_tables import PointSummary
from rmpc_bench.types import MetricInfo
from rmpc_bench.types.result_layout import Column

GAP = 0.9  # distance between columns, in units of the size of the text
HEAD = 45.0  # width of a line in the head of a column [pt]
LABEL = 60.0  # width of a line of a label that is broken [pt]
ALL_METRICS = "all-metrics"  # name of the table with a column per metric; no metric can have this name
MOST_POINTS = 50  # points of a sweep that a table shows; with more of them there is no table
WIDTH = 252.0  # width of a column of many journals [pt, of which an inch has 72.27]
_GAP = rf"@{{\hspace{{{GAP}em}}}}"


class Body(NamedTuple):
    """A table before it is written: a head, and groups of rows; the first cell of a row is a text."""

    head: Sequence[str]
    groups: Sequence[tuple[str, Sequence[Sequence[str]]]]  # title, which may be empty, and rows; all cells are LaTeX

    @property
    def width(self) -> float:
        """Estimate of the width [pt]."""
        return table_width(self.head, [row for _, rows in self.groups for row in rows], GAP)


class PaperTable(NamedTuple):
    """A table for a paper in LaTeX."""

    body: str
    caption: str
    note: str  # that defines the columns, below the table


def metric_body(
    tables: Sequence[ResultTable], columns: Sequence[Column] | None, width: float
) -> tuple[list[Column], Body]:
    """Lay out the table of a metric at every point: the asked columns that exist, or the usual ones that fit [pt]."""
    there = [latex_cells(table) for table in tables]

    def body(wanted: Sequence[Column], *, short: bool = False) -> Body:
        groups = []
        for table, cells in zip(tables, there, strict=True):
            names = [row_label(table.trials, row.method, short=short) for row in table.rows]
            found = [cells.get(name, ["--"] * len(names)) for name in wanted]
            groups.append((title_of(table.trials), [*zip(names, *found, strict=True)]))
        return Body(["Method", *(head_of(tables[0], name) for name in wanted)], groups)

    wanted = [name for name in columns or USUAL if any(name in each for each in there)] or ["mean"]
    least = 3 if "lost" in wanted else 2
    while columns is None and len(wanted) > least and body(wanted).width > width:
        wanted = wanted[:-1]
    if len(tables) == 1 or len(wanted) > 1:
        return list(wanted), fitting_body([body(wanted), body(wanted, short=True)], width)
    # A sweep with a single column has a row per point and a column per method.
    methods = list(dict.fromkeys(row.method for table in tables for row in table.rows))
    head = [head_of(tables[0], wanted[0]), *(stacked(label_lines(tables[0].trials, name)) for name in methods)]
    rows = []
    for table, cells in zip(tables, there, strict=True):
        of = dict(zip((row.method for row in table.rows), cells.get(wanted[0], ["--"] * len(table.rows)), strict=True))
        rows.append([title_of(table.trials), *(of.get(name, "--") for name in methods)])
    return list(wanted), Body(head, [("", rows)])


def latex_cells(table: ResultTable) -> dict[str, list[str]]:
    """Return the columns that a table has, each as LaTeX."""
    units = {key: written(column.unit, table) for key, column in COLUMNS.items()}
    found = columns_of(table)
    return {key: [number_latex(text.replace(units[key], "", 1)) for text in texts] for key, texts in found.items()}


def head_of(table: ResultTable, column: Column) -> str:
    """Return the head of a column as LaTeX."""
    return stacked(written(COLUMNS[column].latex, table).split("\n"))


def stacked(lines: Sequence[str], *, place: str = "b", align: str = "c") -> str:
    """Put lines of LaTeX below each other; place ``b`` has the last one at the height of the row, ``t`` the first."""
    there = [line for line in lines if line]
    # A bracket behind a line break would be read as its option.
    cells = r"\\{}".join(there)
    return rf"\begin{{tabular}}[{place}]{{@{{}}{align}@{{}}}}{cells}\end{{tabular}}" if len(there) > 1 else cells


def capitalised(words: str) -> str:
    """Begin with a capital letter; a formula stays as it is."""
    return words[:1].upper() + words[1:]


def name_lines(info: MetricInfo) -> list[str]:
    """Break the words of a metric, such as ``steady state error``, into short lines of LaTeX."""
    return [to_latex(line) for line in wrapped(typeset(capitalised(info.words)), HEAD)]


def label_lines(trials: Trials, method: str) -> list[str]:
    """Break the label of a method at blanks outside its formulas into lines of LaTeX."""
    return [to_latex(line) for line in wrapped(typeset(_marked(trials, method)), LABEL)]


def row_label(trials: Trials, method: str, *, short: bool) -> str:
    """Return the label of a method, where an oracle is marked, broken into lines if it has to be short."""
    lines = label_lines(trials, method) if short else [to_latex(_marked(trials, method))]
    return stacked(lines, place="t", align="l")


def _marked(trials: Trials, method: str) -> str:
    label = trials.labels.get(method, method)
    return label if "oracle" in label or method not in trials.oracles else f"{label} (oracle)"


def fitting_body(bodies: Sequence[Body], width: float) -> Body:
    """Return the first form of a table that fits [pt], or the narrowest one."""
    return next((body for body in bodies if body.width <= width), min(bodies, key=lambda body: body.width))


def title_of(trials: Trials) -> str:
    """Name a point of a sweep; empty without one."""
    return to_latex((short_title(trials) if trials.point else printed(trials.title)).replace("$", r"\$"))


def all_metrics_body(points: Sequence[PointSummary], width: float) -> Body:
    """Lay out the means of all metrics, a column or a row per metric."""
    infos = points[0].trials.metrics
    means = [(point.trials, _means(point, infos)) for point in points]
    heads = [stacked([*name_lines(info), bracketed(info.unit)]) for info in infos]
    as_columns = [
        Body(
            ["Method", *heads],
            [
                (title_of(trials), [[row_label(trials, name, short=short), *found[name]] for name in found])
                for trials, found in means
            ],
        )
        for short in (False, True)
    ]
    labelled = {name: label_lines(trials, name) for trials, found in means for name in found}
    names = [f"{to_latex(capitalised(info.words))} {bracketed(info.unit)}".rstrip() for info in infos]
    groups = []
    for trials, found in means:
        columns = [found.get(name, ["--"] * len(infos)) for name in labelled]
        groups.append((title_of(trials), [*zip(names, *columns, strict=True)]))
    as_rows = Body(["Metric", *map(stacked, labelled.values())], groups)
    return fitting_body([as_columns[0], as_rows, as_columns[1]], width)


def _means(point: PointSummary, infos: Sequence[MetricInfo]) -> dict[str, list[str]]:
    """Return method -> its mean of every metric; of an event in how many runs it occurred."""
    means: dict[str, list[str]] = {}
    for table in (result_table(*point, info) for info in infos):
        for row in table.rows:
            text = (
                f"{row.n_occurred}/{row.n}"
                if table.may_not_occur and row.n
                else value_text(row.mean.value, row.mean.half)
            )
            means.setdefault(row.method, []).append(number_latex(text))
    return means


def paper_table(
    name: str, body: Body, caption: str, note: str, comments: Sequence[str], left_out: str = ""
) -> PaperTable:
    """Write a table with comments at its head, and its texts, which have formulas between dollar signs.

    All columns but the first are aligned to the right.  A table without comments is no file: it names no other file,
    but what was left out.
    """
    n = len(body.head)
    more = f"caption: {name}.caption.tex; note: {name}.note.tex" if comments else left_out
    needs = "; ".join(filter(None, [r"needs \usepackage{booktabs}", more]))
    lines = [f"% {one_line(text)}" for text in [*comments, needs]]
    lines += [rf"\begin{{tabular}}{{@{{}}l{(_GAP + 'r') * (n - 1)}@{{}}}}", r"\toprule", _row(body.head), r"\midrule"]
    for number, (title, rows) in enumerate(body.groups):
        lines += [r"\addlinespace"] if number and title else []
        lines += [rf"\multicolumn{{{n}}}{{@{{}}l}}{{\textit{{{title}}}}} \\"] if title else []
        lines += [_row(row) for row in rows]
    text = "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])
    return PaperTable(text, f"{to_latex(caption)}%\n", f"{printed_latex(note)}%\n")


def _row(row: Sequence[str]) -> str:
    """Write a row; braces keep LaTeX from reading a bracket or a star at its beginning as an option of the last row."""
    first = f"{{}}{row[0]}" if row[0].startswith(("[", "*")) else row[0]
    return " & ".join([first, *row[1:]]) + r" \\"
