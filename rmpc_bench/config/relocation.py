"""Names of a user's files in a resolved configuration: relative to the configuration, or to a directory of results.

A directory of results has copies of the Python files, ``code/<hash>/tanks.py``, so that its configuration loads from
any place and with the code that computed the trials.  Data files are named relative to the directory.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rmpc_bench.components.code import split_reference
from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config.tree import Items, Map, locate

COPIES = "code"
"""Directory of the copies in a directory of results."""
_WITHOUT_FILES = ("title", "summary", "label", "name", "claims", "statistics", "paper", "assumptions")
"""Keys under which no value names a file."""


def as_of_configuration(tree: Map, key: str, own: OwnCode) -> Any:
    """Return a section of a configuration as plain data, its files relative to the directory of the configuration.

    Parameters
    ----------
    tree : the configuration; a file is given relative to the file in which its name is written
    key : of the section
    own : the files of the configuration
    """

    def written(text: str, file: str) -> str:
        parts = split_reference(text)
        if parts is not None:
            return own.access.reference(text, file).text
        name = own.access.file(text, file).file
        return name if name in own.patterns or name in own.files else text

    return _replaced(tree[key], written, locate(tree, [key]).file)


def in_directory(resolved: Mapping[str, Any], directory: Path, own: OwnCode) -> dict[str, Any]:
    """Return a resolved configuration that names the copies in a directory of results.

    Parameters
    ----------
    resolved : plain data, all files relative to the directory of the configuration
    directory : the directory of results
    own : the files of the configuration
    """

    def written(text: str, _: str) -> str:
        file, name = split_reference(text) or (text, "")
        if file in own.files:
            source = own.sources[own.files[file]]
            return f"{COPIES}/{source.folder}/{source.copy}" + (f":{name}" if name else "")
        if text in own.patterns:
            # The system follows a link before it goes up with `..`, in the directory of results, too.
            return Path(os.path.relpath(own.access.base("").resolve() / text, directory.resolve())).as_posix()
        return text

    changed: dict[str, Any] = _replaced(dict(resolved), written, "")
    return changed


def renamed(resolved: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return a resolved configuration with other names of files.

    Parameters
    ----------
    resolved : plain data
    names : path or pattern as the configuration writes it -> another one
    """
    changed: dict[str, Any] = _replaced(dict(resolved), lambda text, _: names.get(text, text), "")
    return changed


def _replaced(node: Any, write: Callable[[str, str], str], file: str) -> Any:
    """Copy a tree into ordinary dicts and lists, with other texts."""
    if isinstance(node, str):
        return write(node, file)
    if isinstance(node, dict):
        return {
            key: value if key in _WITHOUT_FILES else _replaced(value, write, _file_of(node, key, file))
            for key, value in node.items()
        }
    if isinstance(node, list):
        return [_replaced(value, write, _file_of(node, number, file)) for number, value in enumerate(node)]
    return node


def _file_of(node: Any, step: str | int, file: str) -> str:
    return locate(node, [step]).file if isinstance(node, Map | Items) else file
