"""The trial store of an experiment: blocks in, columns out, and which runs are there.

Trials are stored under the hash of the definition of their method and of the code that computed them, and metrics under
the hash of their definition.  After a change of a definition or of the code the old numbers are therefore not used.
"""

from __future__ import annotations

import json
import sys
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Int8

from rmpc_bench.received.plain_files import STORED, StoreError, checked
from rmpc_bench.received.store import FILE, WriteError, array_of, damaged, decoded
from rmpc_bench.simulation.closed_loop import Block
from rmpc_bench.simulation.ensemble import Group
from rmpc_bench.simulation.scenario import Recording
from rmpc_bench.store.columns import Column, Columns, Sampled, by_name, covered
from rmpc_bench.store.copying import copy_rows
from rmpc_bench.store.differences import Names, differences
from rmpc_bench.store.file import StoreFile
from rmpc_bench.store.rows import (
    Durations,
    as_array,
    as_bytes,
    read_durations,
    read_failed_steps,
    read_failures,
    read_groups,
    write_groups,
    write_journal,
)
from rmpc_bench.types import STATUS_WORDS, Array, RunFailure, Status
from rmpc_bench.types.texts import visible

_NOTHING = Recording()
_MAYBE_WITHOUT_TRACES = [int(Status.CRASHED), int(Status.TIMEOUT)]
"""Statuses of runs that may have no trajectories, because their block was not simulated to its end."""
MOST_SETTINGS = 5
"""Differing settings that are named where a directory is refused."""
WORDS = np.array(list(STATUS_WORDS.values()), dtype=object)
"""Word of every status, at its number."""


class StoredMethod(NamedTuple):
    """A method whose trials are stored under one key."""

    key: str  # hash of its definition and of the code
    definition: str  # hash of its definition
    code: Mapping[str, Any]  # what identifies the code that computes its trials
    name: str = ""  # its name, for messages


def each_once(methods: Iterable[StoredMethod]) -> list[StoredMethod]:
    """Return methods that share trials as one, with all their names."""
    found: dict[str, StoredMethod] = {}
    for method in methods:
        names = dict.fromkeys(
            [*found[method.key].name.split(", "), method.name] if method.key in found else [method.name]
        )
        found[method.key] = method._replace(name=", ".join(names))
    return list(found.values())


