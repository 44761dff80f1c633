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
from rmpc_bench.config_file.extends import COMPONENTS
from rmpc_bench.config_file.tree import MAX_DEPTH, Problems, join
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.types import Problem

_GROUPS = {**COMPONENTS, "metrics": "metrics", "figures": "figures", "noise": "noises"}


def canonical_text(given: Mapping[str, Any]) -> str:
    r"""Write a mapping as the text of a configuration file; a ConfigError names the keys whose values have no form.

    >>> canonical_text({"runs": np.int64(4), "time": {"step": 0.1, "steps": 20}, "initial": {"x": (0.0, 1.0)}})
    'runs: 4\ntime: {step: 0.1, steps: 20}\ninitial: {x: [0.0, 1.0]}\n'
    """
    return dump(plain_mapping(given))


def plain_mapping(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping as YAML has it; a ConfigError names the keys whose values have no form."""
    reader = _Reader()
    data: dict[str, Any] = reader.plain(given, ())
    reader.problems.stop()
    return data


class _Reader:
    """Reads a mapping once; `problems` has what is wrong in it."""

    def __init__(self) -> None:
        self.problems = Problems()
        self._named: dict[tuple[str, str], Any] = {}  # the classes of the mapping, by group and name
        self._open: set[int] = set()
        """Lists and mappings around the value that is read: one that contains itself has no end."""

    def plain(self, value: Any, path: tuple[str, ...]) -> Any:
        """Return a value as YAML has it; None where it has no form."""
        if isinstance(value, np.ndarray | np.generic):
            value = value.tolist()
        elif isinstance(value, os.PathLike):
            value = os.fspath(value)
        if isinstance(value, str):
            return self._text(value, path)
        if isinstance(value, int | float | None):
            return value
        if isinstance(value, Mapping | list | tuple | range):
            return self._inside(value, path)
        message = f"must be a number, a text, a list, a mapping or a class (got {type(value).__name__})"
        if isinstance(value, type) or inspect.isroutine(value):
            try:
                return self._name(value, path)
            except ValueError as error:
                message = str(error)
        return self._note(path, message)

    def _note(self, path: tuple[str, ...], message: str) -> None:
        # Problems are sorted by their places: the column keeps their order.
        self.problems.append(Problem("", 1, len(self.problems) + 1, join(path), message))

    def _text(self, value: str, path: tuple[str, ...]) -> str:
        try:
            value.encode()
        except UnicodeEncodeError as error:
            self._note(path, str(error))
        return value

    def _inside(self, value: Mapping[Any, Any] | Sequence[Any], path: tuple[str, ...]) -> Any:
        if id(value) in self._open:
            return self._note(path, "contains itself")
        if len(path) > MAX_DEPTH:
            return self._note(path, f"nested deeper than {MAX_DEPTH} levels")
        self._open.add(id(value))
        found: Any
        if isinstance(value, Mapping):
            if len({*map(str, value)}) < len(value):
                self._note(path, "two keys have the same text")
            found = {self._key(key, path): self.plain(each, (*path, str(key))) for key, each in value.items()}
        else:
            found = [self.plain(each, (*path, str(number))) for number, each in enumerate(value)]
        self._open.remove(id(value))
        return found

    def _key(self, key: Any, path: tuple[str, ...]) -> str:
        if not isinstance(key, str | int | float):
            self._note(path, f"a key must be text (got {key!r})")
        return self._text(str(key), path)

    def _name(self, found: Any, path: tuple[str, ...]) -> str:
        """Register a class or function, or write where it stands; ValueError where neither is possible."""
        name: str = found.__qualname__
        steps = ".".join(path).split(".")
        group = next((_GROUPS[step] for step in reversed(steps) if step in _GROUPS), None)
        if group is not None and (steps[-1] == "kind" or steps[-1] in _GROUPS or steps[-2] in ("metrics", "figures")):
            if self._named.setdefault((group, name), found) is not found:
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
