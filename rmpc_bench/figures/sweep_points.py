"""The points of a sweep that a figure shows, and what they are called above their panels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

from rmpc_bench.types import DesignError
from rmpc_bench.types.sweep_points import lies_at, value_text

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

MOST_PANELS = 6
MOST_SIGNALS = 8
"""Panels of trajectories: low ones do, and four inputs beside three errors are usual."""
TOO_MANY = f"do not fit (at most {MOST_PANELS}): name fewer methods or states"
MOST_DOTS = 60
TOO_MANY_DOTS = f"cannot be told apart (at most {MOST_DOTS}): name some points of the sweep, or fewer methods"
Values: TypeAlias = dict[str, Any]
"""Values by path of the sweep, such as ``{controller.Hp: 10}``; every one as the sweep gives it, or its name."""


def chosen(trials: Trials, at: Sequence[Values] | None) -> tuple[Trials, ...]:
    """Find the points of a figure that has one panel for each.

    Parameters
    ----------
    trials : the table of trials
    at : values by path, each of which picks all points that have them; all points if not given

    Returns
    -------
    the tables of the points; the whole table where there is no sweep

    Raises
    ------
    DesignError
        when `at` names no point, or there are more than `MOST_PANELS`
    """
    points = wanted(trials, at)
    if len(points) > MOST_PANELS:
        example = ", ".join(f"{path}: {value}" for path, value in points[0].point.items())
        raise DesignError(
            f"{len(points)} points of the sweep do not fit into one figure (at most {MOST_PANELS}): "
            f"choose with `at`, such as [{{{example}}}]",
            "at",
        )
    return tuple(points)


def wanted(trials: Trials, at: Sequence[Values] | None) -> Sequence[Trials]:
    """Find points, however many.

    Parameters
    ----------
    trials : the table of trials
    at : values by path, each of which picks all points that have them; all points if not given

    Raises
    ------
    DesignError
        when `at` names no point
    """
    if at is None:
        return trials.each
    points: list[Trials] = []
    for values in at:
        points += [point for point in _having(trials, values) if point not in points]
    if not points:
        raise DesignError("must name at least one point", "at")
    return points


def fitting(n_panels: int) -> int:
    """Return a number of panels, if so many fit.

    Parameters
    ----------
    n_panels : how many are asked for

    Raises
    ------
    DesignError
        when they are more than `MOST_PANELS`
    """
    if n_panels > MOST_PANELS:
        raise DesignError(f"{n_panels} panels {TOO_MANY}", "order")
    return n_panels


def only(trials: Trials, at: Values | None) -> tuple[Trials, str]:
    """Find the point of a figure that shows one.

    Parameters
    ----------
    trials : the table of trials
    at : values by path; where several points have them, or nothing is given, the first one is taken

    Returns
    -------
    the table of the point, and what stands above it; an empty text where there is no sweep
    """
    points = trials.each if at is None else _having(trials, at)
    of_several = f" (first of {len(points)} points)" if len(points) > 1 else ""
    return points[0], short(points[0]) + of_several


def short(point: Trials) -> str:
    """Name a point by the last parts of its paths, such as ``Hp=10, Hu=8``; in full where these are not unique.

    A value of several words, such as ``pi first``, stands for itself where it is the only one.  A point whose values
    have a name together has its title, shortened in the same way.
    """
    title = f", {point.title}, "  # of what changes together there is the name only
    named = "name" in point.point
    shown = {path: text for path, text in point.point.items() if not named or f", {path}={text}, " in title}
    last = [path.rpartition(".")[2] for path in shown]
    names = last if len(set(last)) == len(last) else list(shown)
    phrases = [text for text in shown.values() if re.search(r"\w \w", text)]
    words = [text if phrases == [text] else f"{name}={text}" for name, text in zip(names, shown.values(), strict=True)]
    if not named:
        return ", ".join(words)
    for (path, text), word in zip(shown.items(), words, strict=True):
        title = title.replace(f", {path}={text}, ", f", {word}, ")
    return title[2:-2]


def _having(trials: Trials, values: Values) -> Sequence[Trials]:
    if not trials.points:
        raise DesignError("this experiment has no sweep to choose from", "at")
    for path in values:
        if path not in trials.paths:
            raise DesignError(f"'{path}' is not a path of the sweep (known: {', '.join(trials.paths)})", "at")
    texts = {path: value_text(value) for path, value in values.items()}
    found = [point for point in trials.points if lies_at(point.point, texts)]
    if not found:
        listed = [short(point) for point in trials.points[:MOST_PANELS]]
        there = "; ".join([*listed, "..."] if len(trials.points) > MOST_PANELS else listed)
        sought = ", ".join(f"{path}={text}" for path, text in texts.items())
        raise DesignError(f"no point of the sweep has {sought} (there are {there})", "at")
    return found
