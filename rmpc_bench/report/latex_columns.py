"""Columns of a table in LaTeX: their cells, their heads, and which of them fit into a column of a paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rmpc_bench.analysis.result_rows import ResultTable
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import typeset, wrapped
from rmpc_bench.report.columns import average_of, columns_of
from rmpc_bench.report.latex_numbers import number_latex
from rmpc_bench.report.latex_text import to_latex, unit_latex
from rmpc_bench.report.latex_width import table_width
from rmpc_bench.types import MetricInfo
from rmpc_bench.types.report_choices import Column

USUAL: tuple[Column, ...] = ("mean", "lost", "change", "counts", "verdict")
"""Columns of a table unless others are chosen; where they do not fit, the last ones are left out, up to the change."""
GAP = 0.9
"""Distance between columns, in units of the size of the text."""
HEAD = 45.0
"""Width of a line in the head of a column [pt]."""
LABEL = 60.0
"""Width of a line of a label that is broken [pt]."""
_STACKED = r"\begin{{tabular}}[{}]{{@{{}}{}@{{}}}}{}\end{{tabular}}"


def chosen_columns(tables: Sequence[ResultTable], columns: Sequence[Column] | None, width: float) -> list[Column]:
    """Return the columns behind the name of the method: the asked ones that exist, or the usual ones that fit.

    The tables are of one metric, at every point of the sweep; the width is in pt.
    """
    there = [latex_cells(table) for table in tables]
    wanted = [name for name in columns or USUAL if any(name in each for each in there)] or ["mean"]
    least = 3 if "lost" in wanted else 2
    while columns is None and len(wanted) > least and _width(tables, there, wanted) > width:
        wanted = wanted[:-1]
    return list(wanted)


def _width(
    tables: Sequence[ResultTable], there: Sequence[Mapping[Column, Sequence[str]]], wanted: Sequence[Column]
) -> float:
    rows = [row for table, each in zip(tables, there, strict=True) for row in rows_of(table, each, wanted)]
    return table_width(["Method", *(head_of(tables[0], name) for name in wanted)], rows, GAP)


def rows_of(table: ResultTable, there: Mapping[Column, Sequence[str]], wanted: Sequence[Column]) -> list[list[str]]:
    """Return the rows of a table: name of the method, then the columns."""
    absent = ["--"] * len(table.rows)
    names = [label_of(table.trials, row.method) for row in table.rows]
    return [list(row) for row in zip(*[names, *(there.get(name, absent) for name in wanted)], strict=True)]


def latex_cells(table: ResultTable) -> dict[Column, list[str]]:
    """Return the columns that a table has, each as LaTeX; the unit of a change stands in its head."""
    units: dict[Column, str] = {"lost": " %", "change": f" {_unit_of_change(table)}", "other": " %"}
    return {
        name: [number_latex(text.replace(units.get(name, "\0"), "", 1)) for text in texts]
        for name, texts in columns_of(table).items()
    }


def _unit_of_change(table: ResultTable) -> str:
    return table.info.unit if average_of(table) == "difference" else "%"


def head_of(table: ResultTable, column: Column) -> str:
    """Return the head of a column as LaTeX."""
    average = average_of(table)
    unit = bracketed(table.info.unit)
    if column == "mean":
        return stacked(["Occurred;", f"median {unit}"]) if table.may_not_occur else stacked(["Mean", unit])
    if column == "other":
        return stacked(["Geometric", r"mean [\%]"] if average == "mean" else ["Ratio of", r"means [\%]"])
    heads: dict[Column, list[str]] = {
        "lost": ["Lost", r"[\%]"],
        "median": ["Median", f"[quartiles] {unit}".strip()],
        "change": ["Difference" if average == "difference" else "Change", bracketed(_unit_of_change(table))],
        "counts": ["Won/lost/", "tied"],
        "superiority": ["Superiority"],
        "p": ["$p$"],
        "verdict": ["Verdict"],
        "n": ["Runs/", "failed"],
        "held": ["Held", "steps"],
        "steps": ["Failed", "steps"],
        "pairs": ["Pairs"],
    }
    return stacked(heads[column])


def bracketed(unit: str) -> str:
    """Write a unit in brackets; empty for a number without one."""
    return f"[{unit_latex(unit)}]" if unit else ""


def stacked(lines: Sequence[str], *, place: str = "b", align: str = "c") -> str:
    """Put lines of LaTeX, without the empty ones, below each other, so that a column is as narrow as its numbers.

    Place ``b`` puts the last line at the height of the row, ``t`` the first; the alignment is ``c`` or ``l``.
    """
    there = [line for line in lines if line]
    # A bracket behind a line break would be read as its option.
    return _STACKED.format(place, align, r"\\{}".join(there)) if len(there) > 1 else "".join(there)


def capitalised(words: str) -> str:
    """Begin with a capital letter; a formula stays as it is."""
    return words[:1].upper() + words[1:]


def name_lines(info: MetricInfo) -> list[str]:
    """Break the words of a metric, such as ``steady state error``, into short lines of LaTeX."""
    return [to_latex(line) for line in wrapped(typeset(capitalised(info.words)), HEAD)]


def label_of(trials: Trials, method: str) -> str:
    """Return the label of a method as LaTeX, where an oracle is marked."""
    return to_latex(_marked(trials, method))


def label_lines(trials: Trials, method: str) -> list[str]:
    """Break the label of a method at blanks outside its formulas into lines of LaTeX."""
    return [to_latex(line) for line in wrapped(typeset(_marked(trials, method)), LABEL)]


def _marked(trials: Trials, method: str) -> str:
    label = trials.labels.get(method, method)
    return label if "oracle" in label or method not in trials.oracles else f"{label} (oracle)"
