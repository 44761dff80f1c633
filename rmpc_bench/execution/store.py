"""The trial store of an experiment: trials.sqlite.

The store uses one transaction per finished block, one writer with an exclusive lock, and a rollback journal.  This also
works on network file systems.  A process that is killed loses only the unfinished blocks.  Trials are stored under the
hash of the definition of their method, and metrics under the hash of their definition.  After a change of a definition
the old numbers are therefore not used.
"""

from __future__ import annotations

import json
import math
import os
import sqlite3
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from rmpc_bench.simulation.closed_loop import Block
from rmpc_bench.simulation.ensemble import Group
from rmpc_bench.simulation.scenario import Recording
from rmpc_bench.types import Array, Status

FILE = "trials.sqlite"
_SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE trials (method TEXT, run INTEGER, status TEXT NOT NULL, PRIMARY KEY (method, run)) WITHOUT ROWID;
CREATE TABLE metrics (method TEXT, metric TEXT, run INTEGER, value REAL, PRIMARY KEY (method, metric, run))
    WITHOUT ROWID;
CREATE TABLE uncertainty (draw TEXT, run INTEGER, name TEXT, value REAL NOT NULL, PRIMARY KEY (draw, run, name))
    WITHOUT ROWID;
CREATE TABLE traces (method TEXT, signal TEXT, run INTEGER, width INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (method, signal, run));
CREATE TABLE ensemble (method TEXT, first INTEGER, stop INTEGER NOT NULL, n INTEGER NOT NULL, width INTEGER NOT NULL,
    mean BLOB NOT NULL, second BLOB NOT NULL, PRIMARY KEY (method, first));
