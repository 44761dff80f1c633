"""Copies of stored rows from one trial store to another, for shards.

Rows that the target has stay as they are.  Where both have a run with different statuses, as after a time limit, all
rows of the run stay those of the target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from rmpc_bench.execution.chunks import Column, Columns
from rmpc_bench.execution.database import Database
from rmpc_bench.execution.ensemble_table import as_bytes, read_groups, with_stored_runs
from rmpc_bench.execution.stored_runs import covered
from rmpc_bench.types import Array

_BY_BLOCK = ("warnings", "durations")
_COLUMNS = """SELECT kind, owners.key, names.key FROM columns JOIN keys AS owners ON owners.number = owner
    JOIN keys AS names ON names.number = name ORDER BY columns.number"""
_ALL_RUNS = 2**60
Read = Callable[[str, tuple[Any, ...]], list[Any]]


class Opened(NamedTuple):
    """An open store."""

    database: Database
    columns: Columns
    read: Read
    """Finds the rows of a query when everything before it is written."""


class _Rows(NamedTuple):
    """Rows that the target lacks."""

    columns: list[tuple[Column, Int[Array, " runs"], Array]]
    copied: dict[str, Int[Array, " runs"]]
    """Method -> its runs in the source that are new, or have the status that they have in the target."""


def copy_rows(source: Opened, target: Opened) -> Callable[[], None]:
    """Return a function that copies all rows that the target lacks, inside a transaction of the target."""
    rows = _missing(source, target)
    methods = source.read("SELECT key, definition, code FROM methods JOIN keys ON number = method", ())
    groups = {method: _new_groups(source, target, method) for method in rows.copied}

    def write() -> None:
        number = target.database.number
        for column, runs, values in rows.columns:
            target.columns.put(column, runs, values)
        noted = [(number(key), definition, code) for key, definition, code in methods]
        _insert(target.database, "methods", noted)
        for method, runs in rows.copied.items():
            _copy_runs(source, target.database, method, runs)
            _write_groups(target.database, number(method), groups[method])

    return write


def _missing(source: Opened, target: Opened) -> _Rows:
    found = _Rows([], {})
    # The statuses of a method come before its metrics.
    columns = sorted((Column(*row) for row in source.read(_COLUMNS, ())), key=lambda column: column.kind != "status")
    for column in columns:
        runs, values = source.columns.read(column, _ALL_RUNS)
        n_runs = int(runs.max(initial=-1)) + 1
        here = target.columns.stored(column, n_runs)[runs]
        if column.kind == "status":
            alike = target.columns.at(column, runs) == values
            found.copied[column.owner] = runs[~here | alike]
        elif column.kind == "metric":
            here |= ~np.isin(runs, found.copied.get(column.owner, runs[:0]), assume_unique=True)
        if not here.all():
            found.columns.append((column, runs[~here], values[~here]))
    return found


def _copy_runs(source: Opened, target: Database, method: str, runs: Int[Array, " runs"]) -> None:
    """Copy what has a row per run or per block; it is written inside a transaction of the target."""
    there, here = source.database.find_number(method), target.number(method)
    allowed = np.zeros(int(runs.max(initial=-1)) + 1, dtype=bool)
    allowed[runs] = True

    def of_method(table: str, run: int) -> Iterator[tuple[Any, ...]]:
        for row in source.read(f"SELECT * FROM {table} WHERE method = ?", (there,)):
            if row[run] < len(allowed) and allowed[row[run]]:
                yield (here, *row[1:])

    names = dict(source.read("SELECT number, key FROM keys", ()))
    traces = [(method, target.number(names[signal]), *rest) for method, signal, *rest in of_method("traces", 2)]
    _insert(target, "traces", traces)
    for table in ("failures", "held", "failed_steps"):
        if not source.database.has_table(table):
            continue
        _insert(target, table, list(of_method(table, 1)))
    for table in _BY_BLOCK:
        spans = target.read(f"SELECT DISTINCT first, stop FROM {table} WHERE method = ?", (here,))
        rows = source.read(f"SELECT * FROM {table} WHERE method = ?", (there,))
        # A block that shares runs with one of the target would count its calls twice.
        new = [(here, *row[1:]) for row in rows if not any(first < row[2] and row[1] < stop for first, stop in spans)]
        _insert(target, table, new)


def _new_groups(source: Opened, target: Opened, method: str) -> list[Any]:
    """Return the moments of runs that the target lacks; groups of which both have runs are reduced."""
    there, here = source.database.find_number(method), target.database.find_number(method)
    found = read_groups(source.read, there, _ALL_RUNS)
    stop = max((group.stop for group in found), default=0)
    known = covered(stop, ((group.first, group.stop) for group in read_groups(target.read, here, stop)))
    new = [group for group in found if not known[group.first]]
    return with_stored_runs(target.read, here, new)


def _write_groups(target: Database, method: int, groups: Sequence[Any]) -> None:
    whole = [(method, group.first, group.stop) for group in groups if not group.is_single]
    target.write([("DELETE FROM ensemble_groups WHERE method = ? AND first >= ? AND stop <= ?", whole)])
    rows = [(method, *group[:3], group.mean.shape[1], *map(as_bytes, group[3:])) for group in groups]
    _insert(target, "ensemble_groups", rows)


def _insert(target: Database, table: str, rows: Sequence[tuple[Any, ...]]) -> None:
    if rows:
        target.write([(f"INSERT OR IGNORE INTO {table} VALUES ({', '.join('?' * len(rows[0]))})", rows)])
