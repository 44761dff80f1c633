"""How the points of a sweep are named and found.  Light: plain `check` imports it without pandas."""

from __future__ import annotations

from collections.abc import Mapping


def value_text(value: object) -> str:
    """Text of a value by which tables name it and claims find it: ``8``, ``0.001``, ``{kind: kalman}``."""
    if isinstance(value, str):
        return value
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, float) and abs(value) < 1e15 and value == int(value):
        return str(int(value))  # 10 and 10.0 are the same point
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {value_text(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(value_text(item) for item in value) + "]"
    return repr(value)


def same_value(one: str, other: str) -> bool:
    """Whether two texts name the same value of a sweep: 0.001 is 1e-3."""
    try:
        return one == other or float(one) == float(other)
    except ValueError:
        return False


def lies_at(there: Mapping[str, str], wanted: Mapping[str, str]) -> bool:
    """Whether a point of a sweep has all the wanted values."""
    return all(path in there and same_value(there[path], value) for path, value in wanted.items())
