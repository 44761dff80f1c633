"""Columns of the trial store: statuses, metrics and sampled values, one number per run.

A column is stored in chunks of a fixed range of runs, as packed numbers.  A block changes only the chunks in which its
runs lie; whatever the blocks were, the stored bytes are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Shaped

from rmpc_bench.execution.database import Database
from rmpc_bench.execution.timed_writes import TimedWrites
from rmpc_bench.received.store import decoded
from rmpc_bench.types import Array

SIZE = 1000
"""Number of runs of a chunk."""
Kind = Literal["status", "metric", "uncertainty"]
_TYPES: dict[str, np.dtype[Any]] = {"status": np.dtype("i1"), "metric": np.dtype("<f8"), "uncertainty": np.dtype("<f8")}
_NONE: dict[str, float] = {"status": 0, "metric": np.nan, "uncertainty": np.nan}


class Column(NamedTuple):
    """What identifies a column."""

    kind: Kind
    owner: str
    """Key of the method, or of what is drawn."""
    name: str = ""
    """Key of the metric, or name of the quantity."""


class _Chunk(NamedTuple):
    stored: Bool[Array, " runs"]
    data: Shaped[Array, " runs"]


class Columns:
    """The columns of a store."""

    def __init__(self, database: Database, writes: TimedWrites) -> None:
        self._database, self._reading = database, writes.reading
        writes.at_end(self._save, self._forget)
        self._numbers: dict[Column, int] = {}
        self._changed: dict[tuple[int, int], _Chunk] = {}

    def put(self, column: Column, runs: Int[Array, " runs"], values: Shaped[Array, " runs"]) -> None:
        """Set values inside a transaction, at the end of which they are written."""
        number, groups = self._number(column), runs // SIZE
        for group in np.unique(groups).tolist():
            rows = groups == group
            chunk, at = self._chunk(number, group, column.kind), runs[rows] - group * SIZE
            chunk.stored[at] = True
            chunk.data[at] = values[rows]

    def read(self, column: Column, n_runs: int) -> tuple[Int[Array, " stored"], Shaped[Array, " stored"]]:
        """Return the stored runs below a number, in their order, and their values."""
        query = "SELECT number AS chunk, stored, data FROM chunks WHERE column = ? AND number <= ? ORDER BY number"
        runs, parts = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=_TYPES[column.kind])]
        with self._reading():
            rows = self._database.read(query, (self._find(column), (n_runs - 1) // SIZE))
        with decoded(self._database.directory):
            for group, mask, data in rows:
                chunk = _unpacked(mask, data, column.kind)
                at = np.flatnonzero(chunk.stored)
                runs.append(at + group * SIZE)
                parts.append(chunk.data[at])
        found, values = np.concatenate(runs), np.concatenate(parts)
        n = int(np.searchsorted(found, n_runs))
        return found[:n], values[:n]

    def at(self, column: Column, runs: Int[Array, " runs"]) -> Shaped[Array, " runs"]:
        """Return the values of given runs, such as NaN where a metric has none."""
        found, values = self.read(column, int(runs.max(initial=-1)) + 1)
        if np.array_equal(found, runs):
            return values
        wanted = np.full(len(runs), _NONE[column.kind], dtype=_TYPES[column.kind])
        at = np.searchsorted(found, runs)
        there = np.flatnonzero(at < len(found))
        there = there[found[at[there]] == runs[there]]
        wanted[there] = values[at[there]]
        return wanted

    def stored(self, column: Column, n_runs: int) -> Bool[Array, " n_runs"]:
        """Return which of the first runs have a value."""
        query = "SELECT number AS chunk, stored, length(data) AS length FROM chunks WHERE column = ? AND number <= ?"
        found = np.zeros(n_runs, dtype=bool)
        with self._reading():
            rows = self._database.read(query, (self._find(column), (n_runs - 1) // SIZE))
        with decoded(self._database.directory):
            for group, mask, length in rows:
                there = _mask(mask, min(length // _TYPES[column.kind].itemsize, SIZE))
                part = found[group * SIZE : group * SIZE + len(there)]
                part[:] = there[: len(part)]
        return found

    def stop(self, column: Column) -> int:
        """Return the number after the last run that has a value; 0 if none has one."""
        query = (
            "SELECT number AS chunk, length(data) AS length FROM chunks WHERE column = ? ORDER BY number DESC LIMIT 1"
        )
        with self._reading():
            rows = self._database.read(query, (self._find(column),))
        return sum(group * SIZE + min(length // _TYPES[column.kind].itemsize, SIZE) for group, length in rows)

    def names(self, kind: Kind, owner: str) -> list[str]:
        """Return the names of the columns of a kind that belong to a key, sorted."""
        query = """SELECT keys.key FROM columns JOIN keys ON keys.number = columns.name
            WHERE kind = ? AND owner = ? ORDER BY keys.key"""
        with self._reading():
            return [name for (name,) in self._database.read(query, (kind, self._database.find_number(owner)))]

    def _save(self) -> None:
        """Write the chunks that were changed in a transaction."""
        rows = [(*at, *_packed(chunk)) for at, chunk in self._changed.items()]
        self._database.write([("INSERT OR REPLACE INTO chunks VALUES (?, ?, ?, ?)", rows)])
        self._changed.clear()

    def _forget(self) -> None:
        """Forget what was set in a transaction that is rolled back."""
        self._numbers.clear()
        self._changed.clear()

    def _find(self, column: Column) -> int:
        """Return the number of a column; 0 if it has none."""
        if column not in self._numbers:
            find = self._database.find_number
            query = "SELECT number FROM columns WHERE kind = ? AND owner = ? AND name = ?"
            rows = self._database.read(query, (column.kind, find(column.owner), find(column.name)))
            if not rows:
                return 0
            self._numbers[column] = rows[0][0]
        return self._numbers[column]

    def _number(self, column: Column) -> int:
        if not self._find(column):
            row = (column.kind, self._database.number(column.owner), self._database.number(column.name))
            self._database.write([("INSERT INTO columns (kind, owner, name) VALUES (?, ?, ?)", [row])])
        return self._find(column)

    def _chunk(self, number: int, group: int, kind: Kind) -> _Chunk:
        """Return a chunk at its full length, to be changed."""
        if (number, group) not in self._changed:
            full = _Chunk(np.zeros(SIZE, dtype=bool), np.full(SIZE, _NONE[kind], dtype=_TYPES[kind]))
            query = "SELECT stored, data FROM chunks WHERE column = ? AND number = ?"
            for mask, data in self._database.read(query, (number, group)):
                chunk = _unpacked(mask, data, kind)
                full.stored[: len(chunk.stored)], full.data[: len(chunk.data)] = chunk
            self._changed[number, group] = full
        return self._changed[number, group]


def _packed(chunk: _Chunk) -> tuple[bytes | None, bytes]:
    """Return which runs are stored, None for all, and the numbers up to the last of them."""
    n = int(np.flatnonzero(chunk.stored)[-1]) + 1
    stored, data = chunk.stored[:n], chunk.data[:n]
    return None if stored.all() else np.packbits(stored).tobytes(), data.tobytes()


def _unpacked(mask: bytes | None, data: bytes, kind: Kind) -> _Chunk:
    n, rest = divmod(len(data), _TYPES[kind].itemsize)
    if rest or n > SIZE:
        raise ValueError("a chunk has a wrong length")
    return _Chunk(_mask(mask, n), np.frombuffer(data, dtype=_TYPES[kind]))


def _mask(mask: bytes | None, n: int) -> Bool[Array, " n"]:
    if mask is None:
        return np.ones(n, dtype=bool)
    return np.unpackbits(np.frombuffer(mask, dtype=np.uint8), count=n).astype(bool)


def ranges(runs: Sequence[int] | Int[Array, " runs"]) -> list[tuple[int, int]]:
    """Return consecutive runs, given in ascending order, as (first, stop).

    Examples
    --------
    >>> ranges([0, 1, 2, 5, 7, 8])
    [(0, 3), (5, 6), (7, 9)]
    """
    indices: Any = np.asarray(runs, dtype=np.int64)
    if not len(indices):
        return []
    breaks = np.flatnonzero(np.diff(indices) != 1) + 1
    firsts = indices[np.concatenate([[0], breaks])]
    lasts = indices[np.concatenate([breaks - 1, [len(indices) - 1]])]
    return list(zip(firsts.tolist(), (lasts + 1).tolist(), strict=True))
