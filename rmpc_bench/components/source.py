"""The identity of a Python file: a hash of the file and of every local module that it imports.

Modules are found from the text alone; nothing is imported.  A local module lies beside the file, or on the path of
Python without being installed.  A path is never part of the hash, except that of a module relative to the file.
"""

from __future__ import annotations

import ast
import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

from rmpc_bench.components.imports import Import, Place, References, references
from rmpc_bench.components.installed import is_standard, local_directory
from rmpc_bench.components.module_files import module_files
from rmpc_bench.components.syntax import syntax_hash
from rmpc_bench.extras import EXTRAS
from rmpc_bench.types import Problem

_ADAPTERS = Path(__file__).resolve().parents[1] / "adapters"
"""Directory of the adapters, through which a file may use a library without an import of it."""


class SourceFile(NamedTuple):
    """A file of which an edit changes the hash."""

    path: Path
    place: str
    """Its path relative to the directory of the first file, or its path as a module if found on the path of Python."""
    digest: str
    """Of the syntax tree of a Python file, of the bytes of any other."""
    content: bytes
    """What was read."""
    beside: bool = True
    """Whether it was found from the first file; otherwise on the path of Python."""


@dataclass(frozen=True, eq=False)
class Source:
    """A Python file with every file that it depends on.

    Parameters
    ----------
    path : the file
    files : the file itself, then all others by place
    modules : names of the imported modules that are neither local nor of the standard library, and of the libraries
        that are imported through the bench
    problems : errors of the files: syntax, a file under `depends_on` that is not there
    warnings : places where the syntax tree cannot show what the code depends on
    readings : places where a file is read whose name is no literal; it may be a data file that a key names
    """

    path: Path
    files: tuple[SourceFile, ...]
    modules: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()
    warnings: tuple[Problem, ...] = ()
    readings: tuple[Problem, ...] = ()

    @cached_property
    def sha(self) -> str:
        """SHA-256 of all files; the name of the first one does not count."""
        others = (f"{each.place} {each.digest}" for each in self.files[1:])
        return text_hash([self.files[0].digest, *others])

    @cached_property
    def copies(self) -> dict[str, SourceFile]:
        """Path in a directory of copies -> file; the paths relative to each other are kept."""
        # A file above that of the first one needs the directories between them, by their names.
        above = max(Path(each.place).parts.count("..") for each in self.files)
        first = Path(*self.path.parent.parts[len(self.path.parent.parts) - above :])
        return {Path(os.path.normpath(first / each.place)).as_posix(): each for each in self.files}

    @property
    def copy(self) -> str:
        """Path of the first file in a directory of copies."""
        return next(iter(self.copies))

    @property
    def folder(self) -> str:
        """Name of the directory of its copies."""
        return folder_of(self.sha)

    @property
    def short(self) -> str:
        """The first six digits of `sha`, for messages."""
        return self.sha[:6]


def read_source(path: Path, read: Callable[[Path], bytes] = Path.read_bytes) -> Source:
    """Return the identity of a Python file; nothing is imported.  An OSError says that a file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "pi.py"
    >>> _ = path.write_text("K = 0.5  # gain")
    >>> before = read_source(path).sha
    >>> _ = path.write_text("K  =  0.5")
    >>> read_source(path).sha == before
    True
    """
    search = _Search(path.resolve(), read)
    search.follow()
    return search.source()


def folder_of(sha: str) -> str:
    """Return the name of the directory of the copies of a source."""
    return sha[:16]


