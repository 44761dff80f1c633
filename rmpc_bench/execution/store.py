"""The trial store of an experiment; finished blocks are committed every half a second.

Trials are stored under the hash of the definition of their method and of the code that computed them, and metrics under
the hash of their definition.  After a change of a definition or of the code the old numbers are therefore not used.
"""

from __future__ import annotations

import json
import sys
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Int, Int8

from rmpc_bench.execution.chunks import Column, Columns
from rmpc_bench.execution.database import FILE, Database, Statement, StoreError, WriteError
from rmpc_bench.execution.differences import Names, differences
from rmpc_bench.execution.durations import Durations
from rmpc_bench.execution.ensemble_table import as_array, as_bytes, read_groups, with_stored_runs
from rmpc_bench.execution.journal_tables import journal_rows, read_durations, read_failed_steps, read_failures
from rmpc_bench.execution.sampled_values import Sampled, by_name, read_sampled
from rmpc_bench.execution.store_copy import Opened, copy_rows
from rmpc_bench.execution.stored_method import StoredMethod
from rmpc_bench.execution.stored_runs import covered, rows_of_others, runs_with, without_traces
from rmpc_bench.execution.timed_writes import TimedWrites
from rmpc_bench.received.plain_files import STORED, checked
from rmpc_bench.received.store import array_of, damaged, decoded
from rmpc_bench.simulation.closed_loop import Block
from rmpc_bench.simulation.ensemble import Group
from rmpc_bench.simulation.scenario import Recording
from rmpc_bench.types import Array, RunFailure, Status
from rmpc_bench.types.texts import visible

_NOTHING = Recording()
MOST_SETTINGS = 5
"""Differing settings that are named where a directory is refused."""
WORDS = np.array([status.word for status in sorted(Status)], dtype=object)
"""Word of every status, at its number."""


