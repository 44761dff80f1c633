"""Copies of stored rows from one trial store to another, for shards.

Rows that the target has stay as they are.  Where both have a run with different statuses, as after a time limit, all
rows of the run stay those of the target.  The moments of a whole group that has such a run are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Int

from rmpc_bench.simulation.ensemble import Group
from rmpc_bench.store.columns import Column, Columns, covered
from rmpc_bench.store.file import StoreFile
from rmpc_bench.store.rows import read_groups, write_groups
from rmpc_bench.types import Array

_COLUMNS = """SELECT kind, owners.key, names.key FROM columns JOIN keys AS owners ON owners.number = owner
    JOIN keys AS names ON names.number = name ORDER BY columns.number"""
_ALL_RUNS = 2**60
Runs = Int[Array, " runs"]


def copy_rows(source: Columns, target: Columns) -> None:
    """Copy all rows that the target lacks, while its file is `writing`."""
    there, here = source.file, target.file
    copied = _copy_columns(source, target)
    methods = there.read("SELECT key, definition, code FROM methods JOIN keys ON number = method")
    here.insert("methods", [(here.number(key), *rest) for key, *rest in methods], "INSERT OR IGNORE")
    for method, runs in copied.items():
        numbers = there.find_number(method), here.number(method)
        _copy_runs(there, here, numbers, runs)
        write_groups(here, numbers[1], _new_groups(there, here, numbers, runs))


def _copy_columns(source: Columns, target: Columns) -> dict[str, Runs]:
    """Return method -> its runs in the source that are new, or have the status that they have in the target."""
    copied: dict[str, Runs] = {}
    # The statuses of a method come before its metrics.
    columns = sorted((Column(*row) for row in source.file.read(_COLUMNS)), key=lambda column: column.kind != "status")
    for column in columns:
        runs, values = source.read(column, _ALL_RUNS)
        here = target.stored(column, int(runs.max(initial=-1)) + 1)[runs]
        if column.kind == "status":
            copied[column.owner] = runs[~here | (target.at(column, runs) == values)]
        elif column.kind == "metric":
            here |= ~np.isin(runs, copied.get(column.owner, runs[:0]), assume_unique=True)
        if not here.all():
            target.put(column, runs[~here], values[~here])
    return copied


def _copy_runs(source: StoreFile, target: StoreFile, numbers: tuple[int, int], runs: Runs) -> None:
    """Copy what has a row per run or per block."""
    there, here = numbers
    allowed = np.zeros(int(runs.max(initial=-1)) + 1, dtype=bool)
    allowed[runs] = True

    def of_method(table: str, run: int) -> Iterator[tuple[Any, ...]]:
        for row in source.read(f"SELECT * FROM {table} WHERE method = ?", (there,)):
            if row[run] < len(allowed) and allowed[row[run]]:
                yield (here, *row[1:])

    names = dict(source.read("SELECT number, key FROM keys"))
    traces = [(method, target.number(names[signal]), *rest) for method, signal, *rest in of_method("traces", 2)]
    target.insert("traces", traces, "INSERT OR IGNORE")
    for table in ("failures", "held", "failed_steps"):
        if source.has_table(table):
            target.insert(table, [*of_method(table, 1)], "INSERT OR IGNORE")
    for table in ("warnings", "durations"):
        spans = target.read(f"SELECT DISTINCT first, stop FROM {table} WHERE method = ?", (here,))
        rows = source.read(f"SELECT * FROM {table} WHERE method = ?", (there,))
        # A block that shares runs with one of the target would count its calls twice.
        new = [(here, *row[1:]) for row in rows if not any(first < row[2] and row[1] < stop for first, stop in spans)]
        target.insert(table, new, "INSERT OR IGNORE")


def _new_groups(source: StoreFile, target: StoreFile, numbers: tuple[int, int], runs: Runs) -> list[Group]:
    """Return the moments of which the target lacks some of the runs, if all their runs are to be copied."""
    there, here = numbers
    found = read_groups(source, there, _ALL_RUNS)
    stop = max((group.stop for group in found), default=0)
    known = covered(stop, ((group.first, group.stop) for group in read_groups(target, here, stop)))
    allowed = np.zeros(max(stop, int(runs.max(initial=-1)) + 1), dtype=bool)
    allowed[runs] = True
    spans = [slice(group.first, group.stop) for group in found]
    # The target may have single runs of a group that is whole in the source.
    return [group for group, span in zip(found, spans, strict=True) if not known[span].all() and allowed[span].all()]
