"""What kind of file a trials.sqlite is: a trial store and of which format, a damaged file, or one of somebody else.

Looking at a file leaves it as it is: it is read without its journal and is not locked.  It is opened by SQLite only,
because a process that closes a file which it has opened in another way loses the locks that SQLite holds on it.
"""

from __future__ import annotations

import os
import sqlite3
import stat
from contextlib import closing
from pathlib import Path

FILE = "trials.sqlite"
APPLICATION = 0x524D5043
"""Number in the header of the file that marks a trial store (the letters RMPC)."""
FORMAT = 2
"""Number of the format, which the header of the file holds."""
_JOURNAL_MAGIC = bytes.fromhex("d9d505f920a163d7")
_FIRST_TABLES = {"meta", "trials", "metrics", "uncertainty"}
"""Tables of the first format, which did not number itself."""


class StoreError(Exception):
    """A directory that cannot be used: it holds another experiment, or another process writes to it."""


class OccupiedError(StoreError):
    """Another process writes to the store."""


class MissingError(Exception):
    """A directory without trials, or without what a report needs beside them."""


def check_file(path: Path, *, writable: bool) -> bool:
    """Refuse a file that is not a trial store of this format.

    Parameters
    ----------
    path : the file
    writable : whether it is to be written; a file that is not there or empty is refused otherwise

    Returns
    -------
    whether the tables of the store must be made

    Raises
    ------
    StoreError
        If it is a file of somebody else, of another format, or damaged.
    MissingError
        If there is nothing to read, or only what another version has written.
    """
    try:
        found = path.stat()
    except FileNotFoundError:
        found = None
    except PermissionError as error:
        raise StoreError(_unusable(path, f"{error.strerror}")) from None
    if found is None or (found.st_size == 0 and stat.S_ISREG(found.st_mode)):
        if not writable:
            raise MissingError(f"{path}: holds no trial; fill the directory with `rmpc-bench run`")
        return True
    if not stat.S_ISREG(found.st_mode):
        raise StoreError(_unusable(path, "is not a trial store (it is not a regular file)"))
    if not os.access(path, os.R_OK):
        raise StoreError(_unusable(path, "cannot be read (permission denied)"))
    try:
        number = _format(path)
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        raise StoreError(_unusable(path, f"is not a trial store ({error})")) from None
    if number is None:
        raise StoreError(_unusable(path, "is not a trial store (it is a database of another program)"))
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
        rows = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
    return 1 if {name for (name,) in rows} >= _FIRST_TABLES else None


def _check_journal(path: Path) -> None:
    """Refuse the journal of a transaction over several databases: SQLite deletes the file that it names at its end."""
    journal = path.with_name(f"{path.name}-journal")
    end = b""
    try:
        is_journal = stat.S_ISREG(journal.stat().st_mode)
        if is_journal:
            with journal.open("rb") as file:
                file.seek(-min(journal.stat().st_size, len(_JOURNAL_MAGIC)), os.SEEK_END)
                end = file.read()
    except FileNotFoundError:
        return
    if not is_journal or end == _JOURNAL_MAGIC:
        raise StoreError(_unusable(path, f"{journal.name} is not the journal of a store"))


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


def is_in_use(directory: Path) -> bool:
    """Whether another process writes to the store of a directory; a damaged one is not in use."""
    path = directory / FILE
    try:
        check_file(path, writable=True)
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=rw", uri=True, timeout=0.0)) as connection:
            connection.execute("BEGIN EXCLUSIVE")
    except (StoreError, sqlite3.DatabaseError) as error:
        return "locked" in str(error)
    return False
