"""Tables with rows per run or per block: moments, failures, held and failed steps, warnings, durations."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np
from jaxtyping import Int

from rmpc_bench.received.plain_files import STORED, checked
from rmpc_bench.simulation.ensemble import SIZE, Group, gathered, start_of_group
from rmpc_bench.store.columns import ranges
from rmpc_bench.store.file import StoreFile
from rmpc_bench.types import STATUS_WORDS, Array, Journal, RunFailure
from rmpc_bench.types.texts import visible

WIDTH = 0.01
"""Relative width of a bin of durations, hence the relative error of a quantile."""
_SMALLEST = 1e-9
"""Shortest duration with a bin of its own [s], below the resolution of the clock."""


@dataclass
class Durations:
    """Histogram of the durations of calls, which are too many to store, with bins of equal relative width.

    Examples
    --------
    >>> durations = Durations.of([0.001, 0.002, 0.002, 0.002, 0.1])
    >>> durations.n, durations.largest, round(durations.quantile(0.5), 4)
    (5, 0.1, 0.002)
    """

    counts: Counter[int] = field(default_factory=Counter)  # number of a bin -> how many durations lie in it
    largest: float = 0.0  # the longest duration [s]; 0 of none

    @classmethod
    def of(cls, seconds: Iterable[float]) -> Durations:
        """Count durations [s]."""
        values = np.fromiter(seconds, dtype=float)
        bins = np.floor(np.log(np.maximum(values, _SMALLEST)) / math.log1p(WIDTH)).astype(int)
        numbers, counts = np.unique(bins, return_counts=True)
        return cls(Counter(dict(zip(numbers.tolist(), counts.tolist(), strict=True))), float(values.max(initial=0.0)))

    @property
    def n(self) -> int:
        """How many durations there are."""
        return self.counts.total()

    def add(self, other: Durations) -> None:
        """Add the durations of another histogram."""
        self.counts.update(other.counts)
        self.largest = max(self.largest, other.largest)

    def quantile(self, share: float) -> float:
        """Return the duration that a share of all does not exceed [s]; NaN of none."""
        if not self.counts:
            return math.nan
        rank, below = max(1, math.ceil(share * self.n)), 0
        for number, count in sorted(self.counts.items()):
            below += count
            if below >= rank:
                # The middle of the bin, which may lie beyond the longest duration in it.
                return min(math.exp((number + 0.5) * math.log1p(WIDTH)), self.largest)
        return self.largest


def write_journal(file: StoreFile, method: int, runs: Int[Array, " runs"], journal: Journal) -> None:
    """Write the journal of a block in place of what an earlier one has stored.

    Warnings and durations belong to a block.  Those of an earlier block that shares a run with it are deleted, so that
    no call counts twice.
    """
    spans = [(method, *bounds) for bounds in ranges(runs)]
    first, stop = int(runs[0]), int(runs[-1]) + 1
    for table in ("failures", "held", "failed_steps"):
        file.write(f"DELETE FROM {table} WHERE method = ? AND run >= ? AND run < ?", spans)
    for table in ("warnings", "durations"):
        file.write(f"DELETE FROM {table} WHERE method = ? AND first < ? AND stop > ?", [(method, stop, first)])
    failures = [(method, run, json.dumps(failure._asdict(), default=str)) for run, failure in journal.failures.items()]
    file.insert("failures", failures)
    file.insert("held", [(method, run, n) for run, n in journal.held.items() if n])
    file.insert("failed_steps", [(method, *step, n) for step, n in journal.failed_steps.items()])
    file.insert("warnings", [(method, first, stop, text, n) for text, n in journal.warnings.items()])
    durations = {phase: Durations.of(seconds) for phase, seconds in journal.seconds.items() if seconds}
    rows = [(phase, part.largest, json.dumps(sorted(part.counts.items()))) for phase, part in durations.items()]
    file.insert("durations", [(method, first, stop, *row) for row in rows])


def read_failures(file: StoreFile, method: int, n_runs: int) -> list[RunFailure]:
    """Return the stored failures of a method, in the order of the runs; controls in what code has said are escapes."""
    rows = file.read("SELECT failure FROM failures WHERE method = ? AND run < ? ORDER BY run", (method, n_runs))
    found = [checked(text.encode(), STORED["failures.failure"], any_text=True) for (text,) in rows]
    return [RunFailure(**{name: _shown(each[name]) for name in RunFailure._fields if name in each}) for each in found]


def _shown(value: Any) -> Any:
    return visible(value) if isinstance(value, str) else value


def read_failed_steps(file: StoreFile, method: int, n_runs: int) -> dict[int, dict[str, int]]:
    """Return run -> word of a status -> number of steps that failed so, of the runs that have some."""
    found: dict[int, dict[str, int]] = {}
    query = "SELECT run, status, n FROM failed_steps WHERE method = ? AND run < ? ORDER BY run, status"
    for run, status, n in file.read(query, (method, n_runs)) if file.has_table("failed_steps") else ():
        found.setdefault(run, {})[STATUS_WORDS[status]] = n
    return found


def read_durations(file: StoreFile, method: int, n_runs: int) -> dict[str, Durations]:
    """Return the stored durations of a method by component and phase."""
    found: dict[str, Durations] = {}
    query = "SELECT phase, largest, counts FROM durations WHERE method = ? AND first < ? ORDER BY phase, first"
    for phase, largest, counts in file.read(query, (method, n_runs)):
        found.setdefault(phase, Durations()).add(
            Durations(Counter(dict(checked(counts.encode(), STORED["durations.counts"]))), largest)
        )
    return found


def read_groups(file: StoreFile, method: int, n_runs: int) -> list[Group]:
    """Return groups of runs of a method and single runs of groups that are not whole, in their order."""
    query = "SELECT * FROM ensemble_groups WHERE method = ? AND stop <= ? ORDER BY first"
    parts = _groups(file.read(query, (method, n_runs)))
    whole = {part.first for part in parts if not part.is_single}
    return [part for part in parts if not part.is_single or start_of_group(part.first) not in whole]


def write_groups(file: StoreFile, method: int, parts: Sequence[Group]) -> None:
    """Write groups of runs, and reduce those of which all runs are there now."""
    groups = _with_stored_runs(file, method, parts)
    # Single runs of a group are needed until it is whole.
    whole = [(method, group.first, group.stop) for group in groups if not group.is_single]
    file.write("DELETE FROM ensemble_groups WHERE method = ? AND first >= ? AND stop <= ?", whole)
    rows = [(method, *group[:3], group.mean.shape[1], *map(as_bytes, group[3:])) for group in groups]
    file.insert("ensemble_groups", rows, "INSERT OR REPLACE")


def _with_stored_runs(file: StoreFile, method: int, parts: Sequence[Group]) -> list[Group]:
    """Reduce the groups of which all runs are there now: those of a block with those that are stored."""
    found = [part for part in parts if not part.is_single]
    singles = (part for part in parts if part.is_single)
    where = "FROM ensemble_groups WHERE method = ? AND first >= ? AND stop <= ? AND stop = first + 1"
    for start, members in groupby(singles, key=lambda single: start_of_group(single.first)):
        new, span = {single.first: single for single in members}, (method, start, start + SIZE)
        stored = {first for (first,) in file.read(f"SELECT first {where}", span)}
        if len(stored | new.keys()) == SIZE:
            before = {single.first: single for single in _groups(file.read(f"SELECT * {where}", span))}
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
