"""The file trials.sqlite: its tables, its lock and its errors.

One writer holds an exclusive lock, and the journal is a rollback journal.  This also works on network file systems.  A
process that is killed loses only the transaction that it has not finished.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rmpc_bench.execution.damage import damage
from rmpc_bench.execution.store_file import (
    APPLICATION,
    FILE,
    FORMAT,
    MissingError,
    OccupiedError,
    StoreError,
    check_file,
)

__all__ = ["FILE", "Database", "MissingError", "OccupiedError", "StoreError", "WriteError"]

_LATER = """
CREATE TABLE IF NOT EXISTS failed_steps (method INTEGER, run INTEGER, status INTEGER, n INTEGER NOT NULL,
    PRIMARY KEY (method, run, status)) WITHOUT ROWID
"""
"""Table that stores of this format lack which an earlier version has made; a writer adds it."""
_SCHEMA = f"""
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = {FORMAT};
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE keys (number INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE);
CREATE TABLE methods (method INTEGER PRIMARY KEY, definition TEXT NOT NULL, code TEXT NOT NULL);
CREATE TABLE columns (number INTEGER PRIMARY KEY, kind TEXT NOT NULL, owner INTEGER NOT NULL, name INTEGER NOT NULL,
    UNIQUE (kind, owner, name));
CREATE TABLE chunks (column INTEGER, number INTEGER, stored BLOB, data BLOB NOT NULL, PRIMARY KEY (column, number));
CREATE TABLE traces (method INTEGER, signal INTEGER, run INTEGER, width INTEGER NOT NULL, data BLOB NOT NULL,
    PRIMARY KEY (method, signal, run));
CREATE TABLE ensemble_groups (method INTEGER, first INTEGER, stop INTEGER, n INTEGER NOT NULL, width INTEGER NOT NULL,
    mean BLOB NOT NULL, second BLOB NOT NULL, PRIMARY KEY (method, first, stop));
CREATE TABLE arrays (name TEXT PRIMARY KEY, shape TEXT NOT NULL, data BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE failures (method INTEGER, run INTEGER, failure TEXT NOT NULL, PRIMARY KEY (method, run)) WITHOUT ROWID;
CREATE TABLE held (method INTEGER, run INTEGER, n INTEGER NOT NULL, PRIMARY KEY (method, run)) WITHOUT ROWID;
CREATE TABLE warnings (method INTEGER, first INTEGER, stop INTEGER, text TEXT, n INTEGER NOT NULL,
    PRIMARY KEY (method, first, stop, text)) WITHOUT ROWID;
CREATE TABLE durations (method INTEGER, first INTEGER, stop INTEGER, phase TEXT, largest REAL NOT NULL,
    counts TEXT NOT NULL, PRIMARY KEY (method, first, stop, phase)) WITHOUT ROWID;
"""
Statement = tuple[str, Sequence[tuple[Any, ...]]]
"""A statement and the rows for which it is executed."""


class WriteError(Exception):
    """Results could not be written; everything stored before is intact."""


class Database:
    """An open trials.sqlite; it may be used by several threads, one at a time.

    Parameters
    ----------
    directory : directory of the experiment, made if it is not there
    writable : whether to take the lock and create the tables of a new file

    Raises
    ------
    StoreError
        If another process writes to the file, or it is not a store of this version.
    MissingError
        If there is nothing to read.
    WriteError
        If the directory or the file cannot be made.
    """

    def __init__(self, directory: Path, *, writable: bool) -> None:
        self.directory = directory
        self._path = path = directory / FILE
        self._numbers: dict[str, int] = {}
        try:
            if writable:
                directory.mkdir(parents=True, exist_ok=True)
            is_new = check_file(path, writable=writable)
            # Opened for writing if possible: the journal of a killed writer is rolled back before the first read.
            mode = "rwc" if writable else "rw" if os.access(path, os.W_OK) and not path.is_symlink() else "ro"
            self.connection = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode={mode}",
                uri=True,
                timeout=0.0 if writable else 5.0,
                isolation_level=None,
                check_same_thread=False,
            )
        except (OSError, sqlite3.OperationalError) as error:
            raise WriteError(f"{path}: {error}") from None
        try:
            self._prepare(writable=writable, is_new=is_new)
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            self.connection.close()
            raise _translated(error, path) from None

    def _prepare(self, *, writable: bool, is_new: bool) -> None:
        execute = self.connection.execute
        execute("PRAGMA trusted_schema = OFF")
        if not writable:
            execute("PRAGMA query_only = ON")
        else:
            execute("PRAGMA locking_mode = EXCLUSIVE")
            execute("PRAGMA journal_mode = DELETE")
            execute("BEGIN EXCLUSIVE")
            # A writer that was killed before its first commit has left a file without tables.
            if is_new or not execute("SELECT 1 FROM sqlite_master").fetchone():
                for statement in filter(str.strip, _SCHEMA.split(";")):
                    execute(statement)
            execute(_LATER)
            execute("COMMIT")
        execute("SELECT 1 FROM meta LIMIT 1")

    def close(self) -> None:
        """Close the file and release the lock."""
        self.connection.close()

    def read(self, query: str, parameters: tuple[Any, ...] = ()) -> list[Any]:
        """Return the rows that a query finds."""
        try:
            return self.connection.execute(query, parameters).fetchall()
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            raise _translated(error, self._path) from None

    def has_table(self, name: str) -> bool:
        """Whether there is a table of this name, which a store of an earlier version may lack."""
        return bool(self.read("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?", (name,)))

    def write(self, statements: Sequence[Statement]) -> None:
        """Execute statements, each for a sequence of rows, inside a `transaction`.

        Raises
        ------
        WriteError
            If the rows cannot be written.
        """
        try:
            for statement, rows in statements:
                self.connection.executemany(statement, rows)
        except sqlite3.DatabaseError as error:
            raise _translated(error, self._path) from None

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit what is written inside it, or nothing of it.

        Raises
        ------
        WriteError
            If it cannot be written.
        """
        try:
            self.connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self.connection.execute("COMMIT")
            except BaseException:
                if self.connection.in_transaction:
                    self.connection.execute("ROLLBACK")
                self._numbers.clear()
                raise
        except sqlite3.DatabaseError as error:
            raise _translated(error, self._path) from None

    def find_number(self, key: str) -> int:
        """Return the number of a key; 0 if it has none.

        Parameters
        ----------
        key : hash of a method, of a metric or of what is drawn, or name of a quantity or signal
        """
        if key not in self._numbers:
            rows = self.read("SELECT number FROM keys WHERE key = ?", (key,))
            if not rows:
                return 0
            self._numbers[key] = rows[0][0]
        return self._numbers[key]

    def number(self, key: str) -> int:
        """Return the number of a key, which gets one inside a `transaction`; see `find_number`."""
        if not self.find_number(key):
            self.write([("INSERT INTO keys (key) VALUES (?)", [(key,)])])
        return self.find_number(key)


def _translated(error: sqlite3.DatabaseError | UnicodeDecodeError, path: Path) -> Exception:
    text = str(error)
    if isinstance(error, UnicodeDecodeError) or "Could not decode" in text:
        return StoreError(damage(path.parent, "a text is not UTF-8"))
    if "locked" in text:
        return OccupiedError(f"{path}: another process writes to it; wait for it to end, or choose another -o DIR")
    if "not a database" in text or "no such table" in text or "malformed" in text or "corrupt" in text:
        return StoreError(f"{path}: is not a trial store ({text}); choose another -o DIR, or --fresh")
    return WriteError(f"{path}: {text}")
