"""What figures ask of an experiment, checked before it runs; whatever is asked in vain is a mistake of the file.

Light, as figures.py is: a configuration is checked with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias, TypeVar

from rmpc_bench.figures.keys import (
    MOST_MARKS,
    NO_BELIEF,
    NO_MOMENTS,
    NO_OUTPUT,
    NO_P,
    NO_RUN,
    NO_STATES,
    SAME_METRIC,
    TOO_CLOSE,
    other_states,
)
from rmpc_bench.figures.sweep_points import MOST_DOTS, MOST_PANELS, MOST_SIGNALS, TOO_MANY, TOO_MANY_DOTS
from rmpc_bench.types import ResultLayout

Mistakes: TypeAlias = list[tuple[str, str]]
"""Pairs of the key to blame and what is wrong with it."""

USUAL = ("y", "u")
"""Signals that trajectories show unless told otherwise."""

ERROR, OF_ERROR = "e", "y"
"""The control error r - y, which is not recorded but made of y."""

LACKING = "tells neither a set M nor a covariance P of its own"

_Belief = TypeVar("_Belief")
Figure = TypeVar("Figure", bound=Callable[..., Any])


def demands(mistakes: Callable[[Mapping[str, Any], ResultLayout], Mistakes]) -> Callable[[Figure], Figure]:
    """Give a kind of figure a function ``mistakes(keys, layout)``, which a configuration asks."""

    def mark(figure: Figure) -> Figure:
        vars(figure)["mistakes"] = mistakes
        return figure

    return mark


def of_boxplot(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """Not more panels than fit."""
    if layout.n_points <= MOST_PANELS or keys["at"]:
        return []
    return [("", f"{layout.n_points} points of the sweep do not fit (at most {MOST_PANELS}): choose with `at`")]


def usual(recorded: Iterable[str]) -> tuple[str, ...]:
    """Choose the signals to show: the usual ones that are recorded; where none is, the usual ones, to be refused."""
    there = set(recorded)
    return tuple(name for name in USUAL if name in there) or USUAL


def of_trajectories(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """Signals that are recorded, in a window of the experiment."""
    if not layout.signals:
        return [("", NO_RUN)]
    known = dict(layout.signals)
    if OF_ERROR in known:
        known[ERROR] = known[OF_ERROR]
    found, n_panels = [], 0
    for text in usual(layout.signals) if keys["signals"] is None else keys["signals"]:
        name, dot, index = text.partition(".")
        n = known.get(name)
        if name not in known:
            found.append(("signals", f"{name!r} is not recorded (recorded: {', '.join(layout.signals)})"))
        elif dot and not (index.isdecimal() and (n is None or int(index) < n)):
            found.append(("signals", f"{text!r} is not a component (they count from {name}.0)"))
        n_panels += 1 if dot or n is None else n
    if n_panels > MOST_SIGNALS and not found:
        found.append(("signals", f"asks for {n_panels} panels (at most {MOST_SIGNALS}): choose components such as x.0"))
    return found + _of_window(keys, layout.end)


def of_series(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """A series that some method has, with that component."""
    name, component = keys["quantity"], keys["component"]
    if name not in layout.series:
        known = ", ".join(layout.series) or "none"
        return [("quantity", f"{name!r} is no series of these methods (they have {known})")]
    shape = layout.series[name]
    if component is None:
        n = math.prod(shape)
        return [] if n <= MOST_PANELS else [("quantity", f"has {n} components: choose one with `component`")]
    parts = str(component).split(",")
    index = tuple(int(part) if part.strip().isdecimal() else -1 for part in parts)
    if len(index) == len(shape) and all(0 <= i < length for i, length in zip(index, shape, strict=True)):
        return []
    last = ",".join(str(length - 1) for length in shape)
    way_out = f"they go from {','.join('0' for _ in shape)} to {last}" if shape else "it is a number and has none"
    return [("component", f"{component!r} is no component of {name}: {way_out}")]


def of_tubes(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """A recorded run with states and estimates, methods that believe a set of them, and as many panels as fit."""
    if not {"x", "x_hat"} <= set(layout.signals):
        return [("", NO_STATES)]
    sizes = {name: belief[-1] for name, shapes in layout.arrays.items() if (belief := believed(shapes))}
    shown, states, found = keys["order"] or list(sizes), keys["components"], []
    if not sizes:
        return [("", NO_BELIEF)]
    found += [("order", f"'{name}' {LACKING}") for name in shown if name in layout.arrays and name not in sizes]
    found += _of_run(keys, layout)
    n = min((sizes[name] for name in shown if name in sizes), default=max(states) + 1)
    n_x = layout.signals["x"]
    others = [other_states(name, sizes[name], n_x) for name in shown if name in sizes and sizes[name] != n_x]
    found += [("order" if keys["order"] else "", message) for message in others]
    found += [("components", f"there is no state {i} (they count from 0 to {n - 1})") for i in states if i >= n][:1]
    if len(set(states)) < (2 if keys["over"] == "plane" else len(states)):
        found.append(("components", "must be two different states"))
    n_panels = len(shown) * (len(states) if keys["over"] == "time" else 1)
    if n_panels > MOST_PANELS:
        found.append(("order", f"{n_panels} panels {TOO_MANY}"))
    return found + _of_window(keys, layout.end)


def believed(shapes: Mapping[str, _Belief]) -> _Belief | None:
    """Choose what a method believes of its error: the set M, else the covariance P; None where it tells neither."""
    return shapes.get("M", shapes.get("P"))


def of_elements(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """A recorded run of a method that reports such a square matrix, which fits."""
    name, found = keys["signal"], _of_run(keys, layout)
    if layout.n_recorded and name not in layout.signals:
        found.append(("signal", f"{name!r} is not recorded (recorded: {', '.join(layout.signals)})"))
    elif layout.n_recorded:
        having = {method: shapes[name] for method, shapes in layout.reports.items() if name in shapes}
        order = keys["order"] or list(having)
        lacking = [method for method in order if method in layout.reports and method not in having]
        found += [("order", f"'{method}' does not report {name}") for method in lacking if having]
        shapes = [having[method] for method in order if method in having] if having else [None]
        found += [("signal", not_square(name, shape)) for shape in shapes if not is_square(shape)][:1]
        sizes = [shape[0] for shape in shapes if shape and is_square(shape)]
        found += [("width", text) for text in [too_narrow(max(sizes, default=1), keys["width"])] if text]
    return found + _of_window(keys, layout.end)


def is_square(shape: tuple[int, ...] | None) -> bool:
    """Whether it is that of a square matrix."""
    return shape is not None and len(shape) == 2 and shape[0] == shape[1]


def not_square(signal: str, shape: tuple[int, ...] | None) -> str:
    """Say that a signal is no square matrix."""
    sizes = f" ({' x '.join(map(str, shape))})" if shape else ""
    return f"{signal} is no square matrix{sizes}: show it with trajectories"


def too_narrow(n: int, width: float) -> str:
    """Say how wide a picture of n columns must be; nothing where it is."""
    least = 0.5 + 0.9 * n
    return "" if width >= least else f"{n} columns need a width of {least:g} inches (got {width:g})"


def of_plane(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """A recorded run with its output, two components of it, and time marks that can be told apart."""
    found = _of_run(keys, layout)
    n = layout.signals.get("y")
    if layout.n_recorded and "y" not in layout.signals:
        found.append(("", NO_OUTPUT))
    found += [
        ("components", f"there is no output {index} (they count from 0 to {n - 1})")
        for index in keys["components"]
        if n is not None and index >= n
    ][:1]
    if len(set(keys["components"])) < 2:
        found.append(("components", "must be two different outputs"))
    first, last = keys["from_"] or 0.0, layout.end if keys["to"] is None else min(keys["to"], layout.end)
    if keys["marks"] and layout.end and (last - first) / keys["marks"] > MOST_MARKS:
        found.append(("marks", TOO_CLOSE))
    return found + _of_window(keys, layout.end)


def of_pareto(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """Two metrics, and no more points than can be told apart."""
    found = [("y", SAME_METRIC)] if keys["x"] == keys["y"] else []
    n_methods = len(keys["order"] or layout.arrays)
    if n_methods > MOST_DOTS or (n_methods * layout.n_points > MOST_DOTS and not keys["at"]):
        found.append(("at", f"up to {n_methods * layout.n_points} points {TOO_MANY_DOTS}"))
    return found


def _of_run(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """A run that is recorded."""
    if not layout.n_recorded:
        return [("", NO_RUN)]
    if keys["run"] < layout.n_recorded:
        return []
    return [("run", f"run {keys['run']} is not recorded (recorded: {layout.n_recorded}, from 0 on)")]


def of_variance_with_bound(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """Ensemble moments and some method's P, with that state, in a window of the experiment."""
    found = _of_moments(layout, "cov(e)", "P")
    return found or _of_state(keys, layout.series["cov(e)"][0]) + _of_window(keys, layout.end)


