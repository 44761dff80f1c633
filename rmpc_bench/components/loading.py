"""Loading what a reference names, in any process, and errors of a user's code as messages with its own lines."""

from __future__ import annotations

import faulthandler
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

from rmpc_bench.components.code import CodeError, CodeReference, Place
from rmpc_bench.components.private_modules import file_of, is_private, is_source, module_name, package_of, plain_names
from rmpc_bench.components.signals import TooLong, limited, noted_signals
from rmpc_bench.extras import missing, missing_extra
from rmpc_bench.types.errors import ConfigError, DesignError, unknown


def load(reference: CodeReference) -> Any:
    """Return the object that a reference names; its file is imported where that has not been done."""
    found: Any = module_of(reference.path)
    for number, name in enumerate(reference.name.split(".")):
        with user_code(reference.path):
            missing = not hasattr(found, name)
        if missing:
            owner = (
                reference.file if number == 0 else f"{reference.file}:{'.'.join(reference.name.split('.')[:number])}"
            )
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
    path = file_of(module)
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
            raise _code_error(error, path) from error


def _code_error(error: BaseException, path: Path | None) -> CodeError:
    """Return an exception of a user's code as a message.

    The file is right where a library is missing: its line is then in the message, and the configuration has the place.
    """
    found = CodeError(described(error), place_of(error, path))
    return CodeError(found.line) if missing_extra(error) else found


def described(error: BaseException) -> str:
    """Return an exception in one line: ``ValueError: negative level``."""
    if extra := missing_extra(error):
        return missing(extra)
    if isinstance(error, SyntaxError):
        return f"{type(error).__name__}: {error.msg}"
    try:
        text = plain_names(" ".join(str(error).split()))
    except Exception:
        # The exception is the user's own class, and its text may fail as well.
        text = ""
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def place_of(error: BaseException, path: Path | None = None) -> Place | None:
    """Return the last place in the user's files that an exception came through."""
    if isinstance(error, SyntaxError) and error.filename is not None and is_source(error.filename):
        return Place(shown_path(error.filename), error.lineno or 1, error.offset or 1)
    frames = user_frames(error.__traceback__)
    if frames:
        return Place(shown_path(frames[-1].filename), frames[-1].lineno or 1, 1 + (frames[-1].colno or 0))
    return None if path is None else Place(shown_path(str(path)), 1, 1)


def user_frames(trace: TracebackType | None) -> list[traceback.FrameSummary]:
    """Return the frames of a traceback that lie in the user's files."""
    return [frame for frame in traceback.extract_tb(trace) if is_source(frame.filename)]


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
