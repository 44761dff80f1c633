"""Stage 3, expand the sweep: the key `sweep`, read and checked, and one tree per point.

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

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import product
from math import prod
from typing import Any, NamedTuple

from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
from rmpc_bench.config_file.inherit import FILE, PATH, compose, open_section
from rmpc_bench.config_file.tree import Items, Map, Mark, Problems, assign, locate, locate_key, plain, problem_at, split
from rmpc_bench.config_file.yaml import Override
from rmpc_bench.registry import unknown
from rmpc_bench.types import ConfigError, Problem
from rmpc_bench.types.sweep_points import lies_at, value_text

SWEPT = (
    *("seed", "time", "uncertainty", "plant", "model", "noise", "initial", "reference", "input"),
    *("estimator", "controller"),
)  # top-level keys whose paths may be swept, beside those of a method

METHOD_COMPONENTS = ("model", "estimator", "controller")
"""Components of a method whose paths may be swept; the same keys at the top level are the defaults of all methods."""

NAME = "name"  # key of a zip that names its points; it is no path

MAX_POINTS = 10_000


class SweptValue(NamedTuple):
    """One value of a swept path, with the text that names it."""

    text: str
    tree: Any
    mark: Mark
    key_mark: Mark
    kept: bool = False  # whether the value of the file stays, because a row does not name the path


class Axis(NamedTuple):
    """Paths that change together, with their values: one path of a grid, or all paths of a zip."""

    paths: tuple[str, ...]
    values: list[tuple[SweptValue, ...]]

    def texts(self, row: Sequence[SweptValue]) -> dict[str, str]:
        """Return path -> text of its value in one of the rows."""
        return {path: value.text for path, value in zip(self.paths, row, strict=True)}


def columns(zipped: Any) -> list[str]:
    """Paths of a zip, given as a mapping from paths to lists or as a list of rows; the name first."""
    rows = [zipped] if isinstance(zipped, Map) else [row for row in zipped or () if isinstance(row, Map)]
    paths = [path for row in rows for path in row]
    return sorted(dict.fromkeys(paths), key=lambda path: path != NAME)


def assigned(tree: Map, paths: Sequence[str], values: Sequence[SweptValue], without: Collection[str] = (NAME,)) -> Map:
    """Set the values of some paths; raises a ConfigError if a path leads through something that is no mapping."""
    for path, value in sorted(zip(paths, values, strict=True), key=lambda pair: pair[0] != PATH):
        if path not in without and not value.kept:
            tree = assign(open_section(tree, path), path, value.tree, value.mark, value.key_mark)
    return tree


def _text(value: Any) -> str:
    """Name a value; that of a file that has been read is its name as given."""
    # A component from a Python file has a key of the same name, but no plant.
    read = isinstance(value, Map) and isinstance(value.get(FILE), str) and "plant" in value
    return str(value[FILE]) if read else value_text(plain(value))


class SweepReader:
    """Reads the section `sweep` of a configuration and collects its problems."""

    def __init__(self, tree: Map, sweep: Any) -> None:
        self.tree, self.sweep = tree, sweep
        self.problems = Problems()
        self.refused = {NAME}

    def note(self, path: Sequence[str | int], message: str, *, key: bool = False) -> None:
        """Add a problem at the value (or the key) of a path inside the section."""
        self.problems.append(problem_at(self.tree, ["sweep", *path], message, key=key))

    def axes(self) -> list[Axis]:
        """Read the grid and the zip."""
        if not isinstance(self.sweep, Map):
            self.note([], f"must be a mapping (got {plain(self.sweep)!r})")
            return []
        for key in self.sweep:
            if key not in ("grid", "zip", "exclude"):
                self.note([key], unknown(key, ("grid", "zip", "exclude"), "key"), key=True)
        grid, zipped = self._lists("grid"), self.sweep.get("zip")
        together = self._rows(zipped) if isinstance(zipped, Items) else self._zip_of_lists(self._lists("zip"))
        axes = [Axis((path,), [(value,) for value in values]) for path, values in grid.items()] + together
        if not axes and not self.problems:
            self.note([], "needs a grid or a zip with at least one path")
        self._check_overlaps([path for axis in axes for path in axis.paths])
        for axis in together:
            self._check_rows(axis)
        return axes

    def _zip_of_lists(self, lists: Mapping[str, list[SweptValue]]) -> list[Axis]:
        if len({len(values) for values in lists.values()}) > 1:
            lengths = ", ".join(f"{path} has {len(values)}" for path, values in lists.items())
            self.note(["zip"], f"all paths must have the same number of values ({lengths})")
        paths = tuple(columns(Map(lists, mark=self.sweep.mark)))
        return [Axis(paths, list(zip(*(lists[path] for path in paths), strict=False)))] if lists else []

    def _rows(self, rows: Items) -> list[Axis]:
        """Read a zip given row by row; a path that a row does not name stays as it is in the file."""
        for number, row in enumerate(rows):
            if not isinstance(row, Map):
                self.note(["zip", number], f"must be a mapping from paths to values (got {plain(row)!r})")
        if not rows:
            self.note(["zip"], "must not be empty")
        paths = columns(rows)
        for path in paths:
            if path != NAME:
                first = next(number for number, row in enumerate(rows) if isinstance(row, Map) and path in row)
                self._check_path(["zip", first, path], path)
            elif any(path not in row for row in rows if isinstance(row, Map)):
                self.note(["zip"], "either all rows have a name or none has")
        return [Axis(tuple(paths), [tuple(self._in_row(row, path) for path in paths) for row in rows])]

    def _in_row(self, row: Any, path: str) -> SweptValue:
        if not isinstance(row, Map) or path not in row:
            return SweptValue(self._existing(path), None, self.sweep.mark, self.sweep.mark, kept=True)
        return SweptValue(_text(row[path]), row[path], locate(row, [path]), locate_key(row, [path]))

    def _existing(self, path: str) -> str:
        """Text of a value as it stands in the file; empty where a default stands for it."""
        node: Any = self.tree
        with suppress(ConfigError):
            for step in split(path, self.tree.mark):
                node = node.get(step, "") if isinstance(node, Map) else ""
        return value_text(plain(node))

    def _check_rows(self, axis: Axis) -> None:
        seen: set[tuple[str, ...]] = set()
        for number, row in enumerate(axis.values, 1):
            texts = tuple(value.text for value in row)
            if texts in seen:
                self.note(["zip"], f"values {number} of all paths are given twice")
            seen.add(texts)
        if axis.paths == (NAME,):
            self.note(["zip"], "names nothing: give it at least one path")
        elif NAME in axis.paths:
            names = [row[0] for row in axis.values]
            if len({value.text for value in names}) < len(names):
                self.note(["zip"], "two points have the same name")
            if any(not isinstance(value.tree, str) for value in names if not value.kept):
                self.note(["zip"], "a name is a text")

    def singles(self, base: Map, axes: Sequence[Axis]) -> list[Map]:
        """Return configurations that together contain every value that can be set, so that each one is validated."""
        first = base
        for axis in axes:
            with suppress(ConfigError):
                first = assigned(first, axis.paths, axis.values[0], self.refused) if axis.values else first
        found = [first]
        for axis in axes:
            for row in axis.values[1:MAX_POINTS]:
                with suppress(ConfigError):
                    found.append(assigned(first, axis.paths, row, self.refused))
        return found

    def _check_overlaps(self, paths: Sequence[str]) -> None:
        """Refuse paths of which one would overwrite the other."""
        steps: list[tuple[str, list[str]]] = []
        for path in paths:
            with suppress(ConfigError):
                steps.append((path, split(path, self.tree.mark)))
        for number, (path, mine) in enumerate(steps):
            for other, theirs in steps[:number]:
                common = min(len(mine), len(theirs))
                if mine[:common] == theirs[:common]:
                    place = ["zip"] if path in columns(self.sweep.get("zip")) else ["grid"]
                    place += [path] if isinstance(self.sweep.get(place[0]), Map) else []
                    self.note(place, f"{path} changes what {other} changes, too; sweep one of them", key=True)

    def _lists(self, name: str) -> dict[str, list[SweptValue]]:
        """Values of every path of a section that maps paths to lists."""
        section = self.sweep.get(name, Map(mark=self.sweep.mark))
        if not isinstance(section, Map):
            self.note([name], f"must be a mapping from paths to lists of values (got {plain(section)!r})")
            return {}
        found = {}
        for path, given in section.items():
            if (name, path) != ("zip", NAME):
                self._check_path([name, path], path)
            if not isinstance(given, Items | Map) or not given:
                self.note([name, path], "must be a list of values, or a mapping from names to values, not empty")
                continue
            found[path] = self._named(given, locate_key(section, [path]))
            if name == "grid" and len({value.text for value in found[path]}) < len(found[path]):
                self.note([name, path], "a value is given twice")
        return found

    def _named(self, given: Items | Map, key_mark: Mark) -> list[SweptValue]:
        if isinstance(given, Map):
            return [SweptValue(name, item, locate(given, [name]), key_mark) for name, item in given.items()]
        marks = [locate_key(given, [number]) for number in range(len(given))]
        return [SweptValue(_text(item), item, mark, key_mark) for item, mark in zip(given, marks, strict=True)]

    def _check_path(self, place: Sequence[str | int], path: str) -> None:
        steps = self.problems.tried(split, path, locate_key(self.tree, ["sweep", *place]))
        message = "" if steps is None else self._refusal(steps)
        if message:
            self.note(place, message, key=True)
        if steps is None or message:
            self.refused.add(path)

    def _refusal(self, steps: Sequence[str]) -> str:
        """Say why a path cannot be swept; empty when it can."""
        if steps[0] == "time":
            return "" if steps[1:] == ["step"] else "of the time only its step can be swept: time.step"
        if steps[0] != "methods":
            return "" if steps[0] in SWEPT else unknown(steps[0], (*SWEPT, "methods"), "key that can be swept")
        methods = self.tree.get("methods")
        if len(steps) < 3:
            return "name a method and one of its components, such as methods.NAME.estimator.c"
        if isinstance(methods, Map) and steps[1] not in methods:
            return unknown(steps[1], methods, "method")
        noun = "component of a method that can be swept"
        return "" if steps[2] in METHOD_COMPONENTS else unknown(steps[2], METHOD_COMPONENTS, noun)

    def chosen(
        self, axes: Sequence[Axis], excluded: Sequence[Mapping[str, str]]
    ) -> Iterator[tuple[tuple[SweptValue, ...], ...]]:
        """Combine the axes and leave out excluded points."""
        size = prod(len(axis.values) for axis in axes)
        if size > MAX_POINTS:
            self.note([], f"there must be at most {MAX_POINTS:,} points (got {size:,})")
            return
        unused, is_left = {*range(len(excluded))}, False
        for values in product(*(axis.values for axis in axes)):
            there: dict[str, str] = {}
            for axis, row in zip(axes, values, strict=True):
                there |= axis.texts(row)
            hits = [number for number, given in enumerate(excluded) if lies_at(there, given)]
            unused.difference_update(hits)
            if not hits:
                is_left = True
                yield values
        for number in sorted(unused):
            self.note(["exclude", number], "excludes no point")
        if not is_left and not unused:
            self.note(["exclude"], "excludes every point")

    def excluded(self, axes: Sequence[Axis]) -> list[Mapping[str, str]]:
        """Read the section `exclude`."""
        known = [path for axis in axes for path in axis.paths]
        entries = self.sweep.get("exclude", []) if isinstance(self.sweep, Map) else []
        if not isinstance(entries, list):
            self.note(["exclude"], "must be a list of mappings from paths to values")
            return []
        found: list[Mapping[str, str]] = []
        for number, entry in enumerate(entries):
            if not isinstance(entry, Map) or not entry:
                self.note(["exclude", number], "must be a mapping from paths to values")
                continue
            for path in entry:
                if path not in known:
                    self.note(["exclude", number, path], unknown(path, known, "path of this sweep"), key=True)
            found.append({path: value_text(plain(value)) for path, value in entry.items()})
        return found


class SweptTree(NamedTuple):
    """The configuration at one point of a sweep, not yet validated."""

    coordinates: dict[str, str]  # path -> text of its value, in the order of the sweep
    tree: Map
    title: str = ""  # the point in words


class Sweep(NamedTuple):
    """A configuration at every point of its sweep."""

    tree: Map  # the configuration with its sweep
    points: list[SweptTree]
    # swept paths, those that change together as one axis; empty where there are problems
    axes: tuple[tuple[str, ...], ...]
    problems: Problems
    """Where there are some, the points have no coordinates: they only contain each value of the sweep once, so that
    later stages find the other problems of the file."""


def expand(tree: Map, overrides: Sequence[Override], access: CodeAccess = NO_ACCESS) -> Sweep:
    """Return the points of a configuration; without a sweep there is one, without coordinates."""
    found, problems = _points(tree)
    axes = () if problems else _axes(tree)
    if not problems:
        problems.extend(_refused(tree, axes, overrides))
    trees = [problems.tried(compose, point.tree, access) for point in found]
    points = [point._replace(tree=made) for point, made in zip(found, trees, strict=True) if made is not None]
    if not points:
        raise ConfigError(problems)
    return Sweep(tree, points, axes, problems)


def _points(tree: Map) -> tuple[list[SweptTree], Problems]:
    base = tree.copy()
    sweep = base.pop("sweep", None)
    if sweep is None:
        return [SweptTree({}, base)], Problems()
    section = SweepReader(tree, sweep)
    axes = section.axes()
    excluded = section.excluded(axes)
    chosen = [] if section.problems else list(section.chosen(axes, excluded))
    # A path may lead through something that is no mapping.
    found = section.problems.tried(lambda: [_point(base, axes, values) for values in chosen])
    if found is None or section.problems:
        found = [SweptTree({}, single) for single in section.singles(base, axes)]
    return found, section.problems


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
        texts = axis.texts(row)
        coordinates |= texts
        words += [texts[NAME]] if NAME in texts else [f"{path}={text}" for path, text in texts.items()]
    return SweptTree(coordinates, tree, ", ".join(words))


def _refused(tree: Map, axes: Sequence[Sequence[str]], overrides: Sequence[Override]) -> Iterator[Problem]:
    """Refuse overrides of values that the sweep replaces."""
    for path, _, mark in overrides:
        for swept in (path for axis in axes for path in axis if path != NAME):
            steps = split(swept, mark)
            if split(path, mark)[: len(steps)] == steps:
                section = "grid" if swept in tree["sweep"].get("grid", {}) else "zip"
                message = f"is swept, so this has no effect; set 'sweep.{section}.\"{swept}\"', or sweep=null"
                yield Problem(*mark, path, message)
