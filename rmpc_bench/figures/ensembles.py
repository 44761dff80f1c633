"""Mean and variance of an ensemble over the samples, one panel per state: exact, from runs, and the methods' bounds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures import curves
from rmpc_bench.figures.curves import Window
from rmpc_bench.figures.keys import NO_P
from rmpc_bench.figures.labels import symbol, with_unit
from rmpc_bench.figures.samples import Curve, Known, components, cut
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.figures.sweep_points import MOST_PANELS
from rmpc_bench.types import DesignError

TRUTH = ""
"""Stands for the method where all methods have the same true state."""
BLACK = "#000000"
STYLES: dict[str, dict[str, Any]] = {
    "runs": {"lw": 0.5, "ls": "-", "zorder": 2.0},
    "truth": {"lw": 1.0, "ls": (0, (1.2, 1.2)), "zorder": 2.3},
    "bound": {"lw": 1.0, "ls": (0, (4, 2)), "zorder": 2.4},
    "main": {"lw": 1.1, "ls": "-", "zorder": 2.5},
}
"""What a line may mean and how it is drawn, from below to above; those from runs are pale."""
ROUGH = 0.7
"""Width of a main line that is from runs."""
EDGE = 1.6
"""Width of the true state's line, times that of an estimate."""
SAME = 1e-9
"""Relative difference up to which the true states of two methods are the same but for rounding."""


class Stroke(NamedTuple):
    """A line of a panel."""

    method: str
    kind: str
    """One of `STYLES`."""
    curve: Curve
    n_runs: frozenset[int] = frozenset()
    """Where the line is from runs: how many."""


class Panel(NamedTuple):
    """What is shown of one state."""

    label: str
    strokes: tuple[Stroke, ...]


def variances(point: Trials, methods: Sequence[str], component: int | None) -> list[Panel]:
    """Find the variances of the estimation errors and what the methods believe of them.

    Parameters
    ----------
    point : the table that the moments belong to
    methods : methods to show
    component : index of the state; all if not given

    Raises
    ------
    DesignError
        when there is no such state, or more states than panels, or no method has a bound
    """
    cov, P = (components(point.series, name, methods) for name in ("cov(e)", "P"))
    if not P:
        raise DesignError(NO_P, "")
    n = _count(cov[name] for name in methods)
    unit = point.units.get("x", "")
    panels = []
    for i in _chosen(n, component):
        entry, strokes = f"{i},{i}", []
        for name in methods:
            if entry in P.get(name, {}):
                strokes.append(Stroke(name, "bound", P[name][entry].best))
            strokes += _strokes(name, cov[name][entry]) if entry in cov[name] else []
        own = point.units.get(f"x.{i}", unit)
        squared = f"{own}^2" if own.isalpha() else own and f"({own})^2"
        panels.append(Panel(with_unit(f"var {symbol('e', _index(i, n))}", squared), tuple(strokes)))
    return panels


def means(point: Trials, methods: Sequence[str], component: int | None) -> list[Panel]:
    """Find the means of the true state and of the estimates.

    Parameters
    ----------
    point : the table that the moments belong to
    methods : methods to show
    component : index of the state; all if not given

    Raises
    ------
    DesignError
        when there is no such state, or more states than panels
    """
    x, x_hat = (components(point.series, name, methods) for name in ("mean(x)", "mean(x_hat)"))
    n = _count([*x.values(), *x_hat.values()])
    unit = point.units.get("x", "")
    panels = []
    for i in _chosen(n, component):
        strokes = _truths({name: found[str(i)] for name, found in x.items() if str(i) in found})
        for name in methods:
            strokes += _strokes(name, x_hat[name][str(i)]) if str(i) in x_hat[name] else []
        own = point.units.get(f"x.{i}", unit)
        panels.append(Panel(with_unit(f"mean {symbol('x', _index(i, n))}", own), tuple(strokes)))
    return panels


def last_of(panels: Sequence[Panel]) -> int:
    """Find the last sample of all panels."""
    return int(max(stroke.curve.k[-1] for panel in panels for stroke in panel.strokes))


def draw(
    point: Trials,
    title: str,
    methods: Sequence[str],
    panels: Sequence[Panel],
    window: Window,
    size: tuple[float, float],
    *,
    words: tuple[str, str],
    log: bool,
) -> Figure:
    """Draw the panels; see `figures.means` and `figures.variance_with_bound`.

    Parameters
    ----------
    point : the table that the moments belong to
    title : the point of the sweep in words
    methods : methods from below to above
    panels : what to show, from top to bottom
    window : the samples to show
    size : width and height [in]
    words : what the legend calls the main lines that are exact, and those that are from runs
    log : logarithmic axes where all values are positive
    """
    looks = curves.looks(point.methods, methods)
    colours = {name: looks[name].color for name in methods} | {TRUTH: BLACK}
    places = {name: 0.01 * place for place, name in enumerate([TRUTH, *methods])}
    with style():
        figure = Figure(figsize=size, layout="constrained")
        rows = curves.panels(figure, len(panels))
        drawn: list[Stroke] = []
        for axes, panel in zip(rows, panels, strict=True):
            pieces = [(stroke, cut(stroke.curve, window)) for stroke in panel.strokes]
            shown = [stroke._replace(curve=piece) for stroke, piece in pieces if piece is not None]
            for stroke in shown:
                values = curves.drawable(stroke.curve.values)
                look = _look(stroke, colours[stroke.method], places[stroke.method])
                axes.plot(window.sample * stroke.curve.k, values, **look)
            remark = curves.make_logarithmic_if_positive(axes, [one.curve.values for one in shown]) if log else ""
            axes.set_ylabel(panel.label + remark)
            drawn += shown
        rows[-1].set_xlim(*window.limits)
        rows[-1].set_xlabel(window.label)
        handles = _of_colours(point, methods, drawn, colours)
        curves.finish(figure, handles, title, keys=_of_kinds(drawn, words))
    return figure


