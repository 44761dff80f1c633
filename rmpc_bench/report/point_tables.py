"""What tables of page, Markdown, LaTeX, CSV and screen share: statistics point by point, and tables in Markdown."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.columns import Columns, Rows, columns_of, data_frame, n_rows
from rmpc_bench.analysis.rounding import rounded
from rmpc_bench.analysis.trials import Trials
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
