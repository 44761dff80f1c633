"""The open file trials.sqlite: who may write, what is one transaction, and when it is committed.

One writer holds an exclusive lock, and the journal is a rollback journal.  This also works on network file systems.  A
process that is killed loses only what it has not committed.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rmpc_bench.received.store import FILE, WriteError, connected, rows_of, translated

SHARE = 0.05
"""Part of the time since the file was opened that commits may take."""
AT_ONCE = 0.1
"""Time that commits may take in any case [s], so that the blocks of a short computation do not wait."""


class StoreFile:
    """An open trials.sqlite."""

    def __init__(self, directory: Path, *, writable: bool) -> None:
        self.directory = directory
        self.numbers: dict[Hashable, int] = {}
        """Numbers of keys and columns, as they are found."""
        self._path = path = directory / FILE
        try:
            if writable and not directory.is_dir():
                directory.mkdir(parents=True, exist_ok=True)
            self.connection = connected(path, writable=writable)
        except (OSError, sqlite3.OperationalError) as error:
            raise WriteError(f"{path}: {error}") from None
        self._opened, self._committing = time.monotonic(), 0.0

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

    def write(self, statement: str, rows: Sequence[tuple[Any, ...]] = ((),)) -> None:
        """Execute a statement for each of some rows, while `writing`."""
        with self._translating():
            self.connection.executemany(statement, rows)

    def insert(self, table: str, rows: Sequence[tuple[Any, ...]], how: str = "INSERT") -> None:
        """Write whole rows of a table, while `writing`."""
        if rows:
            self.write(f"{how} INTO {table} VALUES ({', '.join('?' * len(rows[0]))})", rows)

    @contextmanager
    def writing(self, *, at_once: bool = False) -> Iterator[None]:
        """Write all that is written inside it, or nothing of it; it is committed at once or when commits have time."""
        with self._translating():
            if not self.connection.in_transaction:
                self.connection.execute("BEGIN IMMEDIATE")
            self.connection.execute("SAVEPOINT block")
            try:
                yield
            except BaseException:
                self.numbers.clear()
                # SQLite may have rolled back the whole transaction, as on a full disk.
                if self.connection.in_transaction:
                    self.connection.execute("ROLLBACK TO block")
                    self.connection.execute("RELEASE block")
                raise
            self.connection.execute("RELEASE block")
        if at_once or self._committing <= AT_ONCE + SHARE * (time.monotonic() - self._opened):
            self.commit()

    def commit(self) -> None:
        """Commit everything that is written."""
        if not self.connection.in_transaction:
            return
        start = time.monotonic()
        with self._translating():
            try:
                self.connection.execute("COMMIT")
            except BaseException:
                self.numbers.clear()
                if self.connection.in_transaction:
                    self.connection.execute("ROLLBACK")
                raise
        self._committing += time.monotonic() - start

    @contextmanager
    def _translating(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.DatabaseError as error:
            raise translated(error, self._path) from None

    def find_number(self, key: str) -> int:
        """Return the number of a key (a hash, or the name of a quantity or signal); 0 if it has none."""
        if key not in self.numbers:
            rows = self.read("SELECT number FROM keys WHERE key = ?", (key,))
            if not rows:
                return 0
            self.numbers[key] = rows[0][0]
        return self.numbers[key]

    def number(self, key: str) -> int:
        """Return the number of a key, which gets one while `writing`; see `find_number`."""
        if not self.find_number(key):
            self.write("INSERT INTO keys (key) VALUES (?)", [(key,)])
        return self.find_number(key)
