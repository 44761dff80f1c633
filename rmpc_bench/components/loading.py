"""Loading what a reference names, in any process, and errors of a user's code as messages with its own lines."""

from __future__ import annotations

import ast
import faulthandler
import re
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ExtensionFileLoader, ModuleSpec, SourceFileLoader
from importlib.util import find_spec, spec_from_file_location
from itertools import count
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from rmpc_bench.components.reference import CodeError, CodeReference, Place, module_file
from rmpc_bench.components.user_code import TooLong, limited, noted_signals, replaced, untouched
from rmpc_bench.extras import missing, missing_extra
from rmpc_bench.types.errors import ConfigError, DesignError, unknown

PREFIX = "_rmpc_bench_code_"
_PRIVATE = re.compile(rf"{PREFIX}\d+\.")
_ENCODED = "file_"
_numbers = count(1)


@dataclass
class Package:
    """A directory whose files are modules of a private package, so that equal names in two directories do not mix.

    A file imports the files beside it by their plain names, as a script does, or with a leading dot.  Plain names
    become those of private modules when the file is compiled, so that nothing changes for other modules.

    A text is read once.  A worker process receives the texts, so that an edit during an experiment reaches no worker.
    No compiled files are written: their time stamps cannot tell two edits in one second.
    """

    name: str  # name of the package
    directory: Path  # absolute
    sources: dict[str, bytes] = field(default_factory=dict)  # file -> its text, for all files that were imported
    fixed: bool = False  # whether the texts come from another process, so that files on disk do not count

    def is_current(self) -> bool:
        """Whether no imported file has changed."""
        return self.fixed or all(_text(Path(file)) == text for file, text in self.sources.items())


_packages: dict[str, Package] = {}
"""Packages by name; one with old texts stays, since designs made from it are still in use."""
_newest: dict[Path, Package] = {}
"""Directory -> its package with the newest texts."""


def package_of(directory: Path) -> Package:
    """Return the package of a directory; a new one where a file has changed since it was imported."""
    package = _newest.get(directory)
    if package is None or not package.is_current():
        # A worker process has packages of the process that started it, too.
        name = next(name for number in _numbers if (name := f"{PREFIX}{number}") not in _packages)
        package = add(Package(name, directory))
    return package


def add(package: Package) -> Package:
    """Make a package importable in this process."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        # First, because the finder of Python would find the files as well and load them in its own way.
        sys.meta_path.insert(0, _Finder())
    known = _packages.setdefault(package.name, package)
    _newest[known.directory] = known
    return known


def packages() -> tuple[Package, ...]:
    """Return all packages of this process."""
    return tuple(_packages.values())


def is_private(module: str | None) -> bool:
    """Whether a module belongs to a user's directory."""
    return module is not None and module.partition(".")[0] in _packages


def is_source(file: str) -> bool:
    """Whether a file was imported as a private module."""
    return any(file in package.sources for package in _packages.values())


def module_name(stem: str) -> str:
    """Return the name of the module for a file without its ending; it may have blanks, points and hyphens.

    Examples
    --------
    >>> module_name("tanks"), module_name("tanks-2")
    ('tanks', 'file_74616e6b732d32')
    """
    return stem if stem.isidentifier() else f"{_ENCODED}{stem.encode().hex()}"


def _stem(name: str) -> str:
    """Return the name of a file for the name of its module; the inverse of `module_name`."""
    try:
        return bytes.fromhex(name.removeprefix(_ENCODED)).decode() if name.startswith(_ENCODED) else name
    except ValueError:
        return name


class _Finder(MetaPathFinder):
    """Finds the modules of private packages."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return where a module of a private package comes from; None for every other module."""
        package = _packages.get(fullname.partition(".")[0])
        if package is None:
            return None
        if "." not in fullname:
            return _directory_spec(fullname, package.directory)
        return next(filter(None, (_spec(package, fullname, Path(each)) for each in path or ())), None)


def _spec(package: Package, fullname: str, directory: Path) -> ModuleSpec | None:
    """Return the spec of a module in a directory."""
    stem = _stem(fullname.rpartition(".")[2])
    file = module_file(directory, stem, lambda path: str(path) in package.sources or path.is_file())
    if file is None:
        return _directory_spec(fullname, directory / stem) if (directory / stem).is_dir() else None
    if file.suffix != ".py":
        return spec_from_file_location(fullname, file, loader=ExtensionFileLoader(fullname, str(file)))
    inside = [str(file.parent)] if file == directory / stem / "__init__.py" else None
    loader = _Loader(fullname, str(file), package)
    return spec_from_file_location(fullname, file, loader=loader, submodule_search_locations=inside)


def _directory_spec(fullname: str, directory: Path) -> ModuleSpec:
    """Return the spec of a package without `__init__.py`."""
    spec = ModuleSpec(fullname, None, is_package=True)
    spec.submodule_search_locations = [str(directory)]
    return spec


def _text(file: Path) -> bytes | None:
    try:
        return file.read_bytes()
    except OSError:
        return None


