"""What the keys of figures have in common: their types, and what is wrong with them.

Light, as figures.py is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge, Gt, Le, Len, Lt

from rmpc_bench.types import DesignError, MetricInfo, Positive

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

Inches = Annotated[float, Ge(1), Le(100)]
SingleRuns = Annotated[int, Ge(0), Le(10)]
Index = Annotated[int, Ge(0)]
OneOrTwo = Annotated[tuple[Index, ...], Len(1, 2)]
Level = Annotated[float, Gt(0), Lt(1)]
MOST_RADII = 4
Radii = Annotated[tuple[Positive, ...], Len(1, MOST_RADII)]
MOST_MARKS = 50
"""Time marks along a path."""

NO_RUN = "no run is recorded; record some with `record: {runs: 1}`"
NO_OUTPUT = "needs recorded outputs: record: {runs: 1, signals: [y]}"
TOO_CLOSE = f"more than {MOST_MARKS} time marks cannot be told apart: name a longer time"
SAME_METRIC = "must be another metric than x"
NO_MOMENTS = "needs ensemble moments: evaluate: [runs, moments]"
NO_P = "none of these methods tells a covariance P of its own"
NO_BELIEF = "none of these methods tells a set M or a covariance P of its own"
NO_STATES = "needs recorded states and estimates: record: {runs: 1, signals: [x, x_hat]}"


def other_states(method: str, n_hat: int, n: int | None) -> str:
    """Say that estimates cannot be compared with states."""
    return f"x_hat of '{method}' has {n_hat} components and x of the plant {n}: leave the method out with `order`"


def size_of(width: float, height: float | None, usual: float) -> tuple[float, float]:
    """Width and height of a picture [in], with the usual height if none is given."""
    for name, size in (("width", width), ("height", height)):
        if size is not None and not 1 <= size < math.inf:
            raise DesignError(f"must be at least 1 inch (got {size:g})", name)
    return width, usual if height is None else height


def metric_of(trials: Trials, name: str | None, key: str = "metric") -> MetricInfo:
    """Find the metric that a key names; the first one if it names none."""
    known = {info.name: info for info in trials.metrics}
    if name is None:
        return trials.metrics[0]
    if name not in known:
        raise DesignError(f"'{name}' is not a metric of this experiment (known: {', '.join(known)})", key)
    return known[name]


def methods_of(trials: Trials, order: list[str] | None) -> Sequence[str]:
    """Methods to show; all if none are given."""
    if order is None:
        return trials.methods
    for name in order:
        if name not in trials.methods:
            known = ", ".join(trials.methods)
            raise DesignError(f"'{name}' is not a method of this experiment (known: {known})", "order")
    if not order or len(set(order)) < len(order):
        raise DesignError("must name at least one method, and each one once", "order")
    return order


def recorded(point: Trials, order: list[str] | None) -> Sequence[str]:
    """Methods to show, all of which have recorded runs."""
    having = [name for name in point.methods if name in point.traces and len(point.traces[name].runs)]
    if not having:
        raise DesignError(NO_RUN, "")
    for name in methods_of(point, order) if order is not None else ():
        if name not in having:
            raise DesignError(f"no run of '{name}' is recorded (recorded: {', '.join(having)})", "order")
    return having if order is None else order


def having(point: Trials, quantities: Sequence[str], order: list[str] | None) -> Sequence[str]:
    """Methods to show, all of which have these ensemble moments (or their own P)."""
    there = {name: set(point.series.loc[point.series["method"] == name, "quantity"]) for name in point.methods}
    for quantity in quantities:
        if not any(quantity in found for found in there.values()):
            raise DesignError(NO_P if quantity == "P" else NO_MOMENTS, "")
    able = [name for name in point.methods if there[name].issuperset(quantities)]
    if not able:
        raise DesignError(f"no method has both {' and '.join(quantities)}", "")
    for name in methods_of(point, order) if order is not None else ():
        if name not in able:
            lacking = ", ".join(quantity for quantity in quantities if quantity not in there[name])
            raise DesignError(f"'{name}' has no {lacking} (those that have: {', '.join(able)})", "order")
    return able if order is None else order


def radii_of(sigmas: Sequence[float]) -> Sequence[float]:
    """Radii of ellipses, as many as there are kinds of lines."""
    if not 1 <= len(sigmas) <= MOST_RADII or not all(0 < radius < math.inf for radius in sigmas):
        raise DesignError(f"must be 1 to {MOST_RADII} positive numbers", "sigmas")
    return sigmas
