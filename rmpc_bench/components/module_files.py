"""The files that an import statement executes, below one directory."""

from __future__ import annotations

from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

from rmpc_bench.components.imports import Import


def module_files(directory: Path, statement: Import) -> list[Path]:
    """Return the files that an import statement executes; empty where the module does not lie in the directory.

    Every package on the way is executed, and of ``from package import name`` the module `name` where there is one.
    A star imports what ``__all__`` names, so that all modules of the package count.

    Parameters
    ----------
    directory : where the first name is looked up; for a relative import the package
    statement : the import statement, its leading dots already followed
    """
    # The package of a relative import has been executed, too.
    files = [directory / "__init__.py"] if statement.level and (directory / "__init__.py").is_file() else []
    for step in statement.module.split(".") if statement.module else ():
        found = _module(directory, step)
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
        elif (found := _module(directory, name)) is not None:
            files.append(found)
    return files


def _module(directory: Path, name: str) -> Path | None:
    """Return the file of a module in a directory, in the order in which Python looks for it."""
    candidates = (directory / name / "__init__.py", *(directory / f"{name}{suffix}" for suffix in EXTENSION_SUFFIXES))
    return next((path for path in (*candidates, directory / f"{name}.py") if path.is_file()), None)