def _index(i: int, n: int) -> str:
    return str(i) if n > 1 else ""


def _count(found: Iterable[dict[str, Known]]) -> int:
    """Count the states from the names of the components."""
    return 1 + max(int(component.split(",")[0]) for entries in found for component in entries)


def _chosen(n: int, component: int | None) -> Sequence[int]:
    if component is None and n > MOST_PANELS:
        raise DesignError(f"there are {n} states, at most {MOST_PANELS} fit: choose one of 0 to {n - 1}", "component")
    if component is not None and not 0 <= component < n:
        raise DesignError(f"there is no state {component} (they count from 0 to {n - 1})", "component")
    return range(n) if component is None else [component]


def _strokes(name: str, values: Known) -> list[Stroke]:
    """The exact values with those from runs behind them; where there are only these, they are the main line."""
    if values.exact is None:
        return [Stroke(name, "main", values.best, values.n_runs)]
    behind = [Stroke(name, "runs", values.runs, values.n_runs)] if values.runs else []
    return [*behind, Stroke(name, "main", values.exact)]


def _truths(found: dict[str, Known]) -> list[Stroke]:
    """One line for the true state where all methods have the same, as without feedback; else one for each of them."""
    exact = [values for values in found.values() if values.exact is not None]
    compared = exact or list(found.values())
    if all(_same(compared[0].best, other.best) for other in compared[1:]):
        return _strokes(TRUTH, compared[0])
    return [Stroke(name, "truth", values.best) for name, values in found.items()]


def _same(one: Curve, other: Curve) -> bool:
    if not np.array_equal(one.k, other.k):
        return False
    finite = one.values[np.isfinite(one.values)]
    reach = np.abs(finite).max() if len(finite) else 0.0
    return bool(np.allclose(one.values, other.values, rtol=0.0, atol=SAME * reach, equal_nan=True))


def _look(stroke: Stroke, color: str, place: float) -> dict[str, Any]:
    look = {"color": color, **STYLES[stroke.kind]}
    if stroke.kind == "runs":
        look["color"] = curves.paler(color)
    elif stroke.kind == "main":
        # Black is seen on both sides of an estimate that is right, but not of one that is rough.
        look["lw"] *= ROUGH if stroke.n_runs else EDGE if stroke.method == TRUTH else 1.0
    return {**look, "zorder": look["zorder"] + place}


def _of_colours(
    point: Trials, methods: Sequence[str], drawn: Sequence[Stroke], colours: dict[str, str]
) -> list[tuple[str, Artist]]:
    """Say what the colours mean, and which main lines are from runs where others are exact."""
    mains = [stroke for stroke in drawn if stroke.kind == "main"]
    mixed = len({bool(stroke.n_runs) for stroke in mains}) > 1
    handles: list[tuple[str, Artist]] = []
    for name in [TRUTH, *methods] if any(stroke.method == TRUTH for stroke in mains) else methods:
        label = "true state" if name == TRUTH else point.labels.get(name, name)
        source = _from_runs(stroke for stroke in mains if stroke.method == name) if mixed else ""
        handles.append((f"{label} ({source})" if source else label, Line2D([], [], color=colours[name], lw=1.3)))
    return handles


def _of_kinds(drawn: Sequence[Stroke], words: tuple[str, str]) -> list[tuple[str, Artist]]:
    """Say what the kinds of lines mean, in grey."""
    kinds = {kind: [stroke for stroke in drawn if stroke.kind == kind] for kind in ("main", "truth", "bound", "runs")}
    all_from_runs = all(stroke.n_runs for stroke in kinds["main"])
    texts = {
        "main": f"{words[1]} {_from_runs(kinds['main'])}" if all_from_runs else words[0],
        "truth": "true state",
        "bound": "own P",
        "runs": _from_runs(kinds["runs"]),
    }
    looks = {kind: {**STYLES[kind], "color": REFERENCE} for kind in kinds}
    looks["runs"] |= {"color": curves.paler(REFERENCE, 0.4), "lw": 0.8}  # else hardly seen on its own
    return [(texts[kind], Line2D([], [], **looks[kind])) for kind, strokes in kinds.items() if strokes]


def _from_runs(strokes: Iterable[Stroke]) -> str:
    numbers = sorted(frozenset().union(*(stroke.n_runs for stroke in strokes)))
    if not numbers:
        return ""
    few, many = numbers[0], numbers[-1]
    return f"from {few} runs" if few == many else f"from {few} to {many} runs"
