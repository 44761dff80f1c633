"""Table of the trial store for the moments over groups of runs, and the bytes of arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from rmpc_bench.simulation.ensemble import SIZE, Group, gathered, start_of_group
from rmpc_bench.types import Array

Read = Callable[[str, tuple[Any, ...]], list[Any]]


def read_groups(read: Read, method: int, n_runs: int) -> list[Group]:
    """Return groups of runs of a method and single runs of groups that are not whole, in their order."""
    query = "SELECT * FROM ensemble_groups WHERE method = ? AND stop <= ? ORDER BY first"
    parts = _groups(read(query, (method, n_runs)))
    whole = {part.first for part in parts if not part.is_single}
    return [part for part in parts if not part.is_single or start_of_group(part.first) not in whole]


def with_stored_runs(read: Read, method: int, parts: Sequence[Group]) -> list[Group]:
    """Reduce the groups of which all runs are there now: those of a block with those that are stored."""
    found = [part for part in parts if not part.is_single]
    singles = (part for part in parts if part.is_single)
    where = "FROM ensemble_groups WHERE method = ? AND first >= ? AND stop <= ? AND stop = first + 1"
    for start, members in groupby(singles, key=lambda single: start_of_group(single.first)):
        new, span = {single.first: single for single in members}, (method, start, start + SIZE)
        stored = {first for (first,) in read(f"SELECT first {where}", span)}
        if len(stored | new.keys()) == SIZE:
            before = {single.first: single for single in _groups(read(f"SELECT * {where}", span))}
            found.append(gathered([single for _, single in sorted((before | new).items())]))
        else:
            found += new.values()
    return found


def _groups(rows: Sequence[Sequence[Any]]) -> list[Group]:
    return [
        Group(first, stop, n, as_array(mean).reshape(-1, width), as_array(second).reshape(-1, width, width))
        for _, first, stop, n, width, mean, second in rows
    ]


def as_bytes(array: Array) -> bytes:
    """Return the entries of an array as they are stored."""
    return np.ascontiguousarray(array, dtype="<f8").tobytes()


def as_array(data: bytes) -> Array:
    """Return stored entries as an array with one axis."""
    return np.frombuffer(data, dtype="<f8")
