"""Keys of a configuration whose values differ between the methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump, one_line


def method_differences(methods: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return, per method, the keys whose values differ between the methods, and its values of them.

    Keys have dots, such as ``estimator.c``, and the given ones have every default.  A key that a method does not have
    is absent.
    """
    flat = {name: {key: leaf for key, leaf in _leaves(parts) if key != "label"} for name, parts in methods.items()}
    keys = dict.fromkeys(key for leaves in flat.values() for key in leaves)
    differing = [key for key in keys if len({repr(leaves.get(key)) for leaves in flat.values()}) > 1]
    return {name: {key: leaves[key] for key in differing if key in leaves} for name, leaves in flat.items()}


def _leaves(tree: Any, path: str = "") -> list[tuple[str, Any]]:
    if not isinstance(tree, dict):
        return [(path, tree)]
    return [leaf for key, value in tree.items() for leaf in _leaves(value, f"{path}.{key}" if path else key)]


def short_value(value: Any) -> str:
    """Write a value of a configuration on one line.

    Examples
    --------
    >>> short_value([{"B_d": [[1.0], [0.0]]}, "input"])
    '[{B_d: [[1.0], [0.0]]}, input]'
    """
    if isinstance(value, str):
        return value
    if isinstance(value, list) and value and all(isinstance(entry, int | float) for entry in value):
        return f"[{', '.join(f'{entry:g}' for entry in value)}]"
    if isinstance(value, float):
        return f"{value:g}"
    # A mapping without the outer braces.
    return one_line(plain(value)) if isinstance(value, list) else " ".join(dump(plain(value)).split())
