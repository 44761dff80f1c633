"""Sweeps: one configuration at many points.

``grid`` combines every value of a path with every value of the others, the paths of ``zip`` go hand in hand, and
``exclude`` takes points out.  A value may be a whole component; values given as a mapping have names, which tables
and claims show instead of them.  A zip is a mapping from paths to lists, or a list of rows, which leave what they do
not name as it is in the file; ``name`` beside its paths says what they come to::

    sweep:
      grid: {controller.Hp: [10, 15]}
      zip:
        - {name: ours}
        - {name: printed, controller.law: printed, controller.R: 1e-6}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rmpc_bench.config import reader
from rmpc_bench.config.inheritance import PATH
from rmpc_bench.config.reader import Map, Mark
from rmpc_bench.config.sweep_section import NAME, PARTS, Axis, Reader, Value, assigned, columns
from rmpc_bench.types import ConfigError, Problem


class Point(NamedTuple):
    """One configuration of a sweep."""

    coordinates: dict[str, str]
    """Path -> text of its value, in the order of the sweep."""
    tree: Map
    title: str = ""
    """The point in words."""


def points(tree: Map) -> tuple[list[Point], list[Problem]]:
    """Return the points of a configuration and what is wrong with its sweep.

    Without a sweep there is a single point without coordinates.  With a wrong one there are points without coordinates
    that contain each of its values, to show what else is wrong with the file.
    """
    base = tree.copy()
    sweep = base.pop("sweep", None)
    if sweep is None:
        return [Point({}, base)], []
    section = Reader(tree, sweep)
    axes = section.axes()
    excluded = section.excluded(axes)
    chosen = [] if section.problems else list(section.chosen(axes, excluded))
    try:
        found = [_point(base, axes, values) for values in chosen]
    except ConfigError as error:  # a path that leads through what is no mapping
        found, section.problems = [], [*section.problems, *error.problems]
    if section.problems:
        return [Point({}, single) for single in section.singles(base, axes)], section.problems
    return found, []


def swept_paths(tree: Map) -> tuple[tuple[str, ...], ...]:
    """Return the swept paths of a configuration that `points` has taken, those that change together as one."""
    sweep = tree.get("sweep") or {}
    together = tuple(columns(sweep.get("zip")))
    return (*((path,) for path in sweep.get("grid", {})), *((together,) if together else ()))


def _point(base: Map, axes: Sequence[Axis], values: Sequence[tuple[Value, ...]]) -> Point:
    tree, words = base, []
    coordinates: dict[str, str] = {}
    for axis, row in sorted(zip(axes, values, strict=True), key=lambda pair: PATH not in pair[0].paths):
        tree = assigned(tree, axis.paths, row)  # files first: the others may be laid over what comes from them
    for axis, row in zip(axes, values, strict=True):
        texts = {path: value.text for path, value in zip(axis.paths, row, strict=True)}
        coordinates |= texts
        words += [texts[NAME]] if NAME in texts else [f"{path}={text}" for path, text in texts.items()]
    return Point(coordinates, tree, ", ".join(words))


def depends(rows: Sequence[tuple[Mapping[str, str], str]], axes: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Name the paths on which something depends.

    Parameters
    ----------
    rows : coordinates of every point, and what is found there
    axes : the paths, those that change together as one
    """
    needed = list(axes)
    for axis in axes:
        rest = [path for other in needed if other is not axis for path in other]
        found: dict[tuple[str, ...], str] = {}
        same = all(found.setdefault(tuple(there[path] for path in rest), what) == what for there, what in rows)
        if same:
            needed.remove(axis)
    return tuple(path for axis in needed for path in axis)


def method_paths_first(axes: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """Order the axes so that `depends` drops paths into methods before paths into the truth."""
    roots = {path: path.split(".")[0] for axis in axes for path in axis}
    return sorted(axes, key=lambda axis: not all(roots[path] in (*PARTS, "methods", NAME) for path in axis))


def swept_overrides(tree: Map, given: Mapping[str, Mark]) -> list[Problem]:
    """Refuse overrides of what the sweep sets anyway; ``given`` maps their paths to their places."""
    problems = []
    for path, mark in given.items():
        for swept in (path for axis in swept_paths(tree) for path in axis if path != NAME):
            steps = reader.split(swept, mark)
            if reader.split(path, mark)[: len(steps)] == steps:
                section = "grid" if swept in tree["sweep"].get("grid", {}) else "zip"
                message = f"is swept, so this has no effect; set 'sweep.{section}.\"{swept}\"', or sweep=null"
                problems.append(Problem(*mark, path, message))
    return problems