def of_means(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """Ensemble moments, with that state, in a window of the experiment."""
    found = _of_moments(layout, "mean(x)", "mean(x_hat)")
    return found or _of_state(keys, layout.series["mean(x)"][0]) + _of_window(keys, layout.end)


def of_ellipses(keys: Mapping[str, Any], layout: ResultLayout) -> Mistakes:
    """Ensemble moments and some method's P, with two different states."""
    found = _of_moments(layout, "mean(x_hat)", "P")
    if found:
        return found
    n = min(layout.series["mean(x_hat)"][0], layout.series["P"][0])
    for index in keys["components"]:
        if index >= n:
            return [("components", f"there is no state {index} (they count from 0 to {n - 1})")]
    return [] if len(set(keys["components"])) == 2 else [("components", "must be two different states")]


def _of_moments(layout: ResultLayout, *names: str) -> Mistakes:
    lacking = [name for name in names if name not in layout.series]
    return [("", NO_P if lacking == ["P"] else NO_MOMENTS)] if lacking else []


def _of_state(keys: Mapping[str, Any], n: int) -> Mistakes:
    index = keys["component"]
    if index is None and n > MOST_PANELS:
        return [("component", f"there are {n} states, at most {MOST_PANELS} fit: choose one of 0 to {n - 1}")]
    if index is not None and index >= n:
        return [("component", f"there is no state {index} (they count from 0 to {n - 1})")]
    return []


def _of_window(keys: Mapping[str, Any], end: float) -> Mistakes:
    first, last = keys["from_"] or 0.0, end if keys["to"] is None else keys["to"]
    if end and first >= min(last, end):
        return [("from" if keys["from_"] is not None else "to", f"the window from {first:g} to {last:g} s is empty")]
    return []
