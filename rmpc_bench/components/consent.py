"""Consent to the code of a configuration: which files with code it may load.

The user who names a configuration agrees to the files in its directory and below.  Every other file needs
`--allow-code`.  Symbolic links are resolved first.  Every file is named on stderr before its code runs.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from glob import escape, glob, has_magic
from pathlib import Path
from typing import Any

from rmpc_bench import notices
from rmpc_bench.components.designs import loaded_design
from rmpc_bench.components.loading import import_file, load
from rmpc_bench.components.reference import CodeError, CodeReference, DataReference, split_reference
from rmpc_bench.components.source import read_source
from rmpc_bench.received.consent import accepted, is_code, reason_against
from rmpc_bench.types.errors import nearest

_OPTIONS = ("-s ", "--add-method ")
"""Starts of the file name in the place of a value that was given on the command line."""

_CODE = (".py", ".so", ".pyd")
"""Endings of modules."""

_named: set[tuple[Path, str]] = set()
"""Files that this process has named on stderr, with their hashes."""


@dataclass(frozen=True)
class CodeAccess:
    """The Python files that a configuration may load."""

    # directory of the configuration, absolute; None for one that was not read from a regular file
    directory: Path | None
    allowed: tuple[Path, ...] = ()  # files and directories that are allowed besides
    # current directory when the configuration was read, to which names of files in places are relative
    start: Path = field(default_factory=Path.cwd, compare=False)
    _loaded: dict[tuple[str, CodeReference], Any] = field(default_factory=dict, compare=False, repr=False)
    """Group and reference -> what was loaded, or the error."""

    @classmethod
    def of(cls, config: str | Path, allow_code: Sequence[str | Path] = (), *, is_file: bool = True) -> CodeAccess:
        """Return what a configuration may load; further files are relative to the current directory.

        One that is no file, but a mapping of a program, may load what it could load as a file of this name.
        """
        path = Path(config)
        directory = path.absolute().parent if path.is_file() or not is_file else None
        return cls(directory, tuple(Path(each).resolve() for each in allow_code))

    def base(self, written_in: str) -> Path:
        """Return the directory that a path is relative to; an override stands in the configuration."""
        if not written_in or written_in.startswith(_OPTIONS):
            return self.directory or self.start
        return (self.start / written_in).parent

    def reference(self, text: str, written_in: str) -> CodeReference:
        """Return what a text ``PATH.py:NAME`` names; the file need not exist."""
        parts = split_reference(text)
        if parts is None:
            raise CodeError(f"must name something in a Python file, PATH.py:NAME (got {text!r})")
        return self.file(parts[0], written_in, parts[1])

    def file(self, text: str, written_in: str, name: str = "") -> CodeReference:
        """Return a reference to a whole file, or to a name in it; it need not exist."""
        path = self.base(written_in) / text
        return CodeReference(path.resolve(), name, f"{self._relative(path, text)}:{name}")

    def load(self, reference: CodeReference, group: str = "") -> Any:
        """Return what a reference names, or its design function in a group; its file is named on stderr first."""
        # Kept, an error as well: the points of a sweep ask for the same thing many times.
        key = group, reference
        if key not in self._loaded:
            try:
                self.check(reference)
                name_files([reference])
                import_file(reference)
                self._loaded[key] = loaded_design(group, reference) if group else load(reference)
            except CodeError as error:
                self._loaded[key] = error
        found = self._loaded[key]
        if isinstance(found, CodeError):
            raise found
        return found

    def check(self, reference: CodeReference) -> None:
        """Refuse a file that is not there or that may not be loaded."""
        path, file = reference.path, reference.file
        self._refuse(path, file)
        if not path.is_file():
            raise CodeError(_missing(file, path, "*.py"))
        try:
            imported = [each for each in read_source(path).files if each.beside and each.path.suffix in _CODE]
        except OSError:
            # Reported when the file is loaded.
            return
        for each in imported:
            self._refuse(each.path.resolve(), f"{each.place}, which {file} imports,")

    def _refuse(self, path: Path, file: str) -> None:
        """Refuse a file that nobody has agreed to."""
        here = [] if self.directory is None else [self.directory.resolve()]
        if reason := reason_against(path, file, [*self.allowed, *here]):
            raise CodeError(reason)

    def data(self, text: str, written_in: str) -> DataReference:
        """Return the data files that a path or a pattern names; those that can execute are files with code."""
        base = self.base(written_in)
        pattern = base / text
        if has_magic(text) and not pattern.exists():
            # Brackets in the name of the directory itself are no pattern.
            found = [Path(each) for each in glob(os.path.join(escape(str(base)), text), recursive=True)]
        else:
            found = [pattern]
        # In the order of their names here, also where these are links to files with other names.
        files = tuple(path.resolve() for path in sorted({*found}) if path.is_file())
        if not files:
            raise CodeError(_missing(text, pattern, "*"))
        code = [self.file(os.path.relpath(path, base.resolve()), written_in) for path in files if is_code(path)]
        for each in code:
            self._refuse(each.path, each.file)
        name_files(code)
        return DataReference(self._relative(pattern, text), files)

    def _relative(self, path: Path, text: str) -> str:
        """Write a path relative to the directory of the configuration; without one the text stays as it is."""
        return text if self.directory is None else Path(os.path.relpath(path, self.directory)).as_posix()


NO_ACCESS = CodeAccess(None)
"""What plain data without a file may load: nothing."""


def name_files(references: Iterable[CodeReference]) -> None:
    """Write a line on stderr with the files whose code runs next; a file that was named unchanged is left out."""
    new = {}
    for reference in references:
        try:
            short = read_source(reference.path).short
        except OSError:
            # Reported when the file is loaded.
            short = "unreadable"
        if (reference.path, short) not in _named and reference.path not in new:
            new[reference.path] = f"{reference.file} (sha {short})"
            _named.add((reference.path, short))
            accepted.add(reference.path)
    if new:
        notices.say(f"code  {' '.join(new.values())}")


def _missing(text: str, path: Path, pattern: str) -> str:
    """Say that a file does not exist, with the nearest name in its directory."""
    if path.is_dir():
        return f"{text} is a directory, not a file"
    names = sorted(each.name for each in path.parent.glob(pattern) if each.is_file())
    near = nearest(path.name, names)
    return f"there is no file {text}" + (f"; did you mean {near!r}?" if near else "")
