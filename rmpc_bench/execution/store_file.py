"""What the first bytes of a file say: whether it is a trial store, of which format, or a file of somebody else.

The bytes are read without SQLite, because opening a database may change it.
"""

from __future__ import annotations

import sqlite3
import stat
from contextlib import closing
from pathlib import Path

FILE = "trials.sqlite"
APPLICATION = 0x524D5043
"""Number in the header of the file that marks a trial store (the letters RMPC)."""
FORMAT = 2
"""Number of the format, which the header of the file holds."""
_MAGIC = b"SQLite format 3\x00"
_HEADER = 100
_FORMAT_AT, _APPLICATION_AT = 60, 68
_FIRST_TABLES = {"meta", "trials", "metrics", "uncertainty"}
"""Tables of the first format, which did not number itself."""


class StoreError(Exception):
    """A directory that cannot be used: it holds another experiment, or another process writes to it."""


class OccupiedError(StoreError):
    """Another process writes to the store."""


class MissingError(Exception):
    """A directory without trials, or without what a report needs beside them."""


def check_file(path: Path, *, writable: bool) -> bool:
    """Refuse a file that is not a trial store of this format, and leave it as it is.

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
        if not stat.S_ISREG(found.st_mode):
            raise StoreError(_no_store(path, "it is not a regular file"))
        if found.st_size:
            with path.open("rb") as file:
                _check_header(path, file.read(_HEADER), writable=writable)
            return False
    except FileNotFoundError:
        pass
    except PermissionError as error:
        raise StoreError(f"{path}: {error.strerror}; choose another -o DIR, or --fresh") from None
    if not writable:
        raise MissingError(f"{path}: holds no trial; fill the directory with `rmpc-bench run`")
    return True


def _check_header(path: Path, header: bytes, *, writable: bool) -> None:
    if len(header) < _HEADER or not header.startswith(_MAGIC):
        raise StoreError(_no_store(path, "file is not a database"))
    number = int.from_bytes(header[_FORMAT_AT : _FORMAT_AT + 4], "big")
    if int.from_bytes(header[_APPLICATION_AT : _APPLICATION_AT + 4], "big") != APPLICATION:
        if not _is_of_first_format(path):
            raise StoreError(_no_store(path, "it is a database of another program"))
        number = 1
    if number != FORMAT:
        when = "an earlier" if number < FORMAT else "a later"
        way_out = "`rmpc-bench run --fresh` keeps it under another name and computes everything again"
        text = f"{path}: {when} version of rmpc-bench has written it (format {number}, here {FORMAT}); {way_out}"
        raise StoreError(text) if writable else MissingError(text)


def _is_of_first_format(path: Path) -> bool:
    """Whether a database has the tables of the first format; the file is read without its journal and not locked."""
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as connection:
            rows = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
    except sqlite3.DatabaseError:
        return False
    return {name for (name,) in rows} >= _FIRST_TABLES


def _no_store(path: Path, text: str) -> str:
    return f"{path}: is not a store of trials ({text}); choose another -o DIR, or --fresh"
