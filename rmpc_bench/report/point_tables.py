"""What tables of page, Markdown, LaTeX, CSV and screen share: statistics point by point, tables in Markdown and as CSV.

A CSV file has the bytes of pandas without its import, and numbers that every CPU writes alike.  See
`rmpc_bench.analysis.rounding` for the rules of the tables for version control; trials.csv keeps full precision.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.columns import Columns, Rows, columns_of, data_frame, n_rows
from rmpc_bench.analysis.comparison import ADJUSTED
from rmpc_bench.analysis.rounding import NEGLIGIBLE, rounded
from rmpc_bench.analysis.runs import RunNotes
from rmpc_bench.analysis.statistics import NUMBERS
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.replaced_file import replaced
from rmpc_bench.types import Array
from rmpc_bench.types.texts import inert_markdown, without_links

if TYPE_CHECKING:
    import pandas as pd

# What a change in per cent is an average of.
AVERAGES = {"geometric": "geometric mean of the paired ratios", "mean": "ratio of the means"}


class PointSummary(NamedTuple):
    """The statistics of one table of trials."""

    trials: Trials
    described: Rows  # one row per method and metric, see `statistics.summary`
    compared: Rows  # one row per comparison with the baseline, see `comparison.comparisons`


class Points(NamedTuple):
    """Statistics point by point."""

    points: Sequence[PointSummary]  # the whole table where there is no sweep
    pooled: PointSummary | None = None  # the runs of all points, where these are many plants with the same methods

    @property
    def with_runs(self) -> list[PointSummary]:
        """All points together where they are many plants, else those that have runs."""
        points = [self.pooled] if self.pooled else self.points
        return [point for point in points if len(point.trials.runs)]


def stacked_points(parts: Sequence[tuple[Trials, Rows]], names: Sequence[str]) -> dict[str, list[Any]]:
    """Put the tables of points below each other as columns, those of the sweep in front."""
    paths = parts[0][0].point if parts else ()
    return columns_of([{**trials.point, **row} for trials, rows in parts for row in rows], [*paths, *names])


def rounded_columns(columns: Columns, names: Sequence[str], scale: float = 0.0) -> dict[str, Any]:
    """Round the numbers of some columns for version control, beside the scale of what they were computed from."""
    return {**columns, **{name: rounded(np.array(columns[name], dtype=float), scale) for name in names}}


_CODE = re.compile("`[^`]+`")
_MARKS = re.compile(r"[*`\\$]|(?<!\w)_|_(?!\w)")
_LINKED = re.compile(r"\\(?:href|url)|://|www\.", re.IGNORECASE)


def columns_from(rows: Iterable[Mapping[str, str]]) -> dict[str, list[str]]:
    """Return head -> cells of rows that are given as head -> cell."""
    columns: dict[str, list[str]] = {}
    for row in rows:
        for head, cell in row.items():
            columns.setdefault(head, []).append(cell)
    return columns


def markdown_page(parts: Sequence[str]) -> str:
    """Join the parts of a file in Markdown; empty without any."""
    return inert_markdown("\n\n".join(parts)) + "\n" if parts else ""


def markdown_table(columns: Mapping[str, Sequence[str]]) -> str:
    """Lay out columns, head -> cells, as a Markdown table without a line end."""
    rows = [list(columns), *([*row] for row in zip(*columns.values(), strict=True))]
    texts = ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
    return "\n".join([texts[0], "|" + " --- |" * len(columns), *texts[1:]])


def titled_tables(
    points: Sequence[tuple[Trials, Rows]], columns: Callable[[Trials, Rows], Mapping[str, list[str]]]
) -> list[str]:
    """Return the title and the table in Markdown of every point that has rows."""
    found = [(trials.title, markdown_table(columns(trials, rows))) for trials, rows in points if rows]
    return [text for title, table in found for text in ([f"# {title}", table] if title else [table])]


def _cell(text: str) -> str:
    text = text.replace("\n", " ")
    if not _CODE.fullmatch(text):
        marks = _MARKS if "$" not in text or _LINKED.search(text) else None
        text = without_links(marks.sub(r"\\\g<0>", text) if marks else text)
    return inert_markdown(text).replace("|", r"\|")


LONGEST = 2800  # characters of the rows of a table; its head and its end come on top


class FrameTable:
    """A table with a data frame; a derived dataclass has no `__repr__` of its own."""

    whole: Sequence[str] = ()  # columns of whole numbers that may be missing

    @property
    def content(self) -> Columns:
        """Content of the CSV file."""
        raise NotImplementedError("content")

    def to_markdown(self) -> str:
        """Return the table as Markdown; empty without content."""
        raise NotImplementedError("to_markdown")

    @property
    def frame(self) -> pd.DataFrame:
        """The table."""
        return data_frame(self.content, self.whole)

    def to_frame(self) -> pd.DataFrame:
        """Return the table."""
        return self.frame

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {n_rows(self.content)} rows>"

    def _repr_html_(self) -> str:
        return html_table(texts_of(self.content)) if n_rows(self.content) else escape(repr(self))


def texts_of(columns: Columns, digits: int = 4) -> dict[str, list[str]]:
    """Return the columns of a table as texts; a missing number is empty."""

    def text(cell: object) -> str:
        if cell is None or cell != cell:
            return ""
        return f"{cell:.{digits}g}" if isinstance(cell, float) else str(cell)

    return {name: [*map(text, cells)] for name, cells in columns.items()}


def html_table(columns: Mapping[str, Sequence[str]], write: Callable[[str], str] = escape) -> str:
    """Lay out columns, head -> cells, as HTML for a notebook; rows that would make it too long are only counted."""
    rows = [*zip(*columns.values(), strict=True)]
    found = [f"<tr><th>{'<th>'.join(map(write, columns))}"]
    found += [f"<tr><td>{'<td>'.join(map(write, row))}" for row in rows]
    ends = [sum(map(len, found[: n + 1])) for n in range(1, len(found))]
    n = sum(end <= LONGEST for end in ends)
    left = f"<tr><td colspan={len(columns)}>{len(rows) - n} more rows: to_frame()" if n < len(rows) else ""
    return f"<table>{''.join(found[: n + 1])}{left}</table>"


ROWS = 20_000  # rows that are texts at the same time


def write_csv(columns: Columns, path: Path) -> None:
    """Write a table so that equal tables give equal bytes and every float reads back as itself.

    Floats are their shortest repr, inf where an event did not occur, empty for missing.
    """
    with replaced(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        file.writelines(csv_lines(columns))


def csv_lines(columns: Columns) -> Iterator[str]:
    """Yield a table as blocks of lines, the names of the columns first."""
    yield ",".join(map(_quoted, columns)) + "\n"
    arrays = [*map(_array, columns.values())]
    for first in range(0, n_rows(columns), ROWS):
        texts = [_texts(array[first : first + ROWS]) for array in arrays]
        if len(texts) == 1:
            # An empty field that stands alone has quotes.
            texts = [[text or '""' for text in texts[0]]]
        yield "\n".join(map(",".join, zip(*texts, strict=True))) + "\n"


def _array(cells: Sequence[object] | Array) -> Array:
    """Return cells as an array: floats and whole numbers stay as they are, all others are objects."""
    found = np.asarray(cells)
    return found if found.dtype.kind in "fiu" else np.asarray(cells, dtype=object)


def _texts(values: Array) -> Iterable[str]:
    if values.dtype.kind in "iu":
        return map(str, values.tolist())
    if values.dtype.kind == "f":
        if values.dtype.itemsize < 8:
            return ["" if np.isnan(value) else str(value) for value in values]
        missing = np.isnan(values)
        texts = map(repr, values.tolist())
        return ["" if gone else text for gone, text in zip(missing, texts, strict=True)] if missing.any() else texts
    cells = ["" if each is None or each != each else str(each) for each in values.tolist()]
    return map({cell: _quoted(cell) for cell in {*cells}}.__getitem__, cells)


def _quoted(text: str) -> str:
    """Put a field in quotes where a reader would not find its end."""
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"\r\n') else text


def trials_csv(trials: Trials, path: Path) -> None:
    """Write the table of trials with the sweep columns, `method, run, status` and one column per metric.

    Where the runs were made elsewhere, `run_name` has their original names.  Where a component may hold failed steps,
    `held_steps` follows the status.  Where a controller optimises and goes on after a failed step, `failed_steps` and
    `worst_step` follow, the worst status of the steps of the run.
    """

    def known() -> Iterator[tuple[int, RunNotes | None]]:
        for table in trials.each:
            for method, run in zip(table.columns["method"], table.columns["run"].tolist(), strict=True):
                yield run, table.notes.get(method)

    steps: dict[str, list[Any]] = {}
    if any(each.holds for table in trials.each for each in table.notes.values()):
        steps["held_steps"] = [each.held.get(run, 0) if each else 0 for run, each in known()]
    if any(each.optimises for table in trials.each for each in table.notes.values()):
        steps["failed_steps"] = [each.n_failed_of(run) if each else 0 for run, each in known()]
        steps["worst_step"] = [each.worst_step_of(run) if each else "ok" for run, each in known()]
    original = {"run_name": [trials.run_names[run] for run in trials.columns["run"]]} if trials.run_names else {}
    head = [*trials.paths, "method", "run", *original, "status"]
    columns = {**trials.columns, **steps, **original}
    names = [*head, *steps, *(info.name for info in trials.metrics)]
    write_csv({name: columns[name] for name in names}, path)


MIDDLE = ["median", "q25", "q75"]
CHANGES = ["change_pct", "ci_low", "ci_high", "geometric_pct", "geometric_low", "geometric_high"]
CHANGES += ["mean_pct", "mean_low", "mean_high"]
CHANGES += [name for name in ADJUSTED if name.startswith(("geometric_", "mean_"))]
SHARES = ["superiority", "ci_level", "superiority_low", "superiority_high", "failed_low", "failed_high"]
SHARES += ["far_worse_upper", "baseline_far_worse_upper"]
DIFFERENCES = ["difference", "difference_low", "difference_high"]
DIFFERENCES += [name for name in ADJUSTED if name.startswith("difference_")]
UNRELIABLE = 1e-12  # digits of a small metric that may be rounding errors of the numbers whose difference it is


def summary_table(described: Columns) -> Columns:
    """Return the content of summary.csv, from `Summary.described_columns`; counts and texts are exact.

    The scale of a row is its largest quartile, that of a metric the largest quartile of all rows of the metric.
    Minimum and maximum do not count, as those of a single run may be enormous.  Where the scale of a row is below
    `NEGLIGIBLE` of that of its metric, those of its numbers that are, too, are written as 0.  A row above it keeps its
    small numbers, such as the error of its mean.  No digit is kept below `NEGLIGIBLE` of the scale of the row or below
    `UNRELIABLE` of that of the metric.
    """
    numbers, middle = (np.array([described[name] for name in names], dtype=float).T for names in (NUMBERS, MIDDLE))
    sizes = np.abs(middle)
    of_row = np.max(np.where(np.isfinite(sizes), sizes, 0.0), axis=1, initial=0.0)[:, None]
    largest: dict[str, float] = {}
    for name, size in zip(described["metric"], of_row[:, 0], strict=True):
        largest[name] = max(size, largest.get(name, 0.0))
    of_metric = np.array([largest[name] for name in described["metric"]])[:, None]
    found = rounded(numbers, np.maximum(of_row, UNRELIABLE / NEGLIGIBLE * of_metric))
    smallest = NEGLIGIBLE * of_metric
    found = np.where((of_row < smallest) & (np.abs(numbers) < smallest), 0.0, found)
    columns = {name: cells for name, cells in described.items() if name != "did_not_occur"}
    return columns | dict(zip(NUMBERS, found.T, strict=True))


def comparisons_table(compared: Columns) -> Columns:
    """Return the content of comparisons.csv, from `Summary.compared_columns`; counts and texts are exact."""
    if "adjusted" not in compared["rests_on"]:
        # Where nothing is adjusted the file is that of an earlier version.
        compared = {name: cells for name, cells in compared.items() if name not in ADJUSTED}
    # Beside 100 per cent and 1; differences are rounded beside the numbers that they were computed from already.
    for names, scale in ((CHANGES, 100.0), (SHARES, 1.0), (DIFFERENCES, 0.0)):
        compared = rounded_columns(compared, [name for name in names if name in compared], scale)
    return compared
