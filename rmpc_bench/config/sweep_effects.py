"""Whether the values of a sweep differ in what is computed: a path that changes nothing would label equal runs.

Two points are alike where every method has the same key, which identifies its trials.  A path may have an effect at
some values of the other paths only.  Of a zip the rows are compared, not each path on its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rmpc_bench.config.plant_source import PATH
from rmpc_bench.config.sweep import Sweep
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.config.sweep_section import METHOD_COMPONENTS, NAME
from rmpc_bench.config.tree import Map, join, locate_key, split
from rmpc_bench.types import Problem

_Row = tuple[str, ...]
_NAMED = 3
"""Keys that a message names."""


def axes_without_effect(sweep: Sweep, points: Sequence[SweepPoint]) -> Iterator[Problem]:
    """Refuse axes with two values whose points are alike wherever both occur, with the reason where it is known."""
    for axis in sweep.axes:
        alike = _alike(points, axis)
        if alike is None:
            continue
        is_grid = len(axis) == 1 and axis[0] in (sweep.tree["sweep"].get("grid") or {})
        place = ["sweep", "grid", axis[0]] if is_grid else ["sweep", "zip"]
        first, second = (", ".join(row) for row in alike)
        reasons = dict.fromkeys(filter(None, (_reason(sweep.tree, path) for path in axis if path != NAME)))
        why = "; ".join(reasons) or "nothing that is computed depends on it"
        message = f"has no effect: {first} and {second} give the same runs of every method; {why}"
        yield Problem(*locate_key(sweep.tree, place), join(place), message)


def _alike(points: Sequence[SweepPoint], axis: Sequence[str]) -> tuple[_Row, _Row] | None:
    """Return two values of an axis that no value of the other paths tells apart; None if there are none."""
    groups: dict[_Row, dict[_Row, tuple[tuple[str, str], ...]]] = {}
    for point in points:
        rest = tuple(text for path, text in point.coordinates.items() if path not in axis)
        row = tuple(point.coordinates[path] for path in axis)
        groups.setdefault(rest, {})[row] = tuple(point.method_keys.items())
    for group in groups.values():
        seen: dict[tuple[tuple[str, str], ...], _Row] = {}
        for row, keys in group.items():
            other = seen.setdefault(keys, row)
            both = (each for each in groups.values() if other in each and row in each)
            if other != row and all(each[other] == each[row] for each in both):
                return other, row
    return None


def _reason(tree: Map, path: str) -> str:
    """Say what replaces a swept value in a configuration; empty where it is not known."""
    root, *rest = split(path, tree.mark)
    if path == PATH:
        plant = tree.get("plant")
        own = [f"plant.{key}" for key in plant if key != "from"] if isinstance(plant, Map) else []
        more = f" and {len(own) - _NAMED} more" if len(own) > _NAMED else ""
        return f"{', '.join(own[:_NAMED])}{more} of this configuration replace it" if own else ""
    methods = tree.get("methods")
    given = [*methods.values()] if isinstance(methods, Map) else []
    if root in METHOD_COMPONENTS and given and all(isinstance(own, Map) and root in own for own in given):
        return f"every method has its own `{root}`"
    return ""
