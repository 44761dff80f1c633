"""The file trials.sqlite: its tables, its lock and its errors.

One writer holds an exclusive lock, and the journal is a rollback journal.  This also works on network file systems.  A
process that is killed loses only the transaction that it has not finished.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.received.store import (
    FILE,
    MissingError,
    OccupiedError,
    WriteError,
    connected,
    rows_of,
    translated,
)

__all__ = ["FILE", "Database", "MissingError", "OccupiedError", "StoreError", "WriteError"]

Statement = tuple[str, Sequence[tuple[Any, ...]]]
"""A statement and the rows for which it is executed."""


class Database:
    """An open trials.sqlite; it may be used by several threads, one at a time."""

    def __init__(self, directory: Path, *, writable: bool) -> None:
        self.directory = directory
        self._path = path = directory / FILE
        self._numbers: dict[str, int] = {}
        try:
            if writable and not directory.is_dir():
                directory.mkdir(parents=True, exist_ok=True)
            self.connection = connected(path, writable=writable)
        except (OSError, sqlite3.OperationalError) as error:
            raise WriteError(f"{path}: {error}") from None

    def close(self) -> None:
        """Close the file and release the lock."""
        self.connection.close()

    def read(self, query: str, parameters: tuple[Any, ...] = ()) -> list[Any]:
        """Return the rows that a query finds, checked by the names of their columns."""
        try:
            return rows_of(self.connection, self._path, query, parameters)
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            raise translated(error, self._path) from None

    def has_table(self, name: str) -> bool:
        """Whether there is a table of this name, which a store of an earlier version may lack."""
        return bool(self.read("SELECT name FROM sqlite_master WHERE type = 'table' AND name = ?", (name,)))

    def write(self, statements: Sequence[Statement]) -> None:
        """Execute statements, each for a sequence of rows, inside a `transaction`."""
        try:
            for statement, rows in statements:
                self.connection.executemany(statement, rows)
        except sqlite3.DatabaseError as error:
            raise translated(error, self._path) from None

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit what is written inside it, or nothing of it."""
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
            raise translated(error, self._path) from None

    def find_number(self, key: str) -> int:
        """Return the number of a key (a hash, or the name of a quantity or signal); 0 if it has none."""
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
