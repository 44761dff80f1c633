"""Files of results: each is replaced as a whole, none through a symbolic link and none outside a named directory.

A directory of results may come from somebody else; `report` then writes no file outside it.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_INSIDE: ContextVar[tuple[Path, ...]] = ContextVar("_INSIDE", default=())


@contextmanager
def inside(directory: Path) -> Iterator[None]:
    """Refuse to write anything outside a directory, all links resolved, whatever the names of the files are made of."""
    refuse_outside(directory)
    token = _INSIDE.set((*_INSIDE.get(), directory.resolve()))
    try:
        yield
    finally:
        _INSIDE.reset(token)


def refuse_outside(directory: Path) -> None:
    """Raise `OSError` for a directory that does not lie inside all that `inside` names."""
    place = directory.resolve()
    for allowed in _INSIDE.get():
        if not place.is_relative_to(allowed):
            raise OSError(f"{directory} lies outside of {allowed}; nothing is written there")


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield a file to write, in the same directory, which takes the place of `path` at the end.

    If writing fails, an earlier file stays as it is.  If `path` is a symbolic link, the link is replaced.
    """
    refuse_outside(path.parent)
    # Processes of several machines may write to one directory.
    partial = path.with_name(f".{path.stem}.{platform.node()}-{os.getpid()}{path.suffix}")
    partial.unlink(missing_ok=True)
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def replace_text(path: Path, text: str) -> None:
    """Write a text with the line ends that it has, see `replaced`."""
    with replaced(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


def folder(directory: Path, name: str) -> Path:
    """Return a directory in one of results, made if it is not there; `OSError` where it is a symbolic link."""
    path = directory / name
    if path.is_symlink():
        raise OSError(f"{path} is a symbolic link; replace it by a directory")
    refuse_outside(path)
    path.mkdir(parents=True, exist_ok=True)
    return path
