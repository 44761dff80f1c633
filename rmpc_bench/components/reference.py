"""Names of things in files: ``PATH.py:NAME``, patterns of data files, modules and whether they are installed."""

from __future__ import annotations

import re
import sys
import sysconfig
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec
from pathlib import Path
from typing import NamedTuple

from rmpc_bench.components.imports import Import

_REFERENCE = re.compile(r"(?P<file>.+\.py):(?P<name>[^\W\d]\w*(\.[^\W\d]\w*)*)")


@dataclass(frozen=True)
class CodeReference:
    """Something in a Python file of the user."""

    path: Path  # the file, absolute, symbolic links resolved
    name: str  # the name in the file, with dots inside a class
    text: str  # ``PATH.py:NAME`` with the path relative to the directory of the configuration

    @property
    def file(self) -> str:
        """The file as messages show it."""
        return self.text.rpartition(":")[0]


@dataclass(frozen=True)
class DataReference:
    """Data files that a key names."""

    text: str  # path or pattern, relative to the directory of the configuration
    paths: tuple[Path, ...]  # the files, absolute, links resolved, in the order of their names before that


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


_OWN = "rmpc_bench"
_INSTALLED = ("site-packages", "dist-packages")
_found_installed: set[str] = set()
"""Modules that this process has found to be installed."""


def is_standard(module: str) -> bool:
    """Whether a module belongs to the standard library or to the bench itself."""
    return module in sys.stdlib_module_names or module == _OWN


def spec_of(module: str) -> ModuleSpec | None:
    """Find a module; `sys.modules` is not asked, where another file may have a module of this name."""
    found = (finder.find_spec(module, None) for finder in sys.meta_path if hasattr(finder, "find_spec"))
    return next((spec for spec in found if spec is not None), None)


def local_directory(module: str) -> Path | None:
    """Return the directory on the path of Python in which a module lies that is not installed there.

    Such a module is found through PYTHONPATH, the current directory or an editable installation: its source may change
    while its version does not.
    """
    if is_standard(module) or module in _found_installed:
        return None
    spec = spec_of(module)
    inside = [] if spec is None else list(spec.submodule_search_locations or ())
    if spec is None or not (spec.has_location or inside):
        return None
    # A package lies one level deeper than its directory; one without __init__.py has no file.
    place = Path(inside[0]).parent if inside else Path(str(spec.origin)).parent
    if not _is_installed(place):
        return place.absolute()
    # An installed module stays where it is; a local one may be added at any time.
    _found_installed.add(module)
    return None


def _is_installed(directory: Path) -> bool:
    standard = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib")}
    return any(part in _INSTALLED for part in directory.parts) or str(directory) in standard


@lru_cache(maxsize=256)
def distribution_of(module: str) -> tuple[str, str] | None:
    """Return name and version of the distribution that provides a module; None where there is none."""
    from importlib.metadata import PackageNotFoundError, packages_distributions, version

    try:
        # Most distributions have the name of their module; to look in all of them takes half a second.
        return _canonical(module), version(module)
    except PackageNotFoundError:
        pass
    for name in packages_distributions().get(module, ()):
        return _canonical(name), version(name)
    return None


def _canonical(name: str) -> str:
    return name.lower().replace("_", "-").replace(".", "-")


def module_files(directory: Path, statement: Import) -> list[Path]:
    """Return the files that an import statement executes; empty where the module does not lie in the directory.

    Every package on the way is executed, and of ``from package import name`` the module `name` where there is one.
    A star imports what ``__all__`` names, so that all modules of the package count.
    """
    # The package of a relative import has been executed, too.
    files = [directory / "__init__.py"] if statement.level and (directory / "__init__.py").is_file() else []
    for step in statement.module.split(".") if statement.module else ():
        found = module_file(directory, step)
        if found is not None:
            files.append(found)
        if found is not None and found.name != "__init__.py":
            return files
        directory = directory / step
        if not directory.is_dir():
            # A name that is no module: an attribute of the package, or nothing at all.
            return files
    for name in statement.names:
        if name == "*":
            files += sorted(directory.glob("*.py")) if statement.module or statement.level else []
        elif (found := module_file(directory, name)) is not None:
            files.append(found)
    return files


def module_file(directory: Path, name: str, is_there: Callable[[Path], bool] = Path.is_file) -> Path | None:
    """Return the file of a module in a directory, in the order of Python: a compiled module before its source."""
    candidates = (directory / name / "__init__.py", *(directory / f"{name}{suffix}" for suffix in EXTENSION_SUFFIXES))
    return next(filter(is_there, (*candidates, directory / f"{name}.py")), None)
