"""Options and arguments of the command line that concern code of the user."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from rmpc_bench import registry
from rmpc_bench.cli.typed_files import TypedPath

if TYPE_CHECKING:
    from rmpc_bench.components.consent import CodeAccess
    from rmpc_bench.components.reference import CodeReference

imported: list[str] = []
"""Modules that `--import` has imported, which a process of its own imports too."""
Command = TypeVar("Command", bound=Callable[..., Any])


def allow_code_option(command: Command) -> Command:
    """Add the option `--allow-code`."""
    return click.option(
        "--allow-code",
        multiple=True,
        type=TypedPath(exists=True),
        metavar="PATH",
        help="Load files with code from here, too: a file or a directory; may be repeated.",
    )(command)


def import_option(command: Command) -> Command:
    """Add the option `--import`, whose modules are imported before anything else happens."""
    return click.option(
        "--import",
        "modules",
        multiple=True,
        metavar="MODULE",
        expose_value=False,
        callback=_import,
        is_eager=True,
        help="Import an installed module that registers components; may be repeated.",
    )(command)


def _import(context: click.Context, parameter: click.Parameter, names: tuple[str, ...]) -> None:
    """Import modules; a failure is an error of the command line."""
    for name in names:
        try:
            import_module(name)
            imported.append(name)
        except (Exception, SystemExit) as error:
            frames = traceback.extract_tb(error.__traceback__)
            last = frames[-1] if frames and not frames[-1].filename.startswith("<frozen") else None
            where = "" if last is None or last.filename == __file__ else f" at {last.filename}:{last.lineno}"
            text = f"{name} cannot be imported{where} ({type(error).__name__}: {error})"
            raise click.BadParameter(text, context, parameter) from None


def split_name(name: str) -> tuple[str, str] | None:
    """Return the group (or nothing) and the reference of an argument ``[GROUP/]PATH.py:NAME``; None for any other."""
    from rmpc_bench.components.reference import split_reference

    parts = split_reference(name)
    if parts is None:
        return None
    group, slash, rest = name.partition("/")
    group = f"{group}s" if f"{group}s" in registry.BUILT_IN else group
    if slash and group in registry.BUILT_IN and not Path(parts[0]).is_file():
        return group, rest
    return "", name


def named_component(name: str) -> tuple[str, CodeReference] | None:
    """Return group and reference of an argument ``[GROUP/]PATH.py:NAME``, its file loaded; None for any other.

    Raises
    ------
    click.BadParameter
        If the file cannot be loaded, has no such name, or the group of what it names cannot be seen.
    """
    parts = split_name(name)
    if parts is None:
        return None
    from rmpc_bench.components.designs import group_of
    from rmpc_bench.components.reference import CodeError

    group, text = parts
    access = _access(text.rpartition(":")[0])
    try:
        reference = access.reference(text, "")
        found = access.load(reference)
    except CodeError as error:
        raise click.BadParameter(error.line) from None
    group = group or group_of(found) or ""
    if not group:
        groups = ", ".join(registry.BUILT_IN)
        raise click.BadParameter(f"{text}: is it one of {groups}? Write it in front: estimators/{text}")
    return group, reference


def entries(file: str) -> list[str]:
    """Return the components that a Python file defines, each with its group.

    Raises
    ------
    click.BadParameter
        If the file cannot be loaded.
    """
    from rmpc_bench.components.consent import name_files
    from rmpc_bench.components.designs import components_in
    from rmpc_bench.components.loading import module_of
    from rmpc_bench.components.reference import CodeError

    access = _access(file)
    try:
        reference = access.file(file, "")
        access.check(reference)
        name_files([reference])
        found = components_in(module_of(reference.path))
    except CodeError as error:
        raise click.BadParameter(error.line) from None
    return [f"{group}  {file}:{name}" for name, group in found.items()]


def _access(file: str) -> CodeAccess:
    """Return access to a file that the user has named on the command line, and to nothing else."""
    from rmpc_bench.components.consent import CodeAccess

    return CodeAccess(Path.cwd(), (Path(file).resolve(),))
