"""The section `requires`: optional libraries that a configuration needs, by the extras of pip that install them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rmpc_bench import extras
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.known_files import located
from rmpc_bench.config_file.source import REQUIRES, read_extended
from rmpc_bench.config_file.tree import Items, Map
from rmpc_bench.registry import unknown
from rmpc_bench.types import Problem


def check_required(draft: DraftConfig) -> None:
    """Report every required library that is unknown or not installed; nothing is imported."""
    names = draft.values[REQUIRES] or ()
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
    """Say why a configuration is skipped; empty where all libraries that it requires are installed.

    Raises a ConfigError if the file cannot be read.
    """
    names = missing_extras(config)
    return f"skipped {config}: needs {', '.join(names)} ({extras.install(*names)})" if names else ""


def missing_extras(config: str | Path) -> list[str]:
    """Return the extras that a configuration requires and that are not installed; no code is loaded.

    Raises a ConfigError if the file cannot be read.
    """
    tree = read_extended(located(config))
    names = tree.get(REQUIRES) if isinstance(tree, Map) else None
    given = names if isinstance(names, Items) else ()
    return [name for name in given if name in extras.EXTRAS and not extras.is_installed(name)]
