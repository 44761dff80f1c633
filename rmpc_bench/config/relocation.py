"""Names of a user's files in a resolved configuration: relative to the configuration, or to a directory of results.

A directory of results has copies of the Python files, ``code/<hash>/tanks.py``, so that its configuration loads from
any place and with the code that computed the trials.  Data files are named relative to the directory.  Every copy is
compared with its hash before any use.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rmpc_bench.components.reference import split_reference
from rmpc_bench.components.source import read_source
from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config_file.tree import Items, Map, locate
from rmpc_bench.received.plain_files import DamagedError, content_of
from rmpc_bench.types.result_files import COPIES

STORE = "trials.sqlite"
_WAY_OUT = "restore the file from the original, or `rmpc-bench run --fresh` computes everything again"
_WITHOUT_FILES = ("title", "summary", "label", "name", "claims", "statistics", "paper", "assumptions")
"""Keys under which no value names a file."""


def as_of_configuration(tree: Map, key: str, own: OwnCode) -> Any:
    """Return a section of a configuration as plain data, its files relative to the directory of the configuration."""

    def written(text: str, file: str) -> str:
        parts = split_reference(text)
        if parts is not None:
            return own.access.reference(text, file).text
        name = own.access.file(text, file).file
        return name if name in own.patterns or name in own.files else text

    return _replaced(tree[key], written, locate(tree, [key]).file)


def in_directory(resolved: Mapping[str, Any], directory: Path, own: OwnCode) -> dict[str, Any]:
    """Return a resolved configuration that names the copies in a directory of results."""

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
    """Return a resolved configuration with other names of files: as the configuration writes them -> others."""
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


def check_copies(directory: Path) -> None:
    """Raise `DamagedError` for a copy of a directory that is not the program of which its folder has the hash."""
    # A directory of configurations may have a folder of this name with files of its user.
    name = re.compile(".*" if (directory / STORE).exists() else "[0-9a-f]{16}")
    try:
        there = sorted(each for each in (directory / COPIES).iterdir() if name.fullmatch(each.name))
        folders = {each: _files(each) for each in there}
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise DamagedError(f"{directory / COPIES}: cannot be read ({error}); {_WAY_OUT}") from None
    wholes = {folder for folder, files in folders.items() if _is_whole(folder, files)}
    known = {content for folder in wholes for content in folders[folder].values()}
    for folder, files in folders.items():
        # The folder of a part of a file has the whole file, which then has a folder of its own.
        if folder not in wholes and not {*files.values()} <= known:
            raise DamagedError(f"{folder}: its files are not those that have computed the trials; {_WAY_OUT}")


def _files(folder: Path) -> dict[Path, bytes]:
    """Return the files of a folder with their contents, but for those that Python makes."""
    found: dict[Path, bytes] = {}
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]
        for name in names:
            path = Path(parent, name)
            if path.resolve() != folder.resolve() / path.relative_to(folder):
                raise OSError(f"{path} is a symbolic link")
            found[path] = content_of(path)
    return found


def _is_whole(folder: Path, files: Mapping[Path, bytes]) -> bool:
    """Whether every file has, with all that it imports, the hash of the folder, or is imported by one that has."""
    known = set[Path]()
    for path in files:
        source = read_source(path, lambda each: files.get(each) or content_of(each))
        if source.folder == folder.name:
            known |= {each.path for each in source.files}
    return {path.resolve() for path in files} == known
