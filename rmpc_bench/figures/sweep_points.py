"""Selection of sweep points for a figure, and the titles of their panels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rmpc_bench.types import DesignError
from rmpc_bench.types.figure import PointValues
from rmpc_bench.types.result_layout import texts_of
from rmpc_bench.types.sweep_points import lies_at, no_such_point

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

MOST_PANELS = 6
"""Panels below each other that a reader can still compare."""


def points_at(trials: Trials, at: Sequence[PointValues] | None) -> Sequence[Trials]:
    """Select, once each, the points that have the values by path of an entry of `at`; all points if it is not given.

    Without a sweep it is the whole table.  Raises a DesignError when `at` names no point.
    """
    if at is None:
        return trials.each
    points: list[Trials] = []
    for values in at:
        points += [point for point in _having(trials, values) if point not in points]
    return points


def point_at(trials: Trials, at: PointValues | None) -> tuple[Trials, str]:
    """Return the first point that has the given values by path, or the first one of all, and its title.

    The title is empty where there is no sweep.  Raises a DesignError when `at` names no point.
    """
    points = trials.each if at is None else _having(trials, at)
    of_several = f" (first of {len(points)} points)" if len(points) > 1 else ""
    return points[0], short_title(points[0]) + of_several


def short_title(point: Trials) -> str:
    """Name a point by the last parts of its paths, such as ``Hp=10, Hu=8``; by whole paths if these are not unique.

    A value of several words, such as ``pi first``, stands without its path if it is the only one.  A point whose values
    share a name has its title, shortened in the same way.
    """
    # The title has only the name of values that change together.
    title = f", {point.title}, "
    named = "name" in point.point
    shown = {path: text for path, text in point.point.items() if not named or f", {path}={text}, " in title}
    last = [path.rpartition(".")[2] for path in shown]
    names = last if len(set(last)) == len(last) else list(shown)
    phrases = [text for text in shown.values() if re.search(r"\w \w", text)]
    words = [text if phrases == [text] else f"{name}={text}" for name, text in zip(names, shown.values(), strict=True)]
    if not named:
        return printed(", ".join(words))
    for (path, text), word in zip(shown.items(), words, strict=True):
        title = title.replace(f", {path}={text}, ", f", {word}, ")
    return printed(title[2:-2])


def printed(title: str) -> str:
    """Write the signs of a title as they are printed: a minus in front of a number, a cross between factors.

    Examples
    --------
    >>> printed("delta from -1 to 1, noise x 0.01, 1e-5, run-2")
    'delta from −1 to 1, noise × 0.01, 1e-5, run-2'
    """
    return re.sub(r"(?<= )x(?= \.?\d)", "×", re.sub(r"(?<![\w.)\]-])-(?=\.?\d)", "−", title))


def _having(trials: Trials, values: PointValues) -> Sequence[Trials]:
    texts = texts_of(values)
    message = no_such_point([point.point for point in trials.each], texts)
    if message:
        raise DesignError(message, "at")
    return [point for point in trials.each if lies_at(point.point, texts)]