class Store:
    """An open trials.sqlite; use it as a context manager.

    Parameters
    ----------
    directory : directory of the experiment, made if it is not there
    writable : whether to take the lock and create what is missing

    Raises
    ------
    StoreError
        If another process writes to the file, or it is not a store.
    WriteError
        If the directory or the file cannot be made.
    """

    def __init__(self, directory: Path, *, writable: bool = True) -> None:
        self.directory = directory
        self._database = Database(directory, writable=writable)
        self._writes = TimedWrites(self._database)
        self._columns = Columns(self._database, self._writes)
        self._unpacked: dict[str, int] = {}

    def __enter__(self) -> Store:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Commit what waits, close the file and release the lock."""
        try:
            self._writes.flush()
        except WriteError:
            # An earlier write has failed for the same reason, such as a full disk.
            if not isinstance(value, WriteError):
                raise
        finally:
            with self._writes.lock:
                self._database.close()

    def flush(self) -> None:
        """Commit all blocks now."""
        self._writes.flush()

    def _read(self, query: str, parameters: tuple[Any, ...]) -> list[Any]:
        with self._writes.reading():
            return self._database.read(query, parameters)

    def _write(self, statements: Sequence[Statement]) -> None:
        self._writes.now(lambda: self._database.write(statements))

    def meta(self, key: str) -> str | None:
        """Read a value that was set with `set_meta`."""
        rows = self._read("SELECT value FROM meta WHERE key = ?", (key,))
        return str(rows[0][0]) if rows else None

    def data(self, key: str) -> dict[str, Any]:
        """Read plain data that was set with `set_meta`; empty where there are none."""
        found: dict[str, Any] = self._checked(key, self.meta(key) or "{}")
        return found

    def _checked(self, what: str, text: str) -> Any:
        """Return the value of a JSON text of the store."""
        try:
            return checked(text.encode(), STORED[what])
        except ValueError as error:
            raise damaged(self.directory, f"{what}: {error}") from None

    def set_meta(self, key: str, value: str) -> None:
        """Set a value."""
        self._write([("INSERT OR REPLACE INTO meta VALUES (?, ?)", [(key, value)])])

    def set_layout(self, key: str, text: str, arrays: Mapping[str, Array]) -> None:
        """Set a value and the arrays that it names in place of all arrays; nothing is written if it has not changed."""
        if self.meta(key) == text:
            return
        rows = [(name, json.dumps(array.shape), zlib.compress(as_bytes(array))) for name, array in arrays.items()]
        self._write(
            [
                ("DELETE FROM arrays", [()]),
                ("INSERT INTO arrays VALUES (?, ?, ?)", rows),
                ("INSERT OR REPLACE INTO meta VALUES (?, ?)", [(key, text)]),
            ]
        )

    def array(self, name: str) -> Array:
        """Read an array that was set with `set_layout`."""
        rows = self._read("SELECT shape, data FROM arrays WHERE name = ?", (name,))
        with decoded(self.directory):
            [(shape, data)] = rows
            # Numbers that hardly change take little room, so that much more than the size of the file may be honest.
            most = 25_000_000 + 3 * (self.directory / FILE).stat().st_size - sum(self._unpacked.values())
            array = array_of(shape, data, most + self._unpacked.get(name, 0))
            self._unpacked[name] = array.size
            return array

    def has_trials(self, method: str) -> bool:
        """Whether a run of a method is stored."""
        return self._columns.stop(Column("status", method)) > 0

    def _number(self, key: str) -> int:
        """Return the number of a key; 0 if it has none."""
        with self._writes.reading():
            return self._database.find_number(key)

    def file_names(self, also: Names | None = None) -> dict[str, Mapping[str, str]]:
        """Return hash of a source or a data file -> names of its files -> their hashes, for messages."""
        return {**self.data("files"), **(also or {})}

    def claim(self, experiment: str, shared: Mapping[str, Any], files: Names | None = None) -> None:
        """Assign the directory to an experiment, or check that it already belongs to it."""
        if self.meta("experiment") is None:
            self.set_meta("shared", json.dumps(shared))
            self.set_meta("experiment", experiment)
        self.check(experiment, shared, files)
        if (names := self.file_names(files)) != self.file_names():
            self.set_meta("files", json.dumps(names))

    def check(self, experiment: str, shared: Mapping[str, Any], files: Names | None = None) -> None:
        """Check that the directory belongs to an experiment; see `claim`."""
        if self.meta("experiment") != experiment:
            with decoded(self.directory):
                lines = differences(self.data("shared"), json.loads(json.dumps(shared)), self.file_names(files))
            left = [f"and {len(lines) - MOST_SETTINGS} more"] if len(lines) > MOST_SETTINGS else []
            text = "\n".join(f"  {line}" for line in [*lines[:MOST_SETTINGS], *left])
            raise StoreError(f"{self.directory} holds another experiment:\n{text}")

    def register(self, methods: Iterable[StoredMethod]) -> None:
        """Note definition and code of methods whose trials are about to be stored."""
        noted = list(methods)

        def write() -> None:
            rows = [(self._database.number(each.key), each.definition, json.dumps(each.code)) for each in noted]
            self._database.write([("INSERT OR IGNORE INTO methods VALUES (?, ?, ?)", rows)])

        self._writes.now(write)

    def of_other_code(
        self, method: StoredMethod, n_runs: int, current: Collection[str] = ()
    ) -> list[tuple[list[Any], int]]:
        """Count the runs that other code has computed and this code has not, by what identifies the others."""
        query = "SELECT key, code FROM methods JOIN keys ON number = method WHERE definition = ? ORDER BY method"
        rows = self._read(query, (method.definition,))
        others = {key: self._checked("methods.code", code) for key, code in rows if key not in current}
        return rows_of_others(self._columns, method.key, others, n_runs)

    def finished(
        self, method: str, metrics: Iterable[str], recording: Recording = _NOTHING, n_runs: int = sys.maxsize
    ) -> Int[Array, " finished"]:
        """Return the runs of a method that are stored with all given metrics and, where required, signals and moments.

        Of the moments those count that `ensemble` returns for ``n_runs``.
        """
        there = runs_with(self._columns, method, metrics, n_runs)
        if recording.n_runs and recording.signals:
            query = "SELECT run FROM traces WHERE method = ? AND signal = ? AND run < ?"
            found = [
                self._read(query, (self._number(method), self._number(each), n_runs)) for each in recording.signals
            ]
            there = without_traces(self._columns, method, there, recording.n_runs, found)
        if recording.ensemble:
            query = "SELECT first, stop FROM ensemble_groups WHERE method = ? AND stop <= ?"
            there &= covered(len(there), self._read(query, (self._number(method), n_runs)))
        return np.flatnonzero(there)

    def add_block(
        self,
        method: str,
        runs: Sequence[int],
        block: Block,
        metrics: Mapping[str, Array],
        draw: str,
        uncertainty: Sampled,
    ) -> None:
        """Store a finished block; it is committed within half a second."""
        indices = np.array(runs, dtype=np.int64)
        columns = {Column("status", method): np.array(block.status)}
        columns |= {Column("metric", method, metric): np.array(column) for metric, column in metrics.items()}
        columns |= {Column("uncertainty", draw, name): column for name, column in by_name(uncertainty).items()}
        for column, values in columns.items():
            if values.shape != indices.shape:
                raise ValueError(f"{column}: values of shape {values.shape} for {len(indices)} runs")
        traces = [
            (signal, run, trace.shape[1], as_bytes(trace))
            for signal, recorded in block.traces.items()
            for run, trace in zip(indices.tolist(), recorded, strict=False)  # the first ones of the block
        ]
        size = sum(values.nbytes for values in columns.values()) + sum(len(data) for *_, data in traces)
        self._writes.add(partial(self._write_block, method, indices, columns, traces, block), size)

    def _write_block(
        self,
        method: str,
        runs: Int[Array, " runs"],
        columns: Mapping[Column, Array],
        traces: Sequence[tuple[Any, ...]],
        block: Block,
    ) -> None:
        """Write a block inside a transaction."""
        for column, values in columns.items():
            self._columns.put(column, runs, values)
        number = self._database.number(method)
        groups = with_stored_runs(self._database.read, number, block.ensemble)
        reduced = [(number, group.first, group.stop) for group in groups if not group.is_single]
        rows = [(number, self._database.number(signal), *rest) for signal, *rest in traces]
        self._database.write(
            [
                # Single runs of a group are needed until it is whole.
                ("DELETE FROM ensemble_groups WHERE method = ? AND first >= ? AND stop <= ?", reduced),
                (
                    "INSERT OR REPLACE INTO ensemble_groups VALUES (?, ?, ?, ?, ?, ?, ?)",
                    [(number, *group[:3], group.mean.shape[1], *map(as_bytes, group[3:])) for group in groups],
                ),
                ("INSERT OR REPLACE INTO traces VALUES (?, ?, ?, ?, ?)", rows),
                *journal_rows(number, np.sort(runs), block.journal),
            ]
        )

    def copy_from(self, other: Store) -> None:
        """Copy the rows of another store of the experiment that this one lacks, in one transaction."""
        there, here = (Opened(each._database, each._columns, each._read) for each in (other, self))
        self._writes.now(copy_rows(there, here))

    def failures(self, method: str, n_runs: int) -> list[RunFailure]:
        """Failures of a method that have a description, in the order of the runs."""
        with decoded(self.directory):
            return read_failures(self._read, self._number(method), n_runs)

    def held(self, method: str, n_runs: int) -> dict[int, int]:
        """Run -> number of held steps, of the runs that have some."""
        query = "SELECT run, n FROM held WHERE method = ? AND run < ? ORDER BY run"
        return dict(self._read(query, (self._number(method), n_runs)))

    def failed_steps(self, method: str, n_runs: int) -> dict[int, dict[str, int]]:
        """Run -> word of a status -> number of steps whose optimisation failed so, of the runs that have some."""
        if not self._database.has_table("failed_steps"):
            return {}
        with decoded(self.directory):
            return read_failed_steps(self._read, self._number(method), n_runs)

    def warnings(self, method: str, n_runs: int) -> dict[str, int]:
        """Text of a warning of a component -> how often it was given, the most frequent one first."""
        counted = "SELECT text, sum(n) AS n FROM warnings WHERE method = ? AND first < ?"
        query = f"{counted} GROUP BY text ORDER BY 2 DESC, text"
        return {visible(text): n for text, n in self._read(query, (self._number(method), n_runs))}

    def durations(self, method: str, n_runs: int) -> dict[str, Durations]:
        """Component and phase -> durations of its calls."""
        with decoded(self.directory):
            return read_durations(self._read, self._number(method), n_runs)

    def statuses(self, method: str, n_runs: int) -> tuple[Int[Array, " stored"], Int8[Array, " stored"]]:
        """Run indices and numbers of the statuses of a method, in the order of the runs."""
        runs, status = self._columns.read(Column("status", method), n_runs)
        if len(status) and not 0 <= status.min() <= status.max() < len(WORDS):
            raise damaged(self.directory, "a status has no meaning")
        return runs, status

    def column(self, method: str, n_runs: int) -> tuple[list[int], list[str]]:
        """Run indices and status words of a method, in the order of the runs."""
        runs, status = self.statuses(method, n_runs)
        return runs.tolist(), WORDS[status].tolist()

    def values(self, method: str, metric: str, runs: Sequence[int] | Int[Array, " runs"]) -> Array:
        """Values of a metric for the given runs; NaN where there is none."""
        return self._columns.at(Column("metric", method, metric), np.asarray(runs, dtype=np.int64))

    def traces(self, method: str, signal: str, n_runs: int) -> tuple[list[int], Array]:
        """Recorded runs of a method and their trajectories, (recorded, samples, components)."""
        query = "SELECT run, width, data FROM traces WHERE method = ? AND signal = ? AND run < ? ORDER BY run"
        rows = self._read(query, (self._number(method), self._number(signal), n_runs))
        with decoded(self.directory):
            recorded = [as_array(data).reshape(-1, width) for _, width, data in rows]
            return [run for run, *_ in rows], np.array(recorded) if rows else np.zeros((0, 0, 0))

    def ensemble(self, method: str, n_runs: int) -> list[Group]:
        """Groups of runs of a method and single runs of groups that are not whole, in their order.

        A group that reaches beyond n_runs is left out.
        """
        with decoded(self.directory):
            return read_groups(self._read, self._number(method), n_runs)

    def uncertainty(self, draw: str, n_runs: int) -> tuple[Int[Array, " runs"], dict[str, Array]]:
        """Return the runs that have named uncertain quantities, and name -> (runs,) values, NaN where there is none."""
        return read_sampled(self._columns, draw, n_runs)
