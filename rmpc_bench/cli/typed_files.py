"""Paths that are typed on the command line, and those in methods that are typed there."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

OPTION = "--add-method"


class TypedPath(click.Path):
    """A path; an empty one, such as that of a shell variable without a value, would be the current directory."""

    def __init__(self, **options: Any) -> None:
        super().__init__(path_type=Path, **options)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path."""
        if not os.fspath(value):
            self.fail("a path must not be empty", param, ctx)
        return super().convert(value, param, ctx)


def from_here(texts: Sequence[str], config: Path) -> tuple[list[str], list[Path]]:
    """Name files relative to the directory of a configuration that is elsewhere.

    Parameters
    ----------
    texts : methods as typed, such as ``mine: {estimator: {file: mine.py:Filter}}``
    config : the configuration that they are added to

    Returns
    -------
    the texts with the names as the configuration reads them, and the files that are there: who types the name of a file
    allows its code.  A text that cannot be read stays as it is, and so does the name of a file that is not there
    """
    from rmpc_bench.config_file.tree import plain
    from rmpc_bench.config_file.yaml import one_line, parse
    from rmpc_bench.types import ConfigError

    found, files = [], list[Path]()
    for text in texts:
        try:
            tree = plain(parse(text, OPTION))
        except ConfigError:
            tree = None
        before = len(files)
        if isinstance(tree, dict):
            for method in tree.values():
                for component in method.values() if isinstance(method, dict) else ():
                    _rename(component, config, files)
        found.append(
            ", ".join(f"{name}: {one_line(method)}" for name, method in tree.items()) if len(files) > before else text
        )
    return found, files


def _rename(component: Any, config: Path, files: list[Path]) -> None:
    """Change the key `file` of a component whose file is in the current directory."""
    if not isinstance(component, dict) or not isinstance(component.get("file"), str):
        return
    file, colon, name = component["file"].partition(":")
    if file and not os.path.isabs(file) and os.path.isfile(file):
        files.append(Path(file))
        component["file"] = Path(os.path.relpath(file, config.absolute().parent)).as_posix() + colon + name
