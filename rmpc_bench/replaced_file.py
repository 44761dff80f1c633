"""Files of results: each is replaced as a whole, and none is written through a symbolic link.

A directory of results may come from somebody else; `report` then writes no file outside it.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield a file to write, in the same directory, which takes the place of `path` at the end.

    If writing fails, an earlier file stays as it is.  If `path` is a symbolic link, the link is replaced.

    Parameters
    ----------
    path : the file; its ending is that of the file to write
    """
    # Processes of several machines may write to one directory.
    partial = path.with_name(f".{path.stem}.{platform.node()}-{os.getpid()}{path.suffix}")
    partial.unlink(missing_ok=True)
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def replace_text(path: Path, text: str) -> None:
    """Write a text with the line ends that it has.

    Parameters
    ----------
    path : the file, see `replaced`
    text : its content
    """
    with replaced(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


def folder(directory: Path, name: str) -> Path:
    """Return a directory in a directory of results, made if it is not there.

    Parameters
    ----------
    directory : of results
    name : of the directory in it

    Raises
    ------
    OSError
        If it is a symbolic link, as its files would be outside of the results.
    """
    path = directory / name
    if path.is_symlink():
        raise OSError(f"{path} is a symbolic link; replace it by a directory")
    path.mkdir(parents=True, exist_ok=True)
    return path
