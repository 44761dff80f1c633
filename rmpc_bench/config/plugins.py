"""The keys `plugins`, files whose code registers components, and `requires`, optional libraries by their extras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rmpc_bench import extras
from rmpc_bench.components.consent import CodeAccess, name_files
from rmpc_bench.components.loading import module_of
from rmpc_bench.components.reference import CodeError, CodeReference
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.component import problem_of
from rmpc_bench.config_file.extends import REQUIRES, read_extended
from rmpc_bench.config_file.keys import shown
from rmpc_bench.config_file.known_files import located
from rmpc_bench.config_file.tree import Items, Map, Mark, locate
from rmpc_bench.config_file.user_files import named_in
from rmpc_bench.registry import unknown
from rmpc_bench.types import ConfigError, Problem

KEY = "plugins"


def load_plugins(tree: Map, access: CodeAccess) -> None:
    """Name the files with code of a configuration on stderr, and run its plugins."""
    problems: list[Problem] = []
    plugins: list[tuple[CodeReference, Mark, str]] = []
    given = tree.get(KEY)
    for number, text in enumerate(given if isinstance(given, Items) else ()):
        mark, path = locate(tree, [KEY, number]), f"{KEY}.{number}"
        if not isinstance(text, str) or not text.endswith(".py"):
            problems.append(
                Problem(*mark, path, f"must be a Python file that registers components (got {shown(text)})")
            )
            continue
        reference = access.file(text, mark.file)
        try:
            access.check(reference)
            plugins.append((reference, mark, path))
        except CodeError as error:
            problems.append(Problem(*mark, path, str(error)))
    name_files([*(reference for reference, _, _ in plugins), *named_in(tree, access)])
    for reference, mark, path in plugins:
        try:
            module_of(reference.path)
        except CodeError as error:
            problems.append(problem_of(error, mark, path))
    if problems:
        raise ConfigError(problems)


def check_required(draft: DraftConfig) -> None:
    """Report every required library that is unknown or not installed; nothing is imported."""
    names = draft.keys.requires or ()
    for number, name in enumerate(names):
        if name in names[:number]:
            draft.note([REQUIRES, number], f"{name!r} is named twice")
        elif name not in extras.EXTRAS:
            draft.note([REQUIRES, number], unknown(name, extras.EXTRAS, "optional library"))
        elif not extras.is_installed(name):
            draft.note([REQUIRES, number], extras.missing(name))


def reported_once(problems: Sequence[Problem]) -> list[Problem]:
    """Leave out what says again that a library is missing which `requires` names."""
    missing = [each.message for each in problems if each.path.startswith(f"{REQUIRES}.")]
    return [
        each
        for each in problems
        if each.path.startswith(f"{REQUIRES}.") or not any(message in each.message for message in missing)
    ]


def skipped(config: str | Path) -> str:
    """Say why a configuration is skipped, empty where all libraries are there; a ConfigError if it cannot be read."""
    names = missing_extras(config)
    return f"skipped {config}: needs {', '.join(names)} ({extras.install(*names)})" if names else ""


def missing_extras(config: str | Path) -> list[str]:
    """Return the required extras that are not installed, without loading code; a ConfigError if it cannot be read."""
    tree = read_extended(located(config))
    names = tree.get(REQUIRES) if isinstance(tree, Map) else None
    given = names if isinstance(names, Items) else ()
    return [name for name in given if name in extras.EXTRAS and not extras.is_installed(name)]
