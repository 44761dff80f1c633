"""The trial store of an experiment, with one transaction per finished block.

Trials are stored under the hash of the definition of their method and of the code that computed them, and metrics under
the hash of their definition.  After a change of a definition or of the code the old numbers are therefore not used.
"""

from __future__ import annotations

import json
import math
import sys
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from rmpc_bench.execution.database import Database, StoreError
from rmpc_bench.execution.differences import Names, differences
from rmpc_bench.execution.durations import Durations
from rmpc_bench.execution.ensemble_table import as_array, as_bytes, read_groups, with_stored_runs
from rmpc_bench.execution.journal_tables import journal_rows, read_durations, read_failures
from rmpc_bench.execution.stored_method import StoredMethod
from rmpc_bench.simulation.closed_loop import Block
from rmpc_bench.simulation.ensemble import Group
from rmpc_bench.simulation.scenario import Recording
from rmpc_bench.types import Array, RunFailure, Status

_NOTHING = Recording()
_WORDS = {int(status): status.word for status in Status}
_MAYBE_WITHOUT_TRACES = ", ".join(f"'{status.word}'" for status in (Status.CRASHED, Status.TIMEOUT))
"""Statuses of runs that may have no trajectories, because their block was not simulated to its end."""


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
        self._read, self._write = self._database.read, self._database.write

    def __enter__(self) -> Store:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close the file and release the lock."""
        self._database.close()

    def meta(self, key: str) -> str | None:
        """Read a value that was set with `set_meta`."""
        rows = self._read("SELECT value FROM meta WHERE key = ?", (key,))
        return str(rows[0][0]) if rows else None

    def set_meta(self, key: str, value: str) -> None:
        """Set a value."""
        self._write([("INSERT OR REPLACE INTO meta VALUES (?, ?)", [(key, value)])])

    def set_layout(self, key: str, text: str, arrays: Mapping[str, Array]) -> None:
        """Set a value and the arrays that it names in place of all arrays; nothing is written if it has not changed.

        Parameters
        ----------
        key, text : name and value, as for `set_meta`
        arrays : arrays under a name that changes with their content
        """
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
        [(shape, data)] = self._read("SELECT shape, data FROM arrays WHERE name = ?", (name,))
        return as_array(zlib.decompress(data)).reshape(json.loads(shape))

    def has_trials(self, method: str) -> bool:
        """Whether a run of a method is stored."""
        return bool(self._read("SELECT 1 FROM trials WHERE method = ? LIMIT 1", (method,)))

    def file_names(self, also: Names | None = None) -> dict[str, Mapping[str, str]]:
        """Return hash of a source or a data file -> names of its files -> their hashes, for messages.

        Parameters
        ----------
        also : the same of the configuration
        """
        return {**json.loads(self.meta("files") or "{}"), **(also or {})}

    def claim(self, experiment: str, shared: Mapping[str, Any], files: Names | None = None) -> None:
        """Assign the directory to an experiment, or check that it already belongs to it.

        Parameters
        ----------
        experiment : hash of what all methods share
        shared : what all methods share
        files : names of the user's files, noted for messages

        Raises
        ------
        StoreError
            If the directory belongs to another experiment, with the differences.
        """
        if self.meta("experiment") is None:
            self.set_meta("shared", json.dumps(shared))
            self.set_meta("experiment", experiment)
        self.check(experiment, shared, files)
        if (names := self.file_names(files)) != self.file_names():
            self.set_meta("files", json.dumps(names))

    def check(self, experiment: str, shared: Mapping[str, Any], files: Names | None = None) -> None:
        """Check that the directory belongs to an experiment; see `claim`.

        Raises
        ------
        StoreError
            If it belongs to another one, with the differences.
        """
        if self.meta("experiment") != experiment:
            before, after = json.loads(self.meta("shared") or "{}"), json.loads(json.dumps(shared))
            lines = differences(before, after, self.file_names(files))
            raise StoreError(f"{self.directory} holds another experiment:\n" + "\n".join(f"  {line}" for line in lines))

    def register(self, methods: Iterable[StoredMethod]) -> None:
        """Note definition and code of methods whose trials are about to be stored."""
        rows = [(method.key, method.definition, json.dumps(method.code)) for method in methods]
        self._write([("INSERT OR IGNORE INTO methods VALUES (?, ?, ?)", rows)])

    def of_other_code(self, method: StoredMethod, n_runs: int, current: Collection[str] = ()) -> dict[int, list[Any]]:
        """Return the runs that other code has computed and this code has not, each with what identifies the others.

        Parameters
        ----------
        method : what its trials are stored under
        n_runs : number of runs of the experiment
        current : keys of the methods of the configuration, whose trials are those of no other code
        """
        query = """SELECT run, code, method FROM methods JOIN trials USING (method)
            WHERE definition = ? AND method != ? AND run < ? AND run NOT IN (SELECT run FROM trials WHERE method = ?)"""
        found: dict[int, list[Any]] = {}
        for run, code, key in self._read(query, (method.definition, method.key, n_runs, method.key)):
            if key not in current:
                found.setdefault(run, []).append(json.loads(code))
        return found

    def finished(
        self, method: str, metrics: Iterable[str], recording: Recording = _NOTHING, n_runs: int = sys.maxsize
    ) -> set[int]:
        """Return the runs of a method that are stored with all given metrics and, where required, signals and moments.

        Of the moments those count that `ensemble` returns for ``n_runs``.
        """
        runs = {run for (run,) in self._read("SELECT run FROM trials WHERE method = ?", (method,))}
        for metric in metrics:
            rows = self._read("SELECT run FROM metrics WHERE method = ? AND metric = ?", (method, metric))
            runs &= {run for (run,) in rows}
        query = f"""SELECT run FROM traces WHERE method = ? AND signal = ? UNION
            SELECT run FROM trials WHERE method = ? AND status IN ({_MAYBE_WITHOUT_TRACES})"""
        for signal in recording.signals if recording.n_runs else ():
            rows = self._read(query, (method, signal, method))
            runs -= set(range(recording.n_runs)) - {run for (run,) in rows}
        if recording.ensemble:
            rows = self._read(
                "SELECT first, stop FROM ensemble_groups WHERE method = ? AND stop <= ?", (method, n_runs)
            )
            runs &= {run for first, stop in rows for run in range(first, stop)}
        return runs

    def add_block(
        self,
        method: str,
        runs: Sequence[int],
        block: Block,
        metrics: Mapping[str, Array],
        draw: str,
        uncertainty: Sequence[Mapping[str, float]],
    ) -> None:
        """Store a finished block in one transaction.

        Parameters
        ----------
        method : hash of the method
        runs : indices of the runs
        block : their results
        metrics : hash of the metric -> (runs,) values, NaN where there is none
        draw : hash of what the named uncertain values depend on
        uncertainty : these values, name -> value, for every run
        """
        trials = [(method, run, _WORDS[code]) for run, code in zip(runs, block.status.tolist(), strict=True)]
        values = [
            (method, metric, run, None if math.isnan(value) else value)
            for metric, column in metrics.items()
            for run, value in zip(runs, column.tolist(), strict=True)
        ]
        traces = [
            (method, signal, run, trace.shape[1], as_bytes(trace))
            for signal, recorded in block.traces.items()
            for run, trace in zip(runs, recorded, strict=False)  # the first ones of the block
        ]
        named = [
            (draw, run, name, value) for run, row in zip(runs, uncertainty, strict=True) for name, value in row.items()
        ]
        groups = with_stored_runs(self._read, method, block.ensemble)
        reduced = [(method, group.first, group.stop) for group in groups if not group.is_single]
        self._write(
            [
                # Single runs of a group are needed until it is whole.
                ("DELETE FROM ensemble_groups WHERE method = ? AND first >= ? AND stop <= ?", reduced),
                (
                    "INSERT OR REPLACE INTO ensemble_groups VALUES (?, ?, ?, ?, ?, ?, ?)",
                    [(method, *group[:3], group.mean.shape[1], *map(as_bytes, group[3:])) for group in groups],
                ),
                ("INSERT OR REPLACE INTO trials VALUES (?, ?, ?)", trials),
                ("INSERT OR REPLACE INTO metrics VALUES (?, ?, ?, ?)", values),
                ("INSERT OR REPLACE INTO traces VALUES (?, ?, ?, ?, ?)", traces),
                ("INSERT OR REPLACE INTO uncertainty VALUES (?, ?, ?, ?)", named),
                *journal_rows(method, runs, block.journal),
            ]
        )

    def failures(self, method: str, n_runs: int) -> list[RunFailure]:
        """Failures of a method that have a description, in the order of the runs."""
        return read_failures(self._read, method, n_runs)

    def held(self, method: str, n_runs: int) -> dict[int, int]:
        """Run -> number of held steps, of the runs that have some."""
        return dict(self._read("SELECT run, n FROM held WHERE method = ? AND run < ? ORDER BY run", (method, n_runs)))

    def warnings(self, method: str, n_runs: int) -> dict[str, int]:
        """Text of a warning of a component -> how often it was given, the most frequent one first."""
        query = "SELECT text, sum(n) FROM warnings WHERE method = ? AND first < ? GROUP BY text ORDER BY 2 DESC, text"
        return dict(self._read(query, (method, n_runs)))

    def durations(self, method: str, n_runs: int) -> dict[str, Durations]:
        """Component and phase -> durations of its calls."""
        return read_durations(self._read, method, n_runs)

    def column(self, method: str, n_runs: int) -> tuple[list[int], list[str]]:
        """Run indices and status words of a method, in the order of the runs."""
        query = "SELECT run, status FROM trials WHERE method = ? AND run < ? ORDER BY run"
        rows = self._read(query, (method, n_runs))
        return [run for run, _ in rows], [status for _, status in rows]

    def values(self, method: str, metric: str, runs: Sequence[int]) -> Array:
        """Values of a metric for the given runs; NaN where there is none."""
        query = "SELECT run, value FROM metrics WHERE method = ? AND metric = ?"
        stored = dict(self._read(query, (method, metric)))
        return np.array([math.nan if stored.get(run) is None else stored[run] for run in runs], dtype=float)

    def traces(self, method: str, signal: str, n_runs: int) -> tuple[list[int], Array]:
        """Recorded runs of a method and their trajectories, (recorded, samples, components)."""
        query = "SELECT run, width, data FROM traces WHERE method = ? AND signal = ? AND run < ? ORDER BY run"
        rows = self._read(query, (method, signal, n_runs))
        recorded = [as_array(data).reshape(-1, width) for _, width, data in rows]
        return [run for run, *_ in rows], np.array(recorded) if rows else np.zeros((0, 0, 0))

    def ensemble(self, method: str, n_runs: int) -> list[Group]:
        """Groups of runs of a method and single runs of groups that are not whole, in their order.

        A group that reaches beyond n_runs is left out.
        """
        return read_groups(self._read, method, n_runs)

    def uncertainty(self, draw: str, n_runs: int) -> list[tuple[int, str, float]]:
        """All (run, name, value) of the named uncertain quantities, sorted."""
        query = "SELECT run, name, value FROM uncertainty WHERE draw = ? AND run < ? ORDER BY run, name"
        return self._read(query, (draw, n_runs))
