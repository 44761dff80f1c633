"""The keys `grid` and `exclude` of `methods`: every model, estimator and controller with every other, written out.

The axes are one to three of `model`, `estimator` and `controller`, and their entries have names::

    grid:
      estimator: {KF: {kind: kalman}, UKF: {kind: unscented-kalman, tune: {alpha: [0.1, 2]}}}
      controller: {MPC: {kind: mpc, Hp: 10}, PI: {kind: pid, Kp: 2}}
    exclude: [{estimator: UKF, controller: PI}]
    KF+PI: {controller: {Kp: 3}}

Later stages see ordinary methods, KF+MPC, KF+PI and UKF+MPC.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod
from typing import Any

from rmpc_bench.config_file.keys import shown
from rmpc_bench.config_file.tree import Items, Map, assign, locate_key, merge, problem_at, with_kind
from rmpc_bench.registry import unknown
from rmpc_bench.types import Problem

GRID, EXCLUDE = "grid", "exclude"
AXES = ("model", "estimator", "controller")
MAX_METHODS = 5000
JOINT = "+"
"""Between the names of the entries in the name of a method."""
_ENTRIES = "must be a mapping from names to mappings, such as {KF: {kind: kalman}}"
_TUNE = "must be a mapping from paths inside the component to ranges, such as {alpha: [0.1, 2]}"


def with_grid(tree: Map, problems: list[Problem]) -> Map:
    """Return a configuration with the methods of its grid in place of it; what is wrong adds to the problems."""
    methods = tree.get("methods")
    if not isinstance(methods, Map) or not {GRID, EXCLUDE} & {*methods}:
        return tree
    grid = _Grid(tree, methods)
    result = tree.copy()
    result["methods"] = grid.written_out()
    mark, statistics = locate_key(methods, [GRID]), tree.get("statistics", Map(mark=tree.mark))
    if len(grid.axes) == 2 and isinstance(statistics, Map):
        if "two_way" in statistics:
            message = "has the axes of `methods.grid` already; leave it out"
            problems.append(problem_at(tree, ["statistics", "two_way"], message, key=True))
        levels = {axis: Items(entries, mark=mark) for axis, entries in grid.axes.items()}
        result = assign(result, "statistics.two_way", Map(levels, mark=mark), mark)
    problems += grid.problems
    return result


class _Grid:
    """Reads the grid of a configuration and collects its problems."""

    def __init__(self, tree: Map, methods: Map) -> None:
        self._tree, self._methods = tree, methods
        self.problems: list[Problem] = []
        self.axes: dict[str, Map] = {}
        """Axis -> its entries."""
        grid: Any = methods.get(GRID)
        if GRID not in methods:
            self._note([EXCLUDE], "leaves out methods of `methods.grid`, which is not there", key=True)
        elif not isinstance(grid, Map) or not grid:
            self._note([GRID], f"must be a mapping from axes to entries (got {shown(grid)}); no method has this name")
        else:
            for axis, entries in grid.items():
                self._read_axis(axis, entries)
        if (n := prod(map(len, self.axes.values()))) > MAX_METHODS:
            self._note([GRID], f"there must be at most {MAX_METHODS:,} methods (got {n:,})", key=True)
        self._excluded = self._read_excluded() if self.axes and len(self.axes) == len(grid) else []

    def _note(self, path: Sequence[str | int], message: str, *, key: bool = False) -> None:
        self.problems.append(problem_at(self._tree, ["methods", *path], message, key=key))

    def _read_axis(self, axis: str, entries: Any) -> None:
        path = [GRID, axis]
        if axis not in AXES:
            message = f"axes of methods.grid are {', '.join(AXES)}; no method is called `grid`"
            self._note(path, message, key=True)
        elif not isinstance(entries, Map) or not entries:
            self._note(path, f"{_ENTRIES} (got {shown(entries)})")
        else:
            self.axes[axis] = entries
            for name, entry in entries.items():
                if JOINT in name:
                    self._note([*path, name], f"must not contain {JOINT!r}, which joins names of entries", key=True)
                if not isinstance(entry, Map):
                    self._note([*path, name], f"must be a mapping with the keys of the component (got {shown(entry)})")
                    continue
                if not isinstance(label := entry.get("label", ""), str):
                    self._note([*path, name, "label"], f"must be text (got {shown(label)})")
                if "tune" in entry and not (isinstance(entry["tune"], Map) and entry["tune"]):
                    self._note([*path, name, "tune"], f"{_TUNE} (got {shown(entry['tune'])})")

    def _read_excluded(self) -> list[dict[str, str]]:
        given, found = self._methods.get(EXCLUDE, []), list[dict[str, str]]()
        if not isinstance(given, list):
            message = "must be a list such as [{estimator: KF, controller: PI}]; no method has this name"
            self._note([EXCLUDE], f"{message} (got {shown(given)})")
        for number, entry in enumerate(given if isinstance(given, list) else ()):
            if not isinstance(entry, Map) or not entry:
                self._note([EXCLUDE, number], f"must be a mapping from axes to names of entries (got {shown(entry)})")
                continue
            found.append({axis: str(name) for axis, name in entry.items()})
            for axis, name in found[-1].items():
                if axis not in self.axes:
                    self._note([EXCLUDE, number, axis], unknown(axis, self.axes, "axis of methods.grid"), key=True)
                elif name not in self.axes[axis]:
                    message = unknown(name, self.axes[axis], f"{axis} of methods.grid")
                    self._note([EXCLUDE, number, axis], f"excludes no method: {message}")
        return found

    def written_out(self) -> Map:
        """Return the methods of the grid, the first axis slowest, then those beside it."""
        given, found = self._methods, Map(mark=self._methods.mark)
        for names in product(*self.axes.values()) if not self.problems else ():
            cell, name = dict(zip(self.axes, names, strict=True)), JOINT.join(names)
            if any(entry.items() <= cell.items() for entry in self._excluded):
                if name in given:
                    self._note([name], "is left out by `methods.exclude`", key=True)
                continue
            method, own = self._method(cell), given.get(name)
            if isinstance(own, Map):
                method = merge(_with_kinds(method), _with_kinds(own))
            places = given.places(name) if name in given else self.axes[next(iter(cell))].places(names[0])
            # What is no mapping is refused where methods are read.
            found.put(name, method if own is None or isinstance(own, Map) else own, *places)
        if not found and not self.problems:
            self._note([EXCLUDE], "excludes every method")
        for name in given:
            if name not in found and name not in (GRID, EXCLUDE):
                found.take(given, name)
        return found

    def _method(self, cell: dict[str, str]) -> Map:
        """Return one entry of every axis as a method."""
        of_first = self.axes[next(iter(cell))].places(next(iter(cell.values())))
        method, tune, labels = Map(mark=of_first[1]), Map(mark=of_first[1]), []
        for axis, name in cell.items():
            entry = self.axes[axis][name].copy()
            method.put(axis, entry, *self.axes[axis].places(name))
            if "label" in entry:
                method.put("label", "", *entry.places("label"))
            labels.append(entry.pop("label", name))
            ranges = entry.pop("tune", {})
            for path in ranges:
                method.put("tune", tune, *entry.places("tune"))
                tune.put(f"{axis}.{path}", ranges[path], *ranges.places(path))
        if "label" in method:
            method["label"] = " + ".join(labels)
        return method


def _with_kinds(method: Map) -> Map:
    """Return a method whose components have their kinds, so that another kind replaces one as a whole."""
    return method.like({key: with_kind(f"{key}s", value) if key in AXES else value for key, value in method.items()})