class Store:
    """An open trials.sqlite; use it as a context manager.

    `writable` takes the lock and makes what is missing.  A StoreError says that another process writes to the file or
    it is no store, a WriteError that the directory or the file cannot be made.
    """

    def __init__(self, directory: Path, *, writable: bool = True) -> None:
        self.directory = directory
        self.file = StoreFile(directory, writable=writable)
        self._columns = Columns(self.file)
        self._unpacked: dict[str, int] = {}

    def __enter__(self) -> Store:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Commit what waits, close the file and release the lock."""
        try:
            self.file.commit()
        except WriteError:
            # An earlier write has failed for the same reason, such as a full disk.
            if not isinstance(value, WriteError):
                raise
        finally:
            self.file.close()

    def flush(self) -> None:
        """Commit all blocks now."""
        self.file.commit()

    def meta(self, key: str) -> str | None:
        """Read a value that was set with `set_meta`."""
        rows = self.file.read("SELECT value FROM meta WHERE key = ?", (key,))
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
        with self.file.writing(at_once=True):
            self.file.insert("meta", [(key, value)], "INSERT OR REPLACE")

    def set_layout(self, key: str, text: str, arrays: Mapping[str, Array]) -> None:
        """Set a value and the arrays that it names in place of all arrays; nothing is written if it has not changed."""
        if self.meta(key) == text:
            return
        rows = [(name, json.dumps(array.shape), zlib.compress(as_bytes(array))) for name, array in arrays.items()]
        with self.file.writing(at_once=True):
            self.file.write("DELETE FROM arrays")
            self.file.insert("arrays", rows)
            self.file.insert("meta", [(key, text)], "INSERT OR REPLACE")

    def array(self, name: str) -> Array:
        """Read an array that was set with `set_layout`."""
        rows = self.file.read("SELECT shape, data FROM arrays WHERE name = ?", (name,))
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
        with self.file.writing(at_once=True):
            rows = [(self.file.number(each.key), each.definition, json.dumps(each.code)) for each in methods]
            self.file.insert("methods", rows, "INSERT OR IGNORE")

    def of_other_code(
        self, method: StoredMethod, n_runs: int, current: Collection[str] = ()
    ) -> list[tuple[list[Any], int]]:
        """Count the runs that other code has computed and this code has not, by what identifies the others."""
        query = "SELECT key, code FROM methods JOIN keys ON number = method WHERE definition = ? ORDER BY method"
        rows = self.file.read(query, (method.definition,))
        others = {key: self._checked("methods.code", code) for key, code in rows if key not in current}
        return self._missing_from(method.key, others, n_runs)

    def _missing_from(self, method: str, others: Mapping[str, Any], n_runs: int) -> list[tuple[list[Any], int]]:
        kept = {key: code for key, code in others.items() if key != method}
        columns = {key: Column("status", key) for key in kept}
        n = min(n_runs, max(map(self._columns.stop, columns.values()), default=0))
        missing, label = ~self._columns.stored(Column("status", method), n), np.zeros(n, dtype=np.int64)
        codes: list[list[Any]] = [[]]
        for key, code in kept.items():
            # Every set of codes so far is split into the runs that this code has computed too, and the others.
            there = self._columns.stored(columns[key], n) & missing
            used, label = np.unique(2 * label + there, return_inverse=True)
            codes = [[*codes[each // 2], code] if each % 2 else codes[each // 2] for each in used.tolist()]
        counts = np.bincount(label, minlength=len(codes)).tolist()
        return [(each, count) for each, count in zip(codes, counts, strict=True) if each]

    def finished(
        self, method: str, metrics: Iterable[str], recording: Recording = _NOTHING, n_runs: int = sys.maxsize
    ) -> Int[Array, " finished"]:
        """Return the runs of a method that are stored with all given metrics and, where required, signals and moments.

        Of the moments those count that `ensemble` returns for ``n_runs``.
        """
        status = Column("status", method)
        there = self._columns.stored(status, min(n_runs, self._columns.stop(status)))
        for metric in metrics:
            there &= self._columns.stored(Column("metric", method, metric), len(there))
        if recording.n_runs and recording.signals:
            there = self._with_traces(method, there, recording)
        if recording.ensemble:
            query = "SELECT first, stop FROM ensemble_groups WHERE method = ? AND stop <= ?"
            there &= covered(len(there), self.file.read(query, (self.file.find_number(method), n_runs)))
        return np.flatnonzero(there)

    def _with_traces(self, method: str, there: Bool[Array, " runs"], recording: Recording) -> Bool[Array, " runs"]:
        """Return which of some runs have the trajectories that they need."""
        runs, status = self._columns.read(Column("status", method), len(there))
        complete = np.arange(len(there)) >= recording.n_runs
        complete[runs[np.isin(status, _MAYBE_WITHOUT_TRACES)]] = True
        query = "SELECT run FROM traces WHERE method = ? AND signal = ? AND run < ?"
        for signal in recording.signals:
            recorded = complete.copy()
            numbers = self.file.find_number(method), self.file.find_number(signal)
            recorded[[run for (run,) in self.file.read(query, (*numbers, len(there)))]] = True
            there = there & recorded
        return there

    def add_block(
        self,
        method: str,
        runs: Sequence[int],
        block: Block,
        metrics: Mapping[str, Array],
        draw: str,
        uncertainty: Sampled,
    ) -> None:
        """Store a finished block; it is committed at once unless commits have taken too much of the time."""
        indices = np.array(runs, dtype=np.int64)
        columns = {Column("status", method): np.array(block.status)}
        columns |= {Column("metric", method, metric): np.array(column) for metric, column in metrics.items()}
        columns |= {Column("uncertainty", draw, name): column for name, column in by_name(uncertainty).items()}
        for column, values in columns.items():
            if values.shape != indices.shape:
                raise ValueError(f"{column}: values of shape {values.shape} for {len(indices)} runs")
        with self.file.writing():
            for column, values in columns.items():
                self._columns.put(column, indices, values)
            number = self.file.number(method)
            write_groups(self.file, number, block.ensemble)
            traces = [
                (number, self.file.number(signal), run, trace.shape[1], as_bytes(trace))
                for signal, recorded in block.traces.items()
                for run, trace in zip(indices.tolist(), recorded, strict=False)  # the first ones of the block
            ]
            self.file.insert("traces", traces, "INSERT OR REPLACE")
            write_journal(self.file, number, np.sort(indices), block.journal)

    def copy_from(self, other: Store) -> None:
        """Copy the rows of another store of the experiment that this one lacks, in one transaction."""
        with self.file.writing(at_once=True):
            copy_rows(other._columns, self._columns)

    def failures(self, method: str, n_runs: int) -> list[RunFailure]:
        """Failures of a method that have a description, in the order of the runs."""
        with decoded(self.directory):
            return read_failures(self.file, self.file.find_number(method), n_runs)

    def held(self, method: str, n_runs: int) -> dict[int, int]:
        """Run -> number of held steps, of the runs that have some."""
        query = "SELECT run, n FROM held WHERE method = ? AND run < ? ORDER BY run"
        return dict(self.file.read(query, (self.file.find_number(method), n_runs)))

    def failed_steps(self, method: str, n_runs: int) -> dict[int, dict[str, int]]:
        """Run -> word of a status -> number of steps whose optimisation failed so, of the runs that have some."""
        with decoded(self.directory):
            return read_failed_steps(self.file, self.file.find_number(method), n_runs)

    def warnings(self, method: str, n_runs: int) -> dict[str, int]:
        """Text of a warning of a component -> how often it was given, the most frequent one first."""
        counted = "SELECT text, sum(n) AS n FROM warnings WHERE method = ? AND first < ?"
        query = f"{counted} GROUP BY text ORDER BY 2 DESC, text"
        return {visible(text): n for text, n in self.file.read(query, (self.file.find_number(method), n_runs))}

    def durations(self, method: str, n_runs: int) -> dict[str, Durations]:
        """Component and phase -> durations of its calls."""
        with decoded(self.directory):
            return read_durations(self.file, self.file.find_number(method), n_runs)

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
        rows = self.file.read(query, (self.file.find_number(method), self.file.find_number(signal), n_runs))
        with decoded(self.directory):
            recorded = [as_array(data).reshape(-1, width) for _, width, data in rows]
            return [run for run, *_ in rows], np.array(recorded) if rows else np.zeros((0, 0, 0))

    def ensemble(self, method: str, n_runs: int) -> list[Group]:
        """Groups of runs of a method and single runs of groups that are not whole, in their order.

        A group that reaches beyond n_runs is left out.
        """
        with decoded(self.directory):
            return read_groups(self.file, self.file.find_number(method), n_runs)

    def uncertainty(self, draw: str, n_runs: int) -> tuple[Int[Array, " runs"], dict[str, Array]]:
        """Return the runs that have named uncertain quantities, and name -> (runs,) values, NaN where there is none."""
        return self._columns.sampled(draw, n_runs)
