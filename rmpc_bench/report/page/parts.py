"""Parts of a page that are opened on demand, as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rmpc_bench.report.page.matrix import Group
from rmpc_bench.report.page.source import PageFigure


class Table(NamedTuple):
    """Columns, of which the first one names the rows."""

    columns: Mapping[str, Sequence[str]]
    numeric: bool = True
    by_method: bool = False
    """Whether the first column has methods, which are names and no formulas."""

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The cells of every row."""
        return [*zip(*self.columns.values(), strict=True)]


class Part(NamedTuple):
    """A part of a fold; all but one of its fields are empty."""

    text: str = ""
    note: str = ""
    command: str = ""
    items: Sequence[str] = ()
    table: Table | None = None
    groups: Sequence[Group] = ()
    figure: PageFigure | None = None


class Fold(NamedTuple):
    """A part of the page that is opened on demand."""

    title: str
    gist: str
    parts: Sequence[Part]
