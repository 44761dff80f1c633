"""Tables as plain columns, and series over time; pandas (0.4 s of a `run`) is imported for frames of users only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.types import Array

if TYPE_CHECKING:
    import pandas as pd

Columns = Mapping[str, Any]
"""Name of a column -> its cells, all of one length."""
Rows = Sequence[Mapping[str, Any]]
"""Rows of a small table, each as name of a column -> cell."""


def n_rows(columns: Columns) -> int:
    """Count the rows of a table."""
    return len(next(iter(columns.values()), ()))


def rows_at(columns: Columns, chosen: Array) -> dict[str, Array]:
    """Return some rows of a table of arrays, by their positions or as booleans."""
    return {name: cells[chosen] for name, cells in columns.items()}


def with_point(columns: Columns, point: Mapping[str, str]) -> dict[str, Any]:
    """Put columns of one text each, such as those of a point of a sweep, in front of a table of arrays."""
    n = n_rows(columns)
    return {path: one_text(value, n) for path, value in point.items()} | dict(columns)


def one_text(text: str, n: int) -> Array:
    """Return a column with one text in n rows, which is in memory once; `np.full` makes a text per row."""
    return np.repeat(np.array([text], dtype=object), n)


def stacked(tables: Sequence[Columns]) -> dict[str, Array]:
    """Put the tables that have rows below each other; a column that one of them lacks is NaN there."""
    tables = [table for table in tables if n_rows(table)] or tables[:1]
    if len(tables) == 1:
        return dict(tables[0])

    def cells(table: Columns, name: str) -> Array:
        return table[name] if name in table else np.full(n_rows(table), np.nan)

    names = dict.fromkeys(name for table in tables for name in table)
    return {name: np.concatenate([cells(table, name) for table in tables]) for name in names}


def columns_of(rows: Rows, names: Sequence[str]) -> dict[str, list[Any]]:
    """Return the columns of a table that is given row by row."""
    return {name: [row[name] for row in rows] for name in names}


def data_frame(columns: Columns, whole: Sequence[str] = ()) -> pd.DataFrame:
    """Return a table as a data frame; `whole` are columns of whole numbers that may be missing (None)."""
    import pandas as pd

    return pd.DataFrame(dict(columns)).astype({name: "Int64" for name in whole if name in columns})


class Series(NamedTuple):
    """A quantity of a method over time."""

    method: str
    quantity: str
    values: Array
    """(samples, ...) with axis 0 = k."""
    n: int = 0
    """Number of runs that it is computed from; 0 means exact."""
    point: Mapping[str, str] = {}
    """In the table of a whole sweep: path -> value; empty where the quantity does not depend on the path."""

    def components(self) -> dict[str, Array]:
        """Return component, a text such as "0,1", "2" or "" for scalars -> its values over k."""
        return {",".join(map(str, index)): self.values[:, *index] for index in np.ndindex(*self.values.shape[1:])}

    def columns(self) -> dict[str, Any]:
        """Return a row per component and k."""
        components, k = [*self.components()], np.arange(len(self.values))
        long = {
            "component": np.repeat(np.array(components, dtype=object), len(k)),
            "k": np.tile(k, len(components)),
            "n": np.full(self.values.size, self.n),
            "value": self.values.reshape(len(k), len(components)).T.ravel(),
        }
        return with_point(long, {**self.point, "method": self.method, "quantity": self.quantity})


def series_columns(series: Sequence[Series], paths: Sequence[str] = ()) -> dict[str, Any]:
    """Return series as one table, the columns of a sweep first."""
    none = Series("", "", np.empty(0), point=dict.fromkeys(paths, ""))
    return stacked([each.columns() for each in series or (none,)])
