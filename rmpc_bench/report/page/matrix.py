"""Sweeps as tables of cells: methods against points, heat tables of two paths, and the list of all intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rmpc_bench.analysis.result_rows import BETTER, WORSE, ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import short
from rmpc_bench.figures.labels import printed, short_title
from rmpc_bench.figures.sweep_content import NAME, main_paths
from rmpc_bench.report.point_tables import columns_from

MOST_OPEN = 60  # points of a sweep up to which a matrix is not folded
MOST_METHODS, FIRST_METHODS = 6, 2  # up to which no heat table is folded; else the first ones are not
MOST_BESIDE, MOST_BESIDE_NARROW = 7, 11  # columns of a matrix that fits beside the lines, and beside the small drawing
MOST_ROWS = 600  # of the list of intervals; comparisons.csv has all


class MatrixCell(NamedTuple):
    """The change of a method at a point."""

    text: str
    css: str = ""
    method: str = ""
    tip: str = ""


class MatrixRow(NamedTuple):
    """A point, or a method."""

    name: str
    cells: Sequence[MatrixCell]
    css: str = ""
    method: str = ""


class Matrix(NamedTuple):
    """Cells with their heads."""

    corner: str
    heads: Sequence[MatrixCell]
    rows: Sequence[MatrixRow]
    caption: str = ""
    method: str = ""  # the only one that it shows
    names: bool = False  # whether heads are names, which are broken into lines

    @property
    def css(self) -> str:
        """How it is shown: whether heads are broken, and whether a phone has small letters or leaves the means out."""
        n = len(self.heads)
        kinds = {"names": self.names, "tight": n >= MOST_BESIDE, "tighter": n > MOST_BESIDE}
        return " ".join(["matrix", *(name for name, wanted in kinds.items() if wanted)])

    @property
    def columns(self) -> dict[str, list[str]]:
        """Head -> texts, as Markdown shows them."""
        heads = {head.text: [row.cells[k].text for row in self.rows] for k, head in enumerate(self.heads)}
        return {self.corner: [row.name for row in self.rows]} | heads


class Group(NamedTuple):
    """Matrices behind one title, folded if it is not empty."""

    title: str
    matrices: Sequence[Matrix]


def matrices_of(tables: Sequence[ResultTable]) -> list[Group]:
    """Lay out a sweep: two paths as a table per method, else methods against points."""
    paths = main_paths([table.trials.point for table in tables])
    if len(paths) == 2:
        downs, acrosses = ([*dict.fromkeys(table.trials.point[path] for table in tables)] for path in paths)
        if len(downs) > 1 and len(acrosses) > 1:
            return _heat_tables(tables, paths)
    if len(tables) <= MOST_OPEN:
        return [Group("", [_matrix(tables)])]
    parts: dict[str, list[ResultTable]] = {}
    for table in tables:
        parts.setdefault(table.trials.point.get(paths[0], "") if len(paths) > 1 else "", []).append(table)
    if len(parts) == 1:
        return [Group("", [_matrix(tables[:MOST_OPEN])]), Group("further points", [_matrix(tables[MOST_OPEN:])])]
    name = _last(paths[0])
    return [Group(f"{name} {printed(value)}", [_matrix(part)]) for value, part in parts.items()]


def methods_of(tables: Sequence[ResultTable]) -> list[ResultRow]:
    """Return a row of every method besides the baseline, oracles last."""
    found = {row.method: row for table in reversed(tables) for row in table.rows if not row.is_baseline}
    order = [*dict.fromkeys(row.method for table in tables for row in table.rows if not row.is_baseline)]
    return sorted((found[name] for name in order), key=lambda row: row.is_oracle)


def _matrix(tables: Sequence[ResultTable]) -> Matrix:
    methods, first = methods_of(tables), tables[0]
    [path] = paths if len(paths := main_paths([table.trials.point for table in tables])) == 1 else [NAME]
    titles = [short_title(each.trials) if path == NAME else printed(each.trials.point[path]) for each in tables]
    # The best method of a point if it is better than the baseline, by its estimate.
    nothing = 50 if first.form == "share" else 0
    best = [table.best for table in tables]
    lowest = [row.method if row and table.rank(row) < nothing else "" for table, row in zip(tables, best, strict=True)]
    places = [*zip(tables, titles, lowest, strict=True)]
    # The baseline has its means, the others their changes.
    heads = [MatrixCell(row.method, "oracle" * row.is_oracle, row.method) for row in methods]
    lines = [[_cell(table, row.method, title, best) for table, title, best in places] for row in methods]
    means = [MatrixCell(_mean(table, table.baseline), "mean") for table in tables]
    if any(mean.text for mean in means):
        heads, lines = [MatrixCell(f"{first.baseline}, {first.mean_word}", "mean"), *heads], [means, *lines]
    if len(tables) >= len(methods):
        rows = [MatrixRow(title, [line[k] for line in lines]) for k, title in enumerate(titles)]
        corner = "point" if path == NAME else _last(path)
        return Matrix(corner, heads, rows, names=len(heads) > MOST_BESIDE or max(map(len, titles)) > MOST_BESIDE)
    rows = [
        MatrixRow(head.text, [cell._replace(method="") for cell in line], head.css, head.method)
        for head, line in zip(heads, lines, strict=True)
    ]
    return Matrix("method", [MatrixCell(title) for title in titles], rows, names=True)


def _last(path: str) -> str:
    return path.rpartition(".")[2]


def _mean(table: ResultTable, method: str) -> str:
    """Write the mean of a method at a point."""
    row = table.row_of(method)
    if row is None or not row.n:
        return ""
    return table.mean_text(row) if table.may_not_occur else short(row.mean.value)


def _cell(table: ResultTable, method: str, title: str, lowest: str) -> MatrixCell:
    row = table.row_of(method)
    if table.form == "alone":
        return MatrixCell(_mean(table, method), "", method)
    if row is None:
        return MatrixCell("", "", method)
    css = [row.word] if row.word in (BETTER, WORSE) else ["fails"] if row.word == "fails more" else []
    text = table.short_change(row)
    tip = ": ".join(filter(None, [f"{method} at {title}", table.change_text(row), row.word]))
    return MatrixCell(text, " ".join([*css, *["best"] * (method == lowest)]), method, tip)


def _heat_tables(tables: Sequence[ResultTable], paths: Sequence[str]) -> list[Group]:
    """Lay out a table per method: the values of the longer path go down."""
    values = {path: [*dict.fromkeys(table.trials.point[path] for table in tables)] for path in paths}
    down, across = sorted(paths, key=lambda path: -len(values[path]))
    at = {(table.trials.point[down], table.trials.point[across]): table for table in tables}
    found = []
    # A method alone has its means.
    for name in [row.method for row in methods_of(tables)] or [tables[0].baseline]:
        rows = []
        for value in values[down]:
            cells = [
                _cell(at[value, other], name, f"{printed(value)}, {printed(other)}", "")._replace(method="")
                if (value, other) in at
                else MatrixCell("")
                for other in values[across]
            ]
            rows.append(MatrixRow(printed(value), cells))
        heads = [MatrixCell(printed(value)) for value in values[across]]
        found.append(Matrix(_last(down), heads, rows, f"{name}, by {_last(across)}", name))
    if len(found) < MOST_METHODS:
        return [Group("", found)]
    rest = found[FIRST_METHODS:]
    return [Group("", found[:FIRST_METHODS]), Group(f"{len(rest)} more methods", rest)]


def interval_rows(tables: Sequence[ResultTable]) -> dict[str, list[str]]:
    """Return head -> cells with point, method, mean, change and verdict of every row, `MOST_ROWS` at most."""
    rows = [(table, row) for table in tables for row in table.rows if row.n + row.n_failed]
    return columns_from(
        {"point": short_title(table.trials), "method": row.method}
        | {"mean": table.mean_text(row), "change": table.change_text(row), "verdict": row.word}
        for table, row in rows[:MOST_ROWS]
    )