def data_hash(path: Path) -> str:
    """Return the SHA-256 of the bytes of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def text_hash(texts: Iterable[str]) -> str:
    """Return the SHA-256 of a list of texts."""
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


class _Parsed(NamedTuple):
    digest: str
    found: References
    wrong: tuple[Place, ...] = ()
    """Where the text is no Python."""


# The text is the key, not the time of the last change: two edits may have the same time and length.
@lru_cache(maxsize=256)
def _parsed(text: bytes) -> _Parsed:
    try:
        tree = ast.parse(text)
        return _Parsed(syntax_hash(tree), references(tree))
    except SyntaxError as error:
        wrong = Place(error.lineno or 1, error.offset or 1, f"is not valid Python: {error.msg}")
    except (ValueError, RecursionError, MemoryError) as error:
        wrong = Place(1, 1, f"is not valid Python: {error}")
    return _Parsed(hashlib.sha256(text).hexdigest(), References((), (), (), ()), (wrong,))


class _Found(NamedTuple):
    """A file to read."""

    path: Path
    base: Path
    """Directory in which the modules that it imports are looked up."""
    beside: bool


@dataclass
class _Search:
    """Follows the imports of a file."""

    top: Path
    read: Callable[[Path], bytes]
    files: dict[Path, SourceFile] = field(default_factory=dict)
    modules: set[str] = field(default_factory=set)
    problems: list[Problem] = field(default_factory=list)
    warnings: set[Problem] = field(default_factory=set)
    readings: set[Problem] = field(default_factory=set)

    def source(self) -> Source:
        """Return what was found."""
        first = self.files.pop(self.top)
        others = sorted(self.files.values(), key=lambda file: (file.place, file.digest))
        problems, warnings, readings = (tuple(sorted(each)) for each in (self.problems, self.warnings, self.readings))
        return Source(self.top, (first, *others), tuple(sorted(self.modules)), problems, warnings, readings)

    def follow(self) -> None:
        """Read the file and all that it imports."""
        waiting = [_Found(self.top, self.top.parent, True)]
        while waiting:
            found = waiting.pop()
            if found.path not in self.files:
                waiting += self._files_of(found)

    def _files_of(self, found: _Found) -> list[_Found]:
        """Read a file and return those that it imports."""
        content = self.read(found.path)
        if found.path.suffix != ".py":
            self._add(found, hashlib.sha256(content).hexdigest(), content)
            return []
        parsed = _parsed(content)
        self._add(found, parsed.digest, content)
        self.problems += [_problem(found.path, wrong) for wrong in parsed.wrong]
        self._add_data(found, parsed.found)
        self.modules |= _modules_of(parsed.found)
        self._note_hidden(found.path, parsed.found)
        return [file for each in parsed.found.imports for file in self._imported(found, each)]

    def _add(self, found: _Found, digest: str, content: bytes) -> None:
        base = self.top.parent if found.beside else found.base
        place = Path(os.path.relpath(found.path, base)).as_posix()
        self.files[found.path] = SourceFile(found.path, place, digest, content, found.beside)

    def _add_data(self, found: _Found, references: References) -> None:
        """Add the files under `depends_on`."""
        path = found.path
        for wrong in references.wrong:
            self.problems.append(_problem(path, wrong, "depends_on must be a list of names of files"))
        for entry in references.depends_on:
            data = Path(os.path.normpath(path.parent / entry.text))
            if not data.is_file():
                self.problems.append(_problem(path, entry, f"depends_on: there is no file {entry.text!r} beside it"))
            elif data not in self.files:
                content = self.read(data)
                self._add(found._replace(path=data), hashlib.sha256(content).hexdigest(), content)

    def _note_hidden(self, path: Path, references: References) -> None:
        """Warn of code that the syntax tree cannot show, and of files that `depends_on` does not name."""
        named = {entry.text for entry in references.depends_on}
        for place, reads, argument in references.hidden:
            # Who names files has thought of those whose names are made while the program runs.
            if reads and (argument in named or (argument is None and named)):
                continue
            what = "the file that it reads" if reads else "what comes from there"
            way_out = "name the files in depends_on = [...]"
            text = f"{place.text}: results stay stored when {what} changes; {way_out}"
            noted = self.readings if reads and argument is None else self.warnings
            noted.add(_problem(path, place, text))

    def _imported(self, found: _Found, each: Import) -> Iterator[_Found]:
        """Yield the local files that an import statement executes."""
        if each.level:
            package = Path(os.path.normpath(found.path.parent / Path(*[".."] * (each.level - 1))))
            yield from (found._replace(path=file) for file in module_files(package, each))
            return
        # The own directory too, since a module may have been put on the path of Python by hand.
        for base in dict.fromkeys((found.base, found.path.parent)):
            if files := module_files(base, each):
                yield from (found._replace(path=file) for file in files)
                return
        name = each.module.partition(".")[0]
        self.modules |= _modules_of_adapters(each)
        directory = local_directory(name)
        if directory is not None:
            yield from (_Found(file, directory, False) for file in module_files(directory, each))
        elif not is_standard(name):
            self.modules.add(name)


def _modules_of(found: References) -> set[str]:
    """Return the modules of the optional libraries that a file imports by their extras."""
    return {EXTRAS[extra] for extra in found.extras if extra in EXTRAS}


def _modules_of_adapters(statement: Import) -> set[str]:
    """Return the modules of the libraries behind the adapters that a statement imports, also through one another."""
    waiting, seen, modules = [statement], set[Path](), set[str]()
    while waiting:
        each = waiting.pop()
        files = module_files(_ADAPTERS.parents[1], each) if each.module.startswith(_ADAPTERS.parent.name) else []
        for file in files:
            if file.parent == _ADAPTERS and file not in seen:
                seen.add(file)
                found = _parsed(file.read_bytes()).found
                modules |= _modules_of(found)
                waiting += found.imports
    return modules


def _problem(path: Path, place: Place, text: str = "") -> Problem:
    return Problem(str(path), place.line, place.column, "", text or place.text)
