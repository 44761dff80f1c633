"""Points of a sweep: the text of a value, and the search for points with given values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from rmpc_bench.types.errors import unknown


def value_text(value: object) -> str:
    """Return the text of a value in tables and claims: ``8``, ``0.001``, ``{kind: kalman}``."""
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
    """Whether two texts name the same value of a sweep: 0.001 is 1e-3 and 0.1%."""
    try:
        return one == other or math.isclose(_number(one), _number(other), rel_tol=1e-12)
    except ValueError:
        return False


def _number(text: str) -> float:
    return float(text[:-1]) / 100 if text.endswith("%") else float(text)


def lies_at(there: Mapping[str, str], wanted: Mapping[str, str]) -> bool:
    """Whether a point of a sweep has all the wanted values."""
    return all(path in there and same_value(there[path], value) for path, value in wanted.items())


def no_such_point(points: Sequence[Mapping[str, str]], wanted: Mapping[str, str]) -> str:
    """Say why no point of a sweep has the wanted values; empty if one has them, or if no point is known."""
    if not points or any(lies_at(point, wanted) for point in points):
        return ""
    known = list(points[0])
    if not known:
        return "nothing is swept in this configuration"
    for name, value in wanted.items():
        if name not in known:
            return unknown(name, known, "path of the sweep")
        values = list(dict.fromkeys(point[name] for point in points))
        if not any(lies_at(point, {name: value}) for point in points):
            return f"{name} has no value {value} in the sweep (it has {', '.join(values[:10])})"
    return "the sweep has no such point"


def relevant_paths(rows: Sequence[tuple[Mapping[str, str], str]], axes: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the swept paths on which something depends; those of earlier axes are dropped first."""
    needed = list(axes)
    for axis in axes:
        rest = [path for other in needed if other is not axis for path in other]
        found: dict[tuple[str, ...], str] = {}
        same = all(found.setdefault(tuple(there[path] for path in rest), what) == what for there, what in rows)
        if same:
            needed.remove(axis)
    return tuple(path for axis in needed for path in axis)
