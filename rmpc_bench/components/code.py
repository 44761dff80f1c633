"""Names of things in a user's files, as a configuration writes them: ``PATH.py:NAME`` and patterns of data files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

_REFERENCE = re.compile(r"(?P<file>.+\.py):(?P<name>[^\W\d]\w*(\.[^\W\d]\w*)*)")


@dataclass(frozen=True)
class CodeReference:
    """Something in a Python file of the user.

    Parameters
    ----------
    path : the file, absolute, symbolic links resolved
    name : the name in the file, with dots inside a class
    text : ``PATH.py:NAME`` with the path relative to the directory of the configuration
    """

    path: Path
    name: str
    text: str

    @property
    def file(self) -> str:
        """The file as messages show it."""
        return self.text.rpartition(":")[0]


@dataclass(frozen=True)
class DataReference:
    """Data files that a key names.

    Parameters
    ----------
    text : path or pattern, relative to the directory of the configuration
    paths : the files, absolute, links resolved, in the order of their names before that
    """

    text: str
    paths: tuple[Path, ...]


class Place(NamedTuple):
    """A place in a Python file; line and column count from 1."""

    file: str
    line: int
    column: int


class CodeError(ValueError):
    """A file of the user cannot be used; `place` in it is to blame, or the configuration where it is None."""

    def __init__(self, message: str, place: Place | None = None) -> None:
        self.place = place
        super().__init__(message)

    @property
    def line(self) -> str:
        """The message with its place in the Python file."""
        return str(self) if self.place is None else f"{self.place.file}:{self.place.line}: {self}"


def split_reference(text: str) -> tuple[str, str] | None:
    """Return the file and the name of a text ``PATH.py:NAME``; None for any other text.

    Examples
    --------
    >>> split_reference("my parts/tanks.py:MHE")
    ('my parts/tanks.py', 'MHE')
    """
    found = _REFERENCE.fullmatch(text)
    return None if found is None else (found["file"], found["name"])


def is_reference(value: object) -> bool:
    """Whether a value of a configuration has the form ``PATH.py:NAME``."""
    return isinstance(value, str) and split_reference(value) is not None
