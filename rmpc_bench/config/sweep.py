"""Stage 3, expand the sweep: one tree per point.

``grid`` combines every value of a path with every value of the others, the paths of ``zip`` change together, and
``exclude`` removes points.  A value may be a whole component.  Values given as a mapping have names, which tables and
claims show instead of the values.  A zip is a mapping from paths to lists, or a list of rows; a row leaves a path that
it does not name as it is in the file, and its ``name`` is the name of the point::

    sweep:
      grid: {controller.Hp: [10, 15]}
      zip:
        - {name: ours}
        - {name: printed, controller.law: printed, controller.R: 1e-6}
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.config.sweep_section import NAME, Axis, SweepReader, SweptValue, assigned, columns
from rmpc_bench.config_file.inherit import PATH, compose
from rmpc_bench.config_file.tree import Map, split
from rmpc_bench.config_file.yaml import Override
from rmpc_bench.types import ConfigError, Problem


class SweptTree(NamedTuple):
    """The configuration at one point of a sweep, not yet validated."""

    coordinates: dict[str, str]
    """Path -> text of its value, in the order of the sweep."""
    tree: Map
    title: str = ""
    """The point in words."""


class Sweep(NamedTuple):
    """A configuration at every point of its sweep."""

    tree: Map
    """The configuration with its sweep."""
    points: list[SweptTree]
    axes: tuple[tuple[str, ...], ...]
    """Swept paths, those that change together as one axis; empty where there are problems."""
    problems: list[Problem]
    """Where there are some, the points have no coordinates: they only contain each value of the sweep once, so that
    later stages find the other problems of the file."""


def expand(tree: Map, overrides: Sequence[Override], access: CodeAccess = NO_ACCESS) -> Sweep:
    """Return the points of a configuration; without a sweep there is one, without coordinates."""
    found, problems = _points(tree)
    axes = () if problems else _axes(tree)
    if not problems:
        problems = _refused(tree, axes, overrides)
    points = []
    for point in found:
        try:
            points.append(point._replace(tree=compose(point.tree, access)))
        except ConfigError as error:
            problems += error.problems
    if not points:
        raise ConfigError(problems)
    return Sweep(tree, points, axes, problems)


def _points(tree: Map) -> tuple[list[SweptTree], list[Problem]]:
    base = tree.copy()
    sweep = base.pop("sweep", None)
    if sweep is None:
        return [SweptTree({}, base)], []
    section = SweepReader(tree, sweep)
    axes = section.axes()
    excluded = section.excluded(axes)
    chosen = [] if section.problems else list(section.chosen(axes, excluded))
    try:
        found = [_point(base, axes, values) for values in chosen]
    except ConfigError as error:
        # A path leads through something that is no mapping.
        found, section.problems = [], [*section.problems, *error.problems]
    if section.problems:
        return [SweptTree({}, single) for single in section.singles(base, axes)], section.problems
    return found, []


def _axes(tree: Map) -> tuple[tuple[str, ...], ...]:
    """Return the swept paths of a valid sweep, those that change together as one."""
    sweep = tree.get("sweep") or {}
    together = tuple(columns(sweep.get("zip")))
    return (*((path,) for path in sweep.get("grid", {})), *((together,) if together else ()))


def _point(base: Map, axes: Sequence[Axis], values: Sequence[tuple[SweptValue, ...]]) -> SweptTree:
    tree, words = base, []
    coordinates: dict[str, str] = {}
    # Files first: the other values may replace some that come from them.
    for axis, row in sorted(zip(axes, values, strict=True), key=lambda pair: PATH not in pair[0].paths):
        tree = assigned(tree, axis.paths, row)
    for axis, row in zip(axes, values, strict=True):
        texts = {path: value.text for path, value in zip(axis.paths, row, strict=True)}
        coordinates |= texts
        words += [texts[NAME]] if NAME in texts else [f"{path}={text}" for path, text in texts.items()]
    return SweptTree(coordinates, tree, ", ".join(words))


def _refused(tree: Map, axes: Sequence[Sequence[str]], overrides: Sequence[Override]) -> list[Problem]:
    """Refuse overrides of values that the sweep replaces."""
    problems = []
    for path, _, mark in overrides:
        for swept in (path for axis in axes for path in axis if path != NAME):
            steps = split(swept, mark)
            if split(path, mark)[: len(steps)] == steps:
                section = "grid" if swept in tree["sweep"].get("grid", {}) else "zip"
                message = f"is swept, so this has no effect; set 'sweep.{section}.\"{swept}\"', or sweep=null"
                problems.append(Problem(*mark, path, message))
    return problems
