"""The keys `grid` and `exclude` of `methods`: all combinations of models, estimators and controllers.

Later stages see ordinary methods, here KF+MPC, KF+PI and UKF+MPC::

    grid:
      estimator: {KF: {kind: kalman}, UKF: {kind: unscented-kalman, tune: {alpha: [0.1, 2]}}}
      controller: {MPC: {kind: mpc, Hp: 10}, PI: {kind: pid, Kp: 2}}
    exclude: [{estimator: UKF, controller: PI}]
    KF+PI: {controller: {Kp: 3}}
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import prod
from typing import Annotated, Any

from annotated_types import Len

from rmpc_bench.config_file.keys import shown, validate
from rmpc_bench.config_file.tree import (
    Items,
    Map,
    Problems,
    assign,
    given_forms,
    locate_key,
    merge,
    problem_at,
    with_kind,
)
from rmpc_bench.registry import unknown

GRID, EXCLUDE = "grid", "exclude"
AXES = ("model", "estimator", "controller")
MAX_METHODS = 5000
JOINT = "+"  # between the names of the entries in the name of a method
_TYPES: dict[str, Any] = {
    GRID: Annotated[dict[str, Annotated[dict[str, dict[str, Any]], Len(1)]], Len(1)],
    EXCLUDE: list[Annotated[dict[str, str], Len(1)]] | None,
}
_NO_METHOD = "`grid` and `exclude` are no names of methods"


def with_grid(tree: Map) -> Map:
    """Return a configuration with the methods of its grid in place of it; a ConfigError has all that is wrong there."""
    methods, wrong = tree.get("methods"), Problems()
    if not isinstance(methods, Map) or not {*_TYPES} & {*methods}:
        return tree
    for key, kind in _TYPES.items():
        wrong.tried(validate, kind, methods.get(key), ["methods", key], mark=locate_key(methods, [key]))
    Problems(replace(each, message=f"{each.message}; {_NO_METHOD}") for each in wrong).stop()
    Problems(problem_at(tree, ["methods", *path], text, key=True) for path, text in _wrong(methods, tree)).stop()
    grid, mark, found = methods[GRID], locate_key(methods, [GRID]), Map(mark=methods.mark)
    cells, first = [each for each in product(*grid.values()) if not _is_excluded(methods, each)], grid[next(iter(grid))]
    for names in cells:
        name, method = JOINT.join(names), _method(grid, names)
        own = methods.get(name)
        if own is not None:
            # What is no mapping is refused where methods are read.
            method = merge(_with_kinds(method), _with_kinds(own)) if isinstance(own, Map) else own
        found.put(name, method, *(methods.places(name) if name in methods else first.places(names[0])))
    for name in methods:
        if name not in found and name not in _TYPES:
            found.take(methods, name)
    result, statistics = tree.copy(), tree.get("statistics", Map(mark=mark))
    result["methods"] = found
    if len(grid) == 2 and isinstance(statistics, Map) and "two_way" not in statistics:
        levels = {
            axis: Items([name for name in grid[axis] if any(cell[place] == name for cell in cells)], mark=mark)
            for place, axis in enumerate(grid)
        }
        result = assign(result, "statistics.two_way", Map(levels, mark=mark), mark)
    return result


def _is_excluded(methods: Map, names: Sequence[str]) -> bool:
    cell = dict(zip(methods[GRID], names, strict=True))
    return any(entry.items() <= cell.items() for entry in methods.get(EXCLUDE) or ())


def _wrong(methods: Map, tree: Map) -> Iterator[tuple[list[str | int], str]]:
    """Yield the path of a key and what is wrong there, in a grid whose types are right."""
    grid: Map = methods[GRID]
    for axis, entries in grid.items():
        if axis not in AXES:
            yield [GRID, axis], f"{unknown(axis, AXES, 'axis of methods.grid')}; {_NO_METHOD}"
        for name, entry in entries.items():
            if JOINT in name or not name:
                yield [GRID, axis, name], f"must not be empty or contain {JOINT!r}, which joins names of entries"
            if axis in AXES and tree.get(axis) is None and not ("kind" in entry or given_forms(f"{axis}s", entry)):
                yield [GRID, axis, name], f"'kind' is missing (rmpc-bench list {axis}s); entries: {', '.join(entries)}"
            if "tune" in entry and not (isinstance(ranges := entry["tune"], Map) and ranges):
                about = "must be a mapping from paths inside the component, such as {alpha: [0.1, 2]}"
                yield [GRID, axis, name, "tune"], f"{about} (got {shown(ranges)})"
    for number, entry in enumerate(methods.get(EXCLUDE) or ()):
        for axis, name in entry.items():
            if axis not in grid:
                yield [EXCLUDE, number, axis], unknown(axis, grid, "axis of methods.grid")
            elif name not in grid[axis]:
                yield [EXCLUDE, number, axis], f"excludes no method: {unknown(name, grid[axis], axis)}"
    if (n := prod(map(len, grid.values()))) > MAX_METHODS:
        yield [GRID], f"there must be at most {MAX_METHODS:,} methods (got {n:,})"
    for method in methods:
        names = method.split(JOINT)
        is_cell = len(names) == len(grid) and all(map(dict.__contains__, grid.values(), names))
        if is_cell and _is_excluded(methods, names):
            yield [method], "is left out by `methods.exclude`"


def _method(grid: Mapping[str, Map], names: Sequence[str]) -> Map:
    """Return one entry of every axis as a method."""
    mark = next(iter(grid.values())).places(names[0])[1]
    method, tune, labels = Map(mark=mark), Map(mark=mark), []
    for (axis, entries), name in zip(grid.items(), names, strict=True):
        entry, places = entries[name].copy(), entries.places(name)
        method.put(axis, entry, *places)
        if "label" in entry:
            method.put("label", entry["label"], *entry.places("label"))
        labels.append(entry.pop("label", name))
        ranges = entry.pop("tune", Map(mark=mark))
        for path in ranges:
            method.put("tune", tune, *entry.places("tune"))
            tune.put(f"{axis}.{path}", ranges[path], *ranges.places(path))
    if "label" in method and all(isinstance(label, str) for label in labels):
        method["label"] = " + ".join(labels)
    return method


def _with_kinds(method: Map) -> Map:
    """Return a method whose components have their kinds, so that another kind replaces one as a whole."""
    return method.like({key: with_kind(f"{key}s", value) if key in AXES else value for key, value in method.items()})
