"""Axis of a figure over a swept value: numbers in order on a linear or logarithmic scale, or categories."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.figures.labels import literal
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

POINTS = "points"
"""In place of a path: every point of the sweep is a category."""
NAME = "name"
"""Path of the names that the rows of a zip have."""
MOST_TICKS = 8
"""Swept numbers that all have a tick of their own."""
WIDE = 8.0
"""Ratio of the largest to the smallest number from which on a logarithmic axis is considered."""
PER_CENT = re.compile(r"(?P<both>\+-)?\s*(?P<number>[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(?P<unit>%)?")
OWNERS = {"controller": "the controller", "estimator": "the estimator", "model": "the design model"}
OWNERS |= {section: f"the {section}" for section in ("plant", "noise", "reference", "input", "time", "uncertainty")}
OWNERS["initial"] = "the initial state"
"""First part of a path -> whose key it is, in words."""
UNITS = {"time.step": "s", "time.duration": "s"}
"""Paths whose unit does not depend on the experiment."""


class SweepAxis(NamedTuple):
    """The values of a swept path in the order of the axis."""

    path: str
    """The path; `POINTS` where every point is a category."""
    texts: tuple[str, ...]
    """Values as the sweep writes them."""
    numbers: Array | None
    """(values,) ascending numbers; None where the values are categories."""
    unit: str
    words: str
    """The path in words."""

    @property
    def is_geometric(self) -> bool:
        """Whether the numbers are positive and rather have equal ratios than equal differences."""
        if self.numbers is None or len(self.numbers) < 3 or self.numbers[0] <= 0:
            return False
        if self.numbers[-1] < WIDE * self.numbers[0]:
            return False
        return _unevenness(np.diff(np.log(self.numbers))) < _unevenness(np.diff(self.numbers))

    @property
    def label(self) -> str:
        """Label of the axis; empty for categories that speak for themselves."""
        if self.path in (POINTS, NAME):
            return ""
        return f"{literal(self.words)} [{self.unit}]" if self.unit else literal(self.words)

    def position(self, text: str) -> float:
        """Where a value lies on the axis: its number, or the index of its category."""
        place = self.texts.index(text)
        return float(place) if self.numbers is None else float(self.numbers[place])

    def value_words(self, text: str) -> str:
        """Name a value in a sentence, such as ``Hp = 10``; a category alone."""
        if self.path in (POINTS, NAME) or re.search(r"\w \w", text):
            return text
        return f"{self.path.rpartition('.')[2]} = {text}"

    def scale(self, axes: Axes, *, horizontal: bool = True) -> None:
        """Give an axis of a panel its scale, and a tick at every swept number where they are few."""
        from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter

        assert self.numbers is not None, "categories have no scale"
        if self.is_geometric:
            (axes.set_xscale if horizontal else axes.set_yscale)("log")
        if len(self.numbers) <= MOST_TICKS:
            axis = axes.xaxis if horizontal else axes.yaxis
            axis.set_major_locator(FixedLocator(list(self.numbers)))
            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))


def axis_of(points: Sequence[Mapping[str, str]], path: str, titles: Sequence[str] = ()) -> SweepAxis:
    """Find the axis of a swept path, or of `POINTS`, which have titles, from the texts of values by point and path."""
    if path == POINTS:
        return SweepAxis(POINTS, tuple(titles), None, "", "point of the sweep")
    texts = tuple(dict.fromkeys(point[path] for point in points))
    found = [_number(text) for text in texts]
    known = [each for each in found if each is not None]
    units = {unit for _, unit in known}
    if len(known) < len(texts) or len(units) != 1:
        return SweepAxis(path, texts, None, "", in_words(path))
    order = sorted(range(len(texts)), key=lambda place: known[place][0])
    numbers = np.array([known[place][0] for place in order])
    (unit,) = units
    return SweepAxis(path, tuple(texts[place] for place in order), numbers, unit or UNITS.get(path, ""), in_words(path))


def usual_path(points: Sequence[Mapping[str, str]]) -> str | None:
    """Choose the path of a figure that names none: the only one, or the names of a zip that determine all others."""
    paths = list(points[0]) if points else []
    if len(paths) == 1:
        return paths[0]
    if NAME in paths and len(other_paths(points, NAME)) == 0:
        return NAME
    return None


def other_paths(points: Sequence[Mapping[str, str]], *shown: str) -> list[str]:
    """Return the paths that the shown ones do not determine, as they do for values that change together.

    `POINTS` stands for all; points have the texts of values by path.
    """
    if POINTS in shown or not points:
        return []
    found = []
    for path in points[0]:
        pairs = {(*(point[each] for each in shown), point[path]) for point in points}
        if path not in shown and len(pairs) > len({pair[:-1] for pair in pairs}):
            found.append(path)
    return found


def panel_title(point: Mapping[str, str], paths: Sequence[str]) -> str:
    """Name some coordinates of a point, such as ``set=stacked``, by the last parts of the paths if these are unique."""
    last = [path.rpartition(".")[2] for path in paths]
    names = last if len(set(last)) == len(last) else list(paths)
    return ", ".join(f"{name}={point[path]}" for name, path in zip(names, paths, strict=True))


def in_words(path: str) -> str:
    """Say which key a path means, such as ``Hp of the controller``.

    Examples
    --------
    >>> in_words("controller.Hp"), in_words("methods.R-MPC.estimator.c"), in_words("runs")
    ('Hp of the controller', 'c of the estimator of R-MPC', 'runs')
    """
    first, *rest = path.split(".")
    method = ""
    if first == "methods" and len(rest) > 2:
        # The name of a method may have points itself.
        section = next((place for place, part in enumerate(rest) if part in OWNERS), len(rest) - 1)
        method = f" of {'.'.join(rest[:section])}"
        first, rest = rest[section], rest[section + 1 :]
    if not rest:
        return path
    return f"{rest[-1].replace('_', ' ')} of {OWNERS.get(first, first)}{method}"


def _number(text: str) -> tuple[float, str] | None:
    """Read a number and its unit, which is empty, ``%`` or ``+-%``; None for other texts."""
    found = PER_CENT.fullmatch(text.strip())
    if found is None:
        return None
    value = float(found["number"])
    if not math.isfinite(value) or (found["both"] and not found["unit"]):
        return None
    return value, ("\N{PLUS-MINUS SIGN}%" if found["both"] else "%") if found["unit"] else ""


def _unevenness(steps: Array) -> float:
    """Spread of the steps relative to their mean."""
    return float(np.std(steps) / np.mean(steps))
