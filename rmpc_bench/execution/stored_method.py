"""What identifies the trials of a method in the trial store."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple


class StoredMethod(NamedTuple):
    """A method whose trials are stored under one key."""

    key: str
    """Hash of its definition and of the code."""
    definition: str
    """Hash of its definition."""
    code: Mapping[str, Any]
    """What identifies the code that computes its trials."""
    name: str = ""
    """Its name, for messages."""


def each_once(methods: Iterable[StoredMethod]) -> list[StoredMethod]:
    """Return methods that share trials as one, with all their names."""
    found: dict[str, StoredMethod] = {}
    for method in methods:
        names = dict.fromkeys(
            [*found[method.key].name.split(", "), method.name] if method.key in found else [method.name]
        )
        found[method.key] = method._replace(name=", ".join(names))
    return list(found.values())