"""


_ADDED = ("traces", "ensemble")
"""Tables that a store of an earlier version lacks."""

_NOTHING = Recording()
_WORDS = {int(status): status.word for status in Status}


class StoreError(Exception):
    """A directory that cannot be used: it holds another experiment, or another process writes to it."""


class MissingError(Exception):
    """A directory without trials."""


class WriteError(Exception):
    """Results could not be written; everything stored before is intact."""


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
        path = directory / FILE
        try:
            if writable:
                directory.mkdir(parents=True, exist_ok=True)
                self._connection = sqlite3.connect(path, timeout=0.0, isolation_level=None)
            else:
                # Opened for writing if possible: the journal of a killed writer is rolled back before the first read.
                mode = "rw" if os.access(path, os.W_OK) else "ro"
                self._connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", uri=True, timeout=5.0)
                self._connection.execute("PRAGMA query_only = ON")
        except (OSError, sqlite3.OperationalError) as error:
            raise WriteError(f"{path}: {error}") from None
        try:
            if writable:
                self._prepare()
            for table in ("meta", *_ADDED):
                self._connection.execute(f"SELECT 1 FROM {table} LIMIT 1")
        except sqlite3.DatabaseError as error:
            self._connection.close()
            raise _translated(error, path) from None

    def _prepare(self) -> None:
        execute = self._connection.execute
        execute("PRAGMA locking_mode = EXCLUSIVE")
        execute("PRAGMA journal_mode = DELETE")
        execute("BEGIN EXCLUSIVE")
        for statement in filter(str.strip, _SCHEMA.split(";")):
            # A store of an earlier version lacks some tables.
            execute(statement.replace("TABLE", "TABLE IF NOT EXISTS"))
        execute("COMMIT")

    def __enter__(self) -> Store:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Close the file and release the lock."""
        self._connection.close()

    def meta(self, key: str) -> str | None:
        """Read a value that was set with `set_meta`."""
        rows = self._read("SELECT value FROM meta WHERE key = ?", (key,))
        return str(rows[0][0]) if rows else None

    def set_meta(self, key: str, value: str) -> None:
        """Set a value."""
        self._write([("INSERT OR REPLACE INTO meta VALUES (?, ?)", [(key, value)])])

    def claim(self, experiment: str, shared: Mapping[str, Any]) -> None:
        """Assign the directory to an experiment, or check that it already belongs to it.

        Raises
        ------
        StoreError
            If the directory belongs to another experiment, with the differences.
        """
        if self.meta("experiment") is None:
            self.set_meta("shared", json.dumps(shared))
            self.set_meta("experiment", experiment)
        self.check(experiment, shared)

    def check(self, experiment: str, shared: Mapping[str, Any]) -> None:
        """Check that the directory belongs to an experiment.

        Raises
        ------
        StoreError
            If it belongs to another one, with the differences.
        """
        if self.meta("experiment") != experiment:
            lines = differences(json.loads(self.meta("shared") or "{}"), json.loads(json.dumps(shared)))
            raise StoreError(f"{self.directory} holds another experiment:\n" + "\n".join(f"  {line}" for line in lines))

    def finished(
        self, method: str, metrics: Iterable[str], recording: Recording = _NOTHING, n_runs: int = sys.maxsize
    ) -> set[int]:
        """Return the runs of a method that are stored with all given metrics and, where required, signals and groups.

        Of the groups those count that `ensemble` returns for ``n_runs``.
        """
        runs = {run for (run,) in self._read("SELECT run FROM trials WHERE method = ?", (method,))}
        for metric in metrics:
            rows = self._read("SELECT run FROM metrics WHERE method = ? AND metric = ?", (method, metric))
            runs &= {run for (run,) in rows}
        for signal in recording.signals if recording.n_runs else ():
            rows = self._read("SELECT run FROM traces WHERE method = ? AND signal = ?", (method, signal))
            runs -= set(range(recording.n_runs)) - {run for (run,) in rows}
        if recording.ensemble:
            rows = self._read("SELECT first, stop FROM ensemble WHERE method = ? AND stop <= ?", (method, n_runs))
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
            (method, signal, run, trace.shape[1], _bytes(trace))
            for signal, recorded in block.traces.items()
            for run, trace in zip(runs, recorded, strict=False)  # the first ones of the block
        ]
        named = [
            (draw, run, name, value) for run, row in zip(runs, uncertainty, strict=True) for name, value in row.items()
        ]
        span = [(method, runs[0], runs[-1] + 1)]
        groups = [
            (method, group.first, group.stop, group.n, group.mean.shape[1], _bytes(group.mean), _bytes(group.second))
            for group in block.ensemble
        ]
        self._write(
            [
                # Groups of an earlier run with other blocks may overlap; their other runs are computed again.
                ("DELETE FROM ensemble WHERE method = ? AND stop > ? AND first < ?", span if groups else []),
                ("INSERT INTO ensemble VALUES (?, ?, ?, ?, ?, ?, ?)", groups),
                ("INSERT OR REPLACE INTO trials VALUES (?, ?, ?)", trials),
                ("INSERT OR REPLACE INTO metrics VALUES (?, ?, ?, ?)", values),
                ("INSERT OR REPLACE INTO traces VALUES (?, ?, ?, ?, ?)", traces),
                ("INSERT OR REPLACE INTO uncertainty VALUES (?, ?, ?, ?)", named),
            ]
        )

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
        recorded = [_array(data).reshape(-1, width) for _, width, data in rows]
        return [run for run, *_ in rows], np.array(recorded) if rows else np.zeros((0, 0, 0))

    def ensemble(self, method: str, n_runs: int) -> list[Group]:
        """Groups of runs of a method, in their order; one that reaches beyond n_runs is left out."""
        query = "SELECT first, stop, n, width, mean, second FROM ensemble WHERE method = ? AND stop <= ? ORDER BY first"
        return [
            Group(first, stop, n, _array(mean).reshape(-1, width), _array(second).reshape(-1, width, width))
            for first, stop, n, width, mean, second in self._read(query, (method, n_runs))
        ]

    def uncertainty(self, draw: str, n_runs: int) -> list[tuple[int, str, float]]:
        """All (run, name, value) of the named uncertain quantities, sorted."""
        query = "SELECT run, name, value FROM uncertainty WHERE draw = ? AND run < ? ORDER BY run, name"
        return self._read(query, (draw, n_runs))

    def _read(self, query: str, parameters: tuple[Any, ...]) -> list[Any]:
        try:
            return self._connection.execute(query, parameters).fetchall()
        except sqlite3.DatabaseError as error:
            raise _translated(error, self.directory / FILE) from None

    def _write(self, statements: Sequence[tuple[str, Sequence[tuple[Any, ...]]]]) -> None:
        try:
            with closing(self._connection.cursor()) as cursor:
                cursor.execute("BEGIN IMMEDIATE")
                try:
                    for statement, rows in statements:
                        cursor.executemany(statement, rows)
                    cursor.execute("COMMIT")
                except BaseException:
                    if self._connection.in_transaction:
                        cursor.execute("ROLLBACK")
                    raise
        except sqlite3.DatabaseError as error:
            raise _translated(error, self.directory / FILE) from None


def _bytes(array: Array) -> bytes:
    return np.ascontiguousarray(array, dtype="<f8").tobytes()


def _array(data: bytes) -> Array:
    return np.frombuffer(data, dtype="<f8")


def _translated(error: sqlite3.DatabaseError, path: Path) -> Exception:
    text = str(error)
    if "locked" in text:
        return StoreError(f"{path}: another process writes to it; wait for it to end, or choose another -o DIR")
    if any(f"no such table: {table}" in text for table in _ADDED):
        return StoreError(f"{path}: holds trials of an earlier version; rmpc-bench run completes it")
    if "not a database" in text or "no such table" in text or "malformed" in text:
        return StoreError(f"{path}: is not a store of trials ({text}); choose another -o DIR, or --fresh")
    return WriteError(f"{path}: {text}")


def differences(before: Any, after: Any, path: str = "") -> list[str]:
    """Say where two trees of plain data differ, a line each."""
    if isinstance(before, dict) and isinstance(after, dict):
        keys = [*before, *(key for key in after if key not in before)]
        return [
            line
            for key in keys
            for line in differences(before.get(key), after.get(key), f"{path}.{key}" if path else str(key))
        ]
    return [] if before == after else [f"{path}: there {json.dumps(before)}, here {json.dumps(after)}"]
