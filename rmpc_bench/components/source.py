"""The identity of a Python file: a hash of it and of every local module that it imports, found from the text alone."""

from __future__ import annotations

import ast
import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from rmpc_bench.components.imports import Import, Place, References, references
from rmpc_bench.components.reference import is_standard, local_directory, module_files
from rmpc_bench.extras import EXTRAS
from rmpc_bench.types import Problem

_WITH_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_NO_MEANING = frozenset({"kind", "type_comment", "type_ignores"})
"""Fields that change nothing: the prefix of ``u"text"`` and comments with types."""


def syntax_hash(tree: ast.AST) -> str:
    """Return the SHA-256 of a syntax tree without `pass`, and without docstrings unless the file reads ``__doc__``.

    It is the same in all versions of Python that can read the file, unlike the text of `ast.dump`: empty and missing
    fields are left out, since later versions add fields, and text is in ASCII, since `repr` follows the Unicode tables.
    """
    with_docstrings = any(_reads_docstrings(node) for node in ast.walk(tree))
    hasher = hashlib.sha256()
    # A stack, since a long sum is a deep tree.
    stack: list[Any] = [tree]
    while stack:
        item = stack.pop()
        if isinstance(item, ast.AST):
            fields = _fields(item, with_docstrings)
            hasher.update(f"{type(item).__name__} {len(fields)}\n".encode())
            for name, value in reversed(fields):
                stack += [value, _Name(name)]
        elif isinstance(item, list):
            hasher.update(f"[{len(item)}\n".encode())
            stack += reversed(item)
        else:
            hasher.update(f"{_text(item)}\n".encode())
    return hasher.hexdigest()


class _Name(str):
    """Name of a field."""


def _reads_docstrings(node: ast.AST) -> bool:
    return (isinstance(node, ast.Name) and node.id == "__doc__") or (
        isinstance(node, ast.Attribute) and node.attr in ("__doc__", "getdoc")
    )


def _fields(node: ast.AST, with_docstrings: bool) -> list[tuple[str, Any]]:
    """Return the fields that have a value, sorted by name, since later versions of Python may insert some."""
    found = []
    for name in sorted(set(node._fields) - _NO_MEANING):
        value = getattr(node, name, None)
        if name == "value" and isinstance(node, ast.Constant):
            # None is a value here.
            found.append((name, value))
            continue
        if isinstance(value, list):
            value = _entries(node, name, value, with_docstrings)
        elif name == "format_spec" and isinstance(value, ast.JoinedStr):
            # An empty format and no format are one; versions of Python write it differently.
            value = value if _joined(value.values) else None
        if value is not None and value != []:
            found.append((name, value))
    return found


def _entries(node: ast.AST, name: str, entries: list[Any], with_docstrings: bool) -> list[Any]:
    """Return the entries of a list that change something."""
    if isinstance(node, ast.JoinedStr):
        return _joined(entries)
    if name == "body" and isinstance(node, _WITH_DOCSTRING) and not with_docstrings:
        entries = entries[ast.get_docstring(node, clean=False) is not None :]
    return [entry for entry in entries if not isinstance(entry, ast.Pass)]


def _joined(parts: list[Any]) -> list[Any]:
    """Join neighbouring texts of a formatted string, and leave out empty ones."""
    found: list[Any] = []
    for part in parts:
        text = part.value if isinstance(part, ast.Constant) else None
        if isinstance(text, str) and found and isinstance(found[-1], str):
            found[-1] += text
        elif text != "":
            found.append(part if text is None else text)
    return found


def _text(value: Any) -> str:
    """Write a constant with its type, so that 1, 1.0, True and "1" differ."""
    if isinstance(value, _Name):
        return f".{value}"
    # Decimal digits of a long integer are refused by Python.
    written = hex(value) if type(value) is int else ascii(value)
    return f"{type(value).__name__} {written}"


_DYNAMIC = frozenset({"globals", "locals", "vars", "exec", "eval", "__import__", "import_module", "__getattr__"})
"""Names with which code reaches names that the syntax tree does not show."""
_ALWAYS = frozenset({"depends_on", "deterministic"})
"""Names that the bench itself reads from a file."""


