"""The file trials.sqlite as it may come from somebody else: which tables it may have, and which values its rows.

Looking at a file leaves it as it is: it is read without its journal and is not locked.  It is opened by SQLite only,
because a process that closes a file which it has opened in another way loses the locks that SQLite holds on it.

A query takes no more steps, and returns no more bytes, than a file of its size can need: the pages of a damaged file
may refer to each other without end.
"""

from __future__ import annotations

import json
import math
import os
import re
import sqlite3
import stat
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench.received.plain_files import DamagedError, StoreError

if TYPE_CHECKING:
    from rmpc_bench.types import Array

FILE = "trials.sqlite"
APPLICATION = 0x524D5043  # number in the header of the file that marks a trial store (the letters RMPC)
FORMAT = 2  # number of the format, which the header of the file holds
READER_WAITS = 5.0  # longest time in which a reader waits for a writer to end [s]
LATER = """
CREATE TABLE IF NOT EXISTS failed_steps (method INTEGER, run INTEGER, status INTEGER, n INTEGER NOT NULL,
    PRIMARY KEY (method, run, status)) WITHOUT ROWID
"""
"""Table that stores of this format lack which an earlier version has made; a writer adds it."""
SCHEMA = """
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
MOST_RUNS = 10_000_000  # largest number of runs of a configuration
_RANGES = {
    **dict.fromkeys(("number", "method", "signal", "owner", "column"), range(1, 2**53)),
    **dict.fromkeys(("n", "length"), range(2**53)),
    **dict.fromkeys(("run", "first", "stop"), range(MOST_RUNS + 1)),
    "status": range(128),
    "width": range(1, MOST_RUNS),
    "chunk": range(MOST_RUNS // 1000 + 1),
}  # column of a query -> its values, where they are whole numbers; all others but these are texts
_TYPES: dict[str, set[type]] = {
    **dict.fromkeys(("data", "mean", "second"), {bytes}),
    **dict.fromkeys(_RANGES, {int}),
    "stored": {bytes, type(None)},
    "largest": {float},
}
_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_FIRST_TABLES = {"meta", "trials", "metrics", "uncertainty"}  # tables of the first format, which did not number itself


class OccupiedError(StoreError):
    """Another process writes to the store."""


class MissingError(Exception):
    """A directory without trials, or without what a report needs beside them."""


class WriteError(Exception):
    """Results could not be written; everything stored before is intact."""


def damaged(directory: Path, text: str) -> DamagedError:
    """Return the error of a store that does not have the form in which it is written."""
    return DamagedError(
        f"{directory / FILE}: the store is damaged: {text}; `rmpc-bench run --fresh` computes everything again"
    )


@contextmanager
def decoded(directory: Path) -> Iterator[None]:
    """Report errors of a decoder as damage of the store."""
    try:
        yield
    except (ArithmeticError, ValueError, TypeError, LookupError, RecursionError, zlib.error) as error:
        raise damaged(directory, f"{error}"[:300]) from None


def check_file(path: Path, *, writable: bool) -> bool:
    """Refuse a file that is not a trial store of this format; return whether its tables must be made.

    `MissingError` where there is nothing to read, or only what another version has written.
    """
    try:
        found = path.stat()
    except FileNotFoundError:
        found = None
    except OSError as error:
        raise DamagedError(_unusable(path, f"{error.strerror}")) from None
    if writable and path.is_symlink():
        raise DamagedError(_unusable(path, "is a symbolic link, and its target is not written to"))
    if found is None or (found.st_size == 0 and stat.S_ISREG(found.st_mode)):
        if not writable:
            raise MissingError(f"{path}: holds no trial; fill the directory with `rmpc-bench run`")
        return True
    if not stat.S_ISREG(found.st_mode):
        raise DamagedError(_unusable(path, "is not a trial store (it is not a regular file)"))
    if not os.access(path, os.R_OK):
        raise DamagedError(_unusable(path, "cannot be read (permission denied)"))
    try:
        number = _format(path)
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        raise DamagedError(_unusable(path, f"is not a trial store ({error})")) from None
    if number is None:
        raise DamagedError(_unusable(path, "is not a trial store (it is a database of another program)"))
    if number != FORMAT:
        when = "an earlier" if number < FORMAT else "a later"
        way_out = "`rmpc-bench run --fresh` keeps it under another name and computes everything again"
        text = f"{path}: {when} version of rmpc-bench has written it (format {number}, here {FORMAT}); {way_out}"
        raise StoreError(text) if writable else MissingError(text)
    _check_journal(path)
    return False


def _format(path: Path) -> int | None:
    """Return the number of the format of a trial store; None for a database of somebody else."""
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as connection:
        [(application,)] = connection.execute("PRAGMA application_id").fetchall()
        if application == APPLICATION:
            [(number,)] = connection.execute("PRAGMA user_version").fetchall()
            return int(number)
        with _limited(connection, path.stat().st_size):
            rows = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
    return 1 if {name for (name,) in rows} >= _FIRST_TABLES else None


def _check_journal(path: Path) -> None:
    """Refuse the journal of a transaction over several databases: SQLite deletes the file that it names at its end."""
    # One that would make the file larger is refused, since no transaction of a store makes it smaller; and a symbolic
    # link, which SQLite cannot open. A store has no write-ahead log, which could make the file larger as well.
    log = path.with_name(f"{path.name}-wal")
    if log.is_symlink() or log.exists() and (not log.is_file() or log.stat().st_size):
        raise DamagedError(_unusable(path, f"a store has no {log.name}"))
    journal = path.with_name(f"{path.name}-journal")
    head = end = b""
    try:
        found = journal.lstat()
        is_journal = stat.S_ISREG(found.st_mode)
        if is_journal:
            with journal.open("rb") as file:
                head = file.read(28)
                file.seek(-min(found.st_size, len(_JOURNAL_MAGIC)), os.SEEK_END)
                end = file.read()
    except FileNotFoundError:
        return
    # Where the size of a page is 0, SQLite takes that of the file.
    n_bytes = int.from_bytes(head[16:20], "big") * (int.from_bytes(head[24:28], "big") or 65536)
    grows = head.startswith(_JOURNAL_MAGIC) and n_bytes > path.stat().st_size
    if not is_journal or end == _JOURNAL_MAGIC or grows:
        raise DamagedError(_unusable(path, f"{journal.name} is not the journal of a store"))


def _unusable(path: Path, text: str) -> str:
    return f"{path}: {text}; choose another -o DIR, or --fresh"


def is_there(directory: Path) -> bool:
    """Whether a directory has a store, whole or damaged, or cannot be looked into."""
    try:
        (directory / FILE).lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError:
        return True
    return True


def is_filled(directory: Path) -> bool:
    """Whether a directory has a store with content; a killed start may leave a file without a byte."""
    path = directory / FILE
    return path.exists() and not (path.is_file() and path.stat().st_size == 0)


def is_in_use(directory: Path) -> bool:
    """Whether another process writes to the store of a directory; a damaged one is not in use."""
    path = directory / FILE
    try:
        check_file(path, writable=True)
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", uri=True, timeout=0.0)) as connection:
            connection.execute("BEGIN EXCLUSIVE")
    except StoreError:
        return False
    except sqlite3.DatabaseError as error:
        return "locked" in str(error)
    return False


def connected(path: Path, *, writable: bool) -> sqlite3.Connection:
    """Open a store for one thread at a time, with the lock and the tables of a new file where it is to be written."""
    is_new = check_file(path, writable=writable)
    if is_new:
        # SQLite makes files that the group cannot write, whatever the process allows.
        os.close(os.open(path, os.O_CREAT | os.O_RDWR, 0o666))
    # Opened for writing if possible: the journal of a killed writer is rolled back before the first read.
    mode = "rwc" if writable else "rw" if os.access(path, os.W_OK) and not path.is_symlink() else "ro"
    connection = sqlite3.connect(
        f"{path.absolute().as_uri()}?mode={mode}",
        uri=True,
        timeout=0.0 if writable else READER_WAITS,
        isolation_level=None,
        check_same_thread=False,
    )
    try:
        _prepare(connection, path, writable=writable, is_new=is_new)
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        connection.close()
        raise translated(error, path) from None
    except BaseException:
        connection.close()
        raise
    return connection


def _prepare(connection: sqlite3.Connection, path: Path, *, writable: bool, is_new: bool) -> None:
    execute = connection.execute
    execute("PRAGMA trusted_schema = OFF")
    if not writable:
        execute("PRAGMA query_only = ON")
    else:
        execute("PRAGMA locking_mode = EXCLUSIVE")
        execute("PRAGMA journal_mode = DELETE")
        execute("BEGIN EXCLUSIVE")
        # A writer that was killed before its first commit has left a file without tables.
        if is_new or not execute("SELECT 1 FROM sqlite_master").fetchone():
            execute(f"PRAGMA application_id = {APPLICATION}")
            execute(f"PRAGMA user_version = {FORMAT}")
            for statement in filter(str.strip, SCHEMA.split(";")):
                execute(statement)
    _check_tables(connection, path)
    if writable:
        execute(LATER)
        execute("COMMIT")


def _check_tables(connection: sqlite3.Connection, path: Path) -> None:
    """Refuse a file that has anything but the tables of a store, each with the statement that makes it."""
    known = {text.split()[2]: " ".join(text.split()) for text in SCHEMA.split(";") if text.strip()}
    later = LATER.replace("IF NOT EXISTS ", "")
    with _limited(connection, path.stat().st_size):
        rows = connection.execute("SELECT type, name, sql FROM sqlite_master").fetchmany(100)
    for kind, name, text in rows:
        if kind == "index" and text is None:
            continue
        if kind != "table" or " ".join(str(text).split()) not in (known.pop(name, None), " ".join(later.split())):
            raise damaged(path.parent, f"no store has this {str(kind)[:20]} {str(name)[:60]!r}")
    if known:
        raise damaged(path.parent, f"it has no table {min(known)!r}")


def rows_of(connection: sqlite3.Connection, path: Path, query: str, parameters: tuple[Any, ...]) -> list[Any]:
    """Return the rows of a query, each value of the type and in the range that its column has."""
    [(pages,)] = connection.execute("PRAGMA page_count").fetchall()
    most = 4096 * int(pages)
    rows, n_bytes = list[Any](), 0
    with _limited(connection, most):
        cursor = connection.execute(query, parameters)
        names = [name for name, *_ in cursor.description]
        sized = [number for number, name in enumerate(names) if _TYPES.get(name) != {int}]
        if not sized:
            rows = cursor.fetchall()
        while part := cursor.fetchmany(50):
            rows += part
            n_bytes += sum(len(row[each]) for row in part for each in sized if type(row[each]) in (bytes, str))
            if n_bytes > 16 * most + 1_000_000:
                raise damaged(path.parent, "rows of a table refer to the same pages")
    for number, name in enumerate(names if rows else ()):
        _check_column(path.parent, query, name, [row[number] for row in rows])
    return rows


@contextmanager
def _limited(connection: sqlite3.Connection, n_bytes: int) -> Iterator[None]:
    """End a query that takes more steps than the rows of a file of this size can need."""
    # SQLite counts the steps of a statement over all its executions, so that one number as its limit is too small.
    calls = iter(range(20 + n_bytes // 20_000))
    connection.set_progress_handler(lambda: next(calls, None) is None, 100_000)
    try:
        yield
    finally:
        connection.set_progress_handler(None, 0)


def _check_column(directory: Path, query: str, name: str, column: Sequence[Any]) -> None:
    types, values = _TYPES.get(name, {str}), _RANGES.get(name)
    strange = set(map(type, column)) - types
    if strange:
        wrong = next(value for value in column if type(value) in strange)
    elif values is not None and not (min(column) >= values.start and max(column) < values.stop):
        wrong = next(value for value in column if value not in values)
    elif name == "largest" and not 0 <= min(column) <= max(column) < math.inf:
        wrong = next(value for value in column if not 0 <= value < math.inf)
    else:
        return
    table = re.search(r"FROM (\w+)", query)
    what = "text" if types == {str} else "bytes" if bytes in types else "a number"
    what = what if values is None else f"a whole number from {values.start} to {values.stop - 1}"
    raise damaged(directory, f"{table[1] if table else 'a table'}.{name} must be {what} (got {str(wrong)[:60]!r})")


def array_of(shape: str, data: bytes, most: int) -> Array:
    """Unpack an array; it takes no more room than its shape says, nor than ``most`` numbers."""
    import numpy as np

    sizes = json.loads(shape) if re.fullmatch(r"\[(\d{1,10}, )*\d{0,10}\]", shape[:100]) else None
    if sizes is None or not all(n <= most for n in sizes):
        raise ValueError(f"arrays.shape must be a list of sizes (got {shape[:60]!r})")
    n_bytes = 8 * math.prod(sizes)
    if n_bytes > 8 * most:
        raise ValueError(f"arrays.shape has more than {most} entries (got {shape[:60]!r})")
    unpacked = zlib.decompressobj().decompress(data, n_bytes + 1)
    if len(unpacked) != n_bytes:
        raise ValueError(f"arrays.data has not the {n_bytes} bytes of its shape {shape}")
    return np.frombuffer(unpacked, dtype="<f8").reshape(sizes)


def translated(error: sqlite3.DatabaseError | UnicodeDecodeError, path: Path) -> Exception:
    """Return the error of SQLite as one of these."""
    text = str(error)
    if isinstance(error, UnicodeDecodeError) or "Could not decode" in text:
        return damaged(path.parent, "a text is not UTF-8")
    if "locked" in text:
        return OccupiedError(f"{path}: another process writes to it; wait for it to end, or choose another -o DIR")
    if "interrupted" in text or "overflow" in text:
        return damaged(path.parent, "rows of a table refer to each other, or their numbers are too large")
    if any(part in text for part in ("not a database", "no such table", "no such column", "malformed", "corrupt")):
        return DamagedError(_unusable(path, f"is not a trial store ({text})"))
    return WriteError(f"{path}: {text}")
