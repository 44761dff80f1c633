"""Content of a file that is named by a user or lies in a directory of somebody else.

A pipe without a writer would never end, and a device such as /dev/zero has no end: only regular files of limited size
are read.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from hashlib import sha256
from pathlib import Path

MAX_BYTES = 10_000_000
"""Largest size of a file of a configuration or of an experiment's record [bytes]."""
_NOTES: ContextVar[dict[str, str] | None] = ContextVar("_NOTES", default=None)


@contextmanager
def noted() -> Iterator[dict[str, str]]:
    """Note the files that are read in the block, so that a later process sees whether any of them has changed.

    Yields
    ------
    Absolute path -> SHA-256 of what was read; empty for a file that was looked for and is not there.
    """
    notes: dict[str, str] = {}
    token = _NOTES.set(notes)
    try:
        yield notes
    finally:
        _NOTES.reset(token)


def note_absent(path: Path) -> None:
    """Note that a file is not there, where another is read in its place."""
    notes = _NOTES.get()
    if notes is not None:
        notes[os.path.abspath(path)] = ""


def content_of(path: str | Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Read a regular file.

    Parameters
    ----------
    path : the file
    max_bytes : its largest size

    Raises
    ------
    OSError
        If it cannot be read, is not a regular file or is larger.
    """
    # Without O_NONBLOCK, opening a pipe waits for a writer.
    number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with open(number, "rb") as file:
        mode = os.fstat(number).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "is not a regular file", str(path))
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise OSError(errno.EFBIG, f"is larger than {max_bytes / 1e6:g} MB", str(path))
    notes = _NOTES.get()
    if notes is not None:
        notes[os.path.abspath(path)] = sha256(content).hexdigest()
    return content


def text_of(path: str | Path, max_bytes: int = MAX_BYTES) -> str:
    """Read a regular file as UTF-8; see `content_of`.

    Raises
    ------
    UnicodeDecodeError
        If it is no such text.
    """
    return content_of(path, max_bytes).decode("utf-8")