def reached_text(text: bytes, names: Iterable[str]) -> bytes:
    """Return the statements of a file on which some names depend; all of it where the syntax tree cannot show that.

    Examples
    --------
    >>> reached_text(b"K = 0.5; g = 9.81; fall = lambda t: g * t; gain = K", ["fall"]).decode().splitlines()
    ['g = 9.81', 'fall = lambda t: g * t']
    """
    try:
        body = ast.parse(text).body
    except (SyntaxError, ValueError, RecursionError):
        return text
    used = [_used(statement) for statement in body]
    bound = [_bound(statement) for statement in body]
    wanted = {name.partition(".")[0] for name in names} | _ALWAYS
    known = set().union(*bound) if bound else set()
    if any(each & _DYNAMIC for each in used) or not wanted - _ALWAYS <= known or "*" in known:
        return text
    kept = {number for number, statement in enumerate(body) if not _is_definition(statement)}
    for number in kept:
        wanted |= used[number]
    while more := {number for number in range(len(body)) if number not in kept and bound[number] & wanted}:
        kept |= more
        for number in more:
            wanted |= used[number]
    found = ast.Module([body[number] for number in sorted(kept)], [])
    return ast.unparse(found).encode()


def _is_definition(statement: ast.stmt) -> bool:
    """Whether a statement does nothing but bind names; a docstring does not even that."""
    if isinstance(statement, ast.ImportFrom) and statement.module == "__future__":
        return False
    if isinstance(statement, ast.Expr):
        return isinstance(statement.value, ast.Constant)
    simple = isinstance(statement, ast.Assign) and all(isinstance(each, ast.Name) for each in statement.targets)
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Import, ast.ImportFrom)
    return (
        simple
        or isinstance(statement, kinds)
        or (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name))
    )


def _bound(statement: ast.stmt) -> set[str]:
    """Return the names that a statement of a module binds."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {statement.name}
    found: set[str] = set()
    for node in ast.walk(statement):
        if isinstance(node, ast.Import | ast.ImportFrom):
            found |= {each.asname or each.name.partition(".")[0] for each in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
    return found


def _used(statement: ast.stmt) -> set[str]:
    """Return the names that occur in a statement, also as text, since a name may be looked up by its text."""
    found: set[str] = set()
    for node in ast.walk(statement):
        if isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.isidentifier():
            found.add(node.value)
    return found


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
    """A Python file with every file that it depends on."""

    path: Path
    files: tuple[SourceFile, ...]  # the file itself, then all others by place
    # names of the imported modules that are neither local nor of the standard library, and of the libraries that are
    # imported through the bench
    modules: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()  # errors of the files: syntax, a file under `depends_on` that is not there
    warnings: tuple[Problem, ...] = ()  # places where the syntax tree cannot show what the code depends on
    # places where a file is read whose name is no literal; it may be a data file that a key names
    readings: tuple[Problem, ...] = ()

    @cached_property
    def sha(self) -> str:
        """SHA-256 of all files; the name of the first one does not count."""
        others = (f"{each.place} {each.digest}" for each in self.files[1:])
        return hashlib.sha256("\n".join([self.files[0].digest, *others]).encode()).hexdigest()

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
    """Return the identity of a Python file; nothing is imported.  An OSError says that a file cannot be read."""
    return _Search(path.resolve(), read).source()


def folder_of(sha: str) -> str:
    """Return the name of the directory of the copies of a source."""
    return sha[:16]


def data_hash(path: Path) -> str:
    """Return the SHA-256 of the bytes of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class _Parsed(NamedTuple):
    digest: str
    found: References
    wrong: tuple[Place, ...] = ()  # where the text is no Python


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
    base: Path  # directory in which the modules that it imports are looked up
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
        """Read the file and all that it imports."""
        waiting = [_Found(self.top, self.top.parent, True)]
        while waiting:
            found = waiting.pop()
            if found.path not in self.files:
                waiting += self._files_of(found)
        first = self.files.pop(self.top)
        others = sorted(self.files.values(), key=lambda file: (file.place, file.digest))
        problems, warnings, readings = (tuple(sorted(each)) for each in (self.problems, self.warnings, self.readings))
        return Source(self.top, (first, *others), tuple(sorted(self.modules)), problems, warnings, readings)

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
