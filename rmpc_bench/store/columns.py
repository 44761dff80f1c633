"""Columns of the trial store: statuses, metrics and sampled values, one number per run.

A column is stored in chunks of a fixed range of runs, as packed numbers.  A block changes only the chunks in which its
runs lie; whatever the blocks were, the stored bytes are the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Shaped

from rmpc_bench.received.store import decoded
from rmpc_bench.store.file import StoreFile
from rmpc_bench.types import Array

SIZE = 1000
"""Number of runs of a chunk."""
MOST_RANGES = 5
"""Ranges of runs that are named."""
Kind = Literal["status", "metric", "uncertainty"]
_TYPES: dict[str, np.dtype[Any]] = {"status": np.dtype("i1"), "metric": np.dtype("<f8"), "uncertainty": np.dtype("<f8")}
_NONE: dict[str, float] = {"status": 0, "metric": np.nan, "uncertainty": np.nan}
Sampled = Sequence[Mapping[str, float]] | Mapping[str, Array]
"""Values of some runs: name -> value for every run, or name -> (runs,) values, NaN where there is none."""


class Column(NamedTuple):
    """What identifies a column."""

    kind: Kind
    owner: str  # key of the method, or of what is drawn
    name: str = ""  # key of the metric, or name of the quantity


class Columns:
    """The columns of a store."""

    def __init__(self, file: StoreFile) -> None:
        self.file = file

    def put(self, column: Column, runs: Int[Array, " runs"], values: Shaped[Array, " runs"]) -> None:
        """Set values, while the file is `writing`."""
        number, groups, rows = self._number(column), runs // SIZE, []
        for group in np.unique(groups).tolist():
            stored = np.zeros(SIZE, dtype=bool)
            data = np.full(SIZE, _NONE[column.kind], dtype=_TYPES[column.kind])
            query = "SELECT stored, data FROM chunks WHERE column = ? AND number = ?"
            for mask, packed in self.file.read(query, (number, group)):
                with decoded(self.file.directory):
                    before, there = _unpacked(mask, packed, column.kind)
                    stored[: len(before)], data[: len(there)] = before, there
            inside = groups == group
            at = runs[inside] - group * SIZE
            stored[at], data[at] = True, values[inside]
            rows.append((number, group, *_packed(stored, data)))
        self.file.insert("chunks", rows, "INSERT OR REPLACE")

    def read(self, column: Column, n_runs: int) -> tuple[Int[Array, " stored"], Shaped[Array, " stored"]]:
        """Return the stored runs below a number, in their order, and their values."""
        query = "SELECT number AS chunk, stored, data FROM chunks WHERE column = ? AND number <= ? ORDER BY number"
        runs, parts = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=_TYPES[column.kind])]
        rows = self.file.read(query, (self._find(column), (n_runs - 1) // SIZE))
        with decoded(self.file.directory):
            for group, mask, packed in rows:
                stored, data = _unpacked(mask, packed, column.kind)
                at = np.flatnonzero(stored)
                runs.append(at + group * SIZE)
                parts.append(data[at])
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
        rows = self.file.read(query, (self._find(column), (n_runs - 1) // SIZE))
        with decoded(self.file.directory):
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
        rows = self.file.read(query, (self._find(column),))
        return sum(group * SIZE + min(length // _TYPES[column.kind].itemsize, SIZE) for group, length in rows)

    def sampled(self, draw: str, n_runs: int) -> tuple[Int[Array, " runs"], dict[str, Array]]:
        """Return the runs that have a value, ascending, and name -> (runs,) values, NaN where there is none."""
        query = """SELECT keys.key FROM columns JOIN keys ON keys.number = columns.name
            WHERE kind = 'uncertainty' AND owner = ? ORDER BY keys.key"""
        names = [name for (name,) in self.file.read(query, (self.file.find_number(draw),))]
        found = {name: self.read(Column("uncertainty", draw, name), n_runs) for name in names}
        stop = max((int(stored[-1]) + 1 for stored, _ in found.values() if len(stored)), default=0)
        there, whole = np.zeros(stop, dtype=bool), dict[str, Array]()
        for name, (stored, values) in found.items():
            whole[name] = np.full(stop, np.nan)
            whole[name][stored] = values
            there |= ~np.isnan(whole[name])
        return np.flatnonzero(there), {name: values[there] for name, values in whole.items()}

    def _find(self, column: Column) -> int:
        """Return the number of a column; 0 if it has none."""
        if column not in self.file.numbers:
            find = self.file.find_number
            query = "SELECT number FROM columns WHERE kind = ? AND owner = ? AND name = ?"
            rows = self.file.read(query, (column.kind, find(column.owner), find(column.name)))
            if not rows:
                return 0
            self.file.numbers[column] = rows[0][0]
        return self.file.numbers[column]

    def _number(self, column: Column) -> int:
        if not self._find(column):
            row = (column.kind, self.file.number(column.owner), self.file.number(column.name))
            self.file.write("INSERT INTO columns (kind, owner, name) VALUES (?, ?, ?)", [row])
        return self._find(column)


def _packed(stored: Bool[Array, " runs"], data: Shaped[Array, " runs"]) -> tuple[bytes | None, bytes]:
    """Return which runs are stored, None for all, and the numbers up to the last of them."""
    n = int(np.flatnonzero(stored)[-1]) + 1
    return None if stored[:n].all() else np.packbits(stored[:n]).tobytes(), data[:n].tobytes()


def _unpacked(mask: bytes | None, data: bytes, kind: Kind) -> tuple[Bool[Array, " runs"], Shaped[Array, " runs"]]:
    n, rest = divmod(len(data), _TYPES[kind].itemsize)
    if rest or n > SIZE:
        raise ValueError("a chunk has a wrong length")
    return _mask(mask, n), np.frombuffer(data, dtype=_TYPES[kind])


def _mask(mask: bytes | None, n: int) -> Bool[Array, " n"]:
    if mask is None:
        return np.ones(n, dtype=bool)
    return np.unpackbits(np.frombuffer(mask, dtype=np.uint8), count=n).astype(bool)


def by_name(sampled: Sampled) -> dict[str, Array]:
    """Return name -> (runs,) values, NaN where a run has none.

    Examples
    --------
    >>> by_name([{"a": 1.0}, {"a": 2.0, "b": 3.0}])
    {'a': array([1., 2.]), 'b': array([nan,  3.])}
    """
    if isinstance(sampled, Mapping):
        return {name: np.array(values, dtype=float) for name, values in sampled.items()}
    names = dict.fromkeys(name for row in sampled for name in row)
    return {name: np.array([row.get(name, np.nan) for row in sampled]) for name in names}


def covered(n_runs: int, spans: Iterable[tuple[int, int]]) -> Bool[Array, " n_runs"]:
    """Return which runs lie in one of some ranges.

    Examples
    --------
    >>> covered(5, [(0, 2), (4, 9)])
    array([ True,  True, False, False,  True])
    """
    found = np.zeros(n_runs, dtype=bool)
    for first, stop in spans:
        found[first:stop] = True
    return found


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


def said_runs(runs: Sequence[int] | Int[Array, " runs"]) -> str:
    """Return sorted runs as ranges, such as ``0 to 28, 57``; of many ranges the first ones.

    Examples
    --------
    >>> said_runs([0, 1, 2, 5, 7, 8])
    '0 to 2, 5, 7, 8'
    """
    texts: list[str] = []
    for first, stop in ranges(runs):
        texts += [f"{first} to {stop - 1}"] if stop - first > 2 else map(str, range(first, stop))
    more = f" and {len(texts) - MOST_RANGES} more ranges" if len(texts) > MOST_RANGES else ""
    return ", ".join(texts[:MOST_RANGES]) + more
