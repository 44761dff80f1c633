"""Content of a file that is named by a user or lies in a directory of somebody else.

A pipe without a writer would never end, and a device such as /dev/zero has no end: only regular files of limited size
are read.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MAX_BYTES = 10_000_000
"""Largest size of a file of a configuration or of an experiment's record [bytes]."""


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
    return content


def text_of(path: str | Path, max_bytes: int = MAX_BYTES) -> str:
    """Read a regular file as UTF-8; see `content_of`.

    Raises
    ------
    UnicodeDecodeError
        If it is no such text.
    """
    return content_of(path, max_bytes).decode("utf-8")