class _Loader(SourceFileLoader):
    """Loads a file from the text that its package keeps; its imports of files beside it name private modules."""

    def __init__(self, fullname: str, path: str, package: Package) -> None:
        super().__init__(fullname, path)
        self._package = package

    def get_data(self, path: str) -> bytes:
        """Read a file once."""
        if path not in self._package.sources:
            self._package.sources[path] = super().get_data(path)
        return self._package.sources[path]

    def get_code(self, fullname: str) -> CodeType:
        """Compile the text."""
        tree = ast.parse(self.get_data(self.path), self.path)
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                node.names = [each for alias in node.names for each in self._aliases(alias)]
            elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                node.module = self._prefix(node.module) + node.module
        code: CodeType = compile(tree, self.path, "exec", dont_inherit=True)
        return code

    def exec_module(self, module: ModuleType) -> None:
        """Run the module."""
        replaced.pop(self.path, None)
        with untouched(self.path):
            super().exec_module(module)

    def _aliases(self, alias: ast.alias) -> list[ast.alias]:
        """Return what imports a file beside this one; ``import a.b`` imports b and binds a."""
        prefix, first = self._prefix(alias.name), alias.name.partition(".")[0]
        if not prefix:
            return [alias]
        names = [alias.name] if alias.asname else dict.fromkeys((alias.name, first))
        return [ast.copy_location(ast.alias(prefix + name, alias.asname or first), alias) for name in names]

    def _prefix(self, name: str) -> str:
        """Private package, with a point, in which the first part of a name lies; empty for what is installed."""
        first = name.partition(".")[0]
        own = self.name if self.is_package(self.name) else self.name.rpartition(".")[0]
        # A file with the name of the library that it imports means the library.
        specs = [
            find_spec(full)
            for each in dict.fromkeys((self._package.name, own))
            if (full := f"{each}.{first}") != self.name
        ]
        files = [spec for spec in specs if spec is not None and spec.has_location]
        # As everywhere in Python, a directory without __init__.py counts only where nothing else has its name.
        found = files or [spec for spec in specs if spec is not None and find_spec(first) is None]
        return found[0].name.removesuffix(first) if found else ""


def load(reference: CodeReference) -> Any:
    """Return the object that a reference names; its file is imported where that has not been done."""
    found: Any = module_of(reference.path)
    names = reference.name.split(".")
    for number, name in enumerate(names):
        with user_code(reference.path):
            missing = not hasattr(found, name)
        if missing:
            owner = f"{reference.file}:{'.'.join(names[:number])}".rstrip(":")
            raise CodeError(unknown(reference.name, _names(found), f"name in {owner}"))
        found = getattr(found, name)
    return found


def module_of(path: Path) -> ModuleType:
    """Import a Python file as a private module."""
    package = package_of(path.parent)
    with user_code(path):
        return import_module(f"{package.name}.{module_name(path.stem)}")


def import_file(reference: CodeReference) -> None:
    """Import a user's file in the main program, with a limit of time; a crash of it writes the line to stderr."""
    if not faulthandler.is_enabled():
        faulthandler.enable(2, all_threads=False)
    try:
        with limited():
            module_of(reference.path)
    except TooLong as error:
        raise CodeError(f"{reference.file}: its import {error}; move what it computes into `prepare`") from None


def reference_of(design: Any) -> CodeReference | None:
    """Return where something from a private module stands; None for anything else."""
    module, name = getattr(design, "__module__", None), getattr(design, "__qualname__", None)
    if not isinstance(module, str) or not is_private(module) or not isinstance(name, str):
        return None
    path = Path(str(sys.modules[module].__file__))
    return CodeReference(path, name, f"{path.name}:{name}")


@contextmanager
def user_code(path: Path | None = None) -> Iterator[None]:
    """Turn every exception of a user's code into a CodeError with the line of the user's file.

    A DesignError is the component's own message and stays one.  `SystemExit` and a `KeyboardInterrupt` that the code
    raises count as its errors; Ctrl-C ends the program as always.
    """
    with noted_signals() as arrived:
        try:
            yield
        except (CodeError, ConfigError, DesignError):
            raise
        except (Exception, KeyboardInterrupt, SystemExit) as error:
            if isinstance(error, KeyboardInterrupt) and arrived:
                raise
            found = CodeError(described(error), place_of(error, path))
            # The file is right where a library is missing: its line is then in the message, and the configuration has
            # the place.
            raise (CodeError(found.line) if missing_extra(error) else found) from error


def described(error: BaseException) -> str:
    """Return an exception in one line: ``ValueError: negative level``."""
    if extra := missing_extra(error):
        return missing(extra)
    if isinstance(error, SyntaxError):
        return f"{type(error).__name__}: {error.msg}"
    try:
        # With the names of modules as the user writes them.
        text = _PRIVATE.sub("", " ".join(str(error).split()))
    except Exception:
        # The exception is the user's own class, and its text may fail as well.
        text = ""
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def place_of(error: BaseException, path: Path | None = None) -> Place | None:
    """Return the last place in the user's files that an exception came through."""
    if isinstance(error, SyntaxError) and error.filename is not None and is_source(error.filename):
        return Place(shown_path(error.filename), error.lineno or 1, error.offset or 1)
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if is_source(frame.filename)]
    if frames:
        return Place(shown_path(frames[-1].filename), frames[-1].lineno or 1, 1 + (frames[-1].colno or 0))
    return None if path is None else Place(shown_path(str(path)), 1, 1)


def shown_path(file: str) -> str:
    """Write a file relative to the current directory where it lies below."""
    path = Path(file)
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else file


def _names(owner: Any) -> list[str]:
    """Names of what a file or a class defines itself."""
    inside = owner.__name__ if isinstance(owner, ModuleType) else getattr(owner, "__module__", "")
    return sorted(
        name
        for name, value in vars(owner).items()
        if not name.startswith("_") and callable(value) and getattr(value, "__module__", None) == inside
    )
