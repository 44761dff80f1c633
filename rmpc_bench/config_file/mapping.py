"""A configuration as a mapping of Python: its text in canonical YAML, with the classes in it registered by their names.

Numbers and arrays of NumPy, tuples and paths stand for what YAML has in their place.  A class or function under `kind`,
or in a list of metrics or figures, is registered under its qualified name.  Under any other key it is written as
``PATH.py:NAME``, since a file of the user is then imported again.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rmpc_bench.components.designs import register
from rmpc_bench.config_file.source import COMPONENTS
from rmpc_bench.config_file.tree import MAX_DEPTH, join
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.types import ConfigError, Problem

_GROUPS = {**COMPONENTS, "metrics": "metrics", "figures": "figures", "noise": "noises"}


def canonical_text(given: Mapping[str, Any]) -> str:
    r"""Write a mapping as the text of a configuration file; a ConfigError names the keys whose values have no form.

    Examples
    --------
    >>> canonical_text({"runs": np.int64(4), "time": {"step": 0.1, "steps": 20}, "initial": {"x": (0.0, 1.0)}})
    'runs: 4\ntime: {step: 0.1, steps: 20}\ninitial: {x: [0.0, 1.0]}\n'
    """
    return dump(plain_mapping(given))


def plain_mapping(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping as YAML has it; a ConfigError names the keys whose values have no form."""
    problems: list[Problem] = []
    data: dict[str, Any] = _plain(given, [], problems, {})
    if not problems:
        try:
            dump(data).encode()
            return data
        except (TypeError, ValueError) as error:
            problems.append(Problem("", 1, 1, "", str(error)))
    raise ConfigError(problems)


def _plain(value: Any, path: Sequence[str], problems: list[Problem], named: dict[tuple[str, str], Any]) -> Any:
    """Return a value as YAML has it; `named` has the classes of the mapping, by group and name."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    elif isinstance(value, os.PathLike):
        value = os.fspath(value)
    if isinstance(value, str | int | float | None):
        return value
    message = f"must be a number, a text, a list, a mapping or a class (got {type(value).__name__})"
    if len(path) > MAX_DEPTH:
        message = f"nested deeper than {MAX_DEPTH} levels"
    elif isinstance(value, Mapping):
        if len({*map(str, value)}) < len(value):
            problems.append(Problem("", 1, len(problems) + 1, join(path), "two keys have the same text"))
        entries = value.items()
        return {_key(key, path, problems): _plain(each, [*path, str(key)], problems, named) for key, each in entries}
    elif isinstance(value, list | tuple | range):
        return [_plain(each, [*path, str(number)], problems, named) for number, each in enumerate(value)]
    elif isinstance(value, type) or inspect.isroutine(value):
        try:
            return _name(value, path, named)
        except ValueError as error:
            message = str(error)
    problems.append(Problem("", 1, len(problems) + 1, join(path), message))
    return None


def _key(key: Any, path: Sequence[str], problems: list[Problem]) -> str:
    if not isinstance(key, str | int | float):
        problems.append(Problem("", 1, len(problems) + 1, join(path), f"a key must be text (got {key!r})"))
    return str(key)


def _name(found: Any, path: Sequence[str], named: dict[tuple[str, str], Any]) -> str:
    """Register a class or function, or write where it stands; ValueError where neither is possible."""
    name: str = found.__qualname__
    steps = ".".join(path).split(".")
    group = next((_GROUPS[step] for step in reversed(steps) if step in _GROUPS), None)
    if group is not None and (steps[-1] == "kind" or steps[-1] in _GROUPS or steps[-2] in ("metrics", "figures")):
        if named.setdefault((group, name), found) is not found:
            raise ValueError(
                f"another class or function of the mapping is called {name}, too: register them under two names"
            )
        register(group, name, found)
        return name
    file = getattr(sys.modules.get(found.__module__), "__file__", None)
    if found.__module__ == "__main__" or file is None or "<" in name:
        raise ValueError(
            f"{name} stands in no module that can be imported: write it to a file, and give 'FILE.py:NAME'"
        )
    return f"{file}:{name}"
