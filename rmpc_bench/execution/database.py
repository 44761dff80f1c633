"""The file trials.sqlite: its tables, its lock and its errors.

One writer holds an exclusive lock, and the journal is a rollback journal.  This also works on network file systems.  A
process that is killed loses only the transaction that it has not finished.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

FILE = "trials.sqlite"
_SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE methods (method TEXT PRIMARY KEY, definition TEXT NOT NULL, code TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE trials (method TEXT, run INTEGER, status TEXT NOT NULL, PRIMARY KEY (method, run)) WITHOUT ROWID;
CREATE TABLE metrics (method TEXT, metric TEXT, run INTEGER, value REAL, PRIMARY KEY (method, metric, run))
    WITHOUT ROWID;
CREATE TABLE uncertainty (draw TEXT, run INTEGER, name TEXT, value REAL NOT NULL, PRIMARY KEY (draw, run, name))
    WITHOUT ROWID;
CREATE TABLE traces (method TEXT, signal TEXT, run INTEGER, width INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (method, signal, run));
CREATE TABLE ensemble_groups (method TEXT, first INTEGER, stop INTEGER, n INTEGER NOT NULL, width INTEGER NOT NULL,
    mean BLOB NOT NULL, second BLOB NOT NULL, PRIMARY KEY (method, first, stop));
CREATE TABLE arrays (name TEXT PRIMARY KEY, shape TEXT NOT NULL, data BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE failures (method TEXT, run INTEGER, status TEXT NOT NULL, failure TEXT NOT NULL,
    PRIMARY KEY (method, run)) WITHOUT ROWID;
CREATE TABLE held (method TEXT, run INTEGER, n INTEGER NOT NULL, PRIMARY KEY (method, run)) WITHOUT ROWID;
CREATE TABLE warnings (method TEXT, first INTEGER, stop INTEGER, text TEXT, n INTEGER NOT NULL,
    PRIMARY KEY (method, first, stop, text)) WITHOUT ROWID;
CREATE TABLE durations (method TEXT, first INTEGER, stop INTEGER, phase TEXT, largest REAL NOT NULL,
    counts TEXT NOT NULL, PRIMARY KEY (method, first, stop, phase)) WITHOUT ROWID;
"""
_ADDED = ("methods", "traces", "ensemble_groups", "arrays", "failures", "held", "warnings", "durations")
"""Tables that a store of an earlier version lacks."""


class StoreError(Exception):
    """A directory that cannot be used: it holds another experiment, or another process writes to it."""


class MissingError(Exception):
    """A directory without trials, or without what a report needs beside them."""


class WriteError(Exception):
    """Results could not be written; everything stored before is intact."""


class Database:
    """An open trials.sqlite.

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

    def __init__(self, directory: Path, *, writable: bool) -> None:
        self._path = path = directory / FILE
        try:
            if writable:
                directory.mkdir(parents=True, exist_ok=True)
                self.connection = sqlite3.connect(path, timeout=0.0, isolation_level=None)
            else:
                # Opened for writing if possible: the journal of a killed writer is rolled back before the first read.
                mode = "rw" if os.access(path, os.W_OK) else "ro"
                self.connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", uri=True, timeout=5.0)
                self.connection.execute("PRAGMA query_only = ON")
        except (OSError, sqlite3.OperationalError) as error:
            raise WriteError(f"{path}: {error}") from None
        try:
            if writable:
                self._prepare()
            for table in ("meta", *_ADDED):
                self.connection.execute(f"SELECT 1 FROM {table} LIMIT 1")
        except sqlite3.DatabaseError as error:
            self.connection.close()
            raise _translated(error, path) from None

    def _prepare(self) -> None:
        execute = self.connection.execute
        execute("PRAGMA locking_mode = EXCLUSIVE")
        execute("PRAGMA journal_mode = DELETE")
        execute("BEGIN EXCLUSIVE")
        for statement in filter(str.strip, _SCHEMA.split(";")):
            # A store of an earlier version lacks some tables.
            execute(statement.replace("TABLE", "TABLE IF NOT EXISTS"))
        execute("COMMIT")

    def close(self) -> None:
        """Close the file and release the lock."""
        self.connection.close()

    def read(self, query: str, parameters: tuple[Any, ...]) -> list[Any]:
        """Return the rows that a query finds."""
        try:
            return self.connection.execute(query, parameters).fetchall()
        except sqlite3.DatabaseError as error:
            raise _translated(error, self._path) from None

    def write(self, statements: Sequence[tuple[str, Sequence[tuple[Any, ...]]]]) -> None:
        """Execute statements, each for a sequence of rows, in one transaction.

        Raises
        ------
        WriteError
            If the rows cannot be written; none of them is stored then.
        """
        try:
            with closing(self.connection.cursor()) as cursor:
                cursor.execute("BEGIN IMMEDIATE")
                try:
                    for statement, rows in statements:
                        cursor.executemany(statement, rows)
                    cursor.execute("COMMIT")
                except BaseException:
                    if self.connection.in_transaction:
                        cursor.execute("ROLLBACK")
                    raise
        except sqlite3.DatabaseError as error:
            raise _translated(error, self._path) from None


def _translated(error: sqlite3.DatabaseError, path: Path) -> Exception:
    text = str(error)
    if "locked" in text:
        return StoreError(f"{path}: another process writes to it; wait for it to end, or choose another -o DIR")
    if any(f"no such table: {table}" in text for table in _ADDED):
        return MissingError(f"{path}: holds trials of an earlier version; rmpc-bench run completes it")
    if "not a database" in text or "no such table" in text or "malformed" in text:
        return StoreError(f"{path}: is not a store of trials ({text}); choose another -o DIR, or --fresh")
    return WriteError(f"{path}: {text}")
