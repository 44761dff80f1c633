"""One run among the sets that the methods believed it to be in, in a plane of two states or over time.

Figs. 1 to 3 of ma2025: a trajectory with its ellipses, one panel per method.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.matrices import distance
from rmpc_bench.claims.values import EvaluationError, Value
from rmpc_bench.figures import curves
from rmpc_bench.figures.curves import Window
from rmpc_bench.figures.ellipses import Ellipse, outline
from rmpc_bench.figures.keys import NO_BELIEF, NO_STATES, other_states
from rmpc_bench.figures.labels import symbol, typeset, with_unit, wrapped
from rmpc_bench.figures.requirements import LACKING, believed
from rmpc_bench.figures.style import FONT_SIZE, REFERENCE, style
from rmpc_bench.types import Array, DesignError, Status

BLACK, WHITE = "#000000", "#ffffff"
MOST_ELLIPSES = 12
"""In a panel, unless told how far they are apart."""
EDGES: dict[bool, dict[str, Any]] = {False: {"ls": "-", "lw": 0.8}, True: {"ls": (0, (3, 1.5)), "lw": 0.8}}
"""Lines around a set, and around the ellipsoid of a covariance."""
FILL = 0.75
"""Share of white in the inside of a set."""
TRUTH: dict[str, Any] = {"color": BLACK, "lw": 0.7, "zorder": 2.6}
INSIDE: dict[str, Any] = {"ls": "", "marker": "o", "ms": 2.6, "mew": 0.6, "mfc": BLACK, "mec": BLACK, "zorder": 2.8}
OUTSIDE: dict[str, Any] = {**INSIDE, "ms": 3.2, "mfc": WHITE}
EDGE = 1e-9
"""How far beyond the edge a state is still inside: rounding."""


class Tube(NamedTuple):
    """What a method believed of a run, at the samples that are shown."""

    x: Array
    """(samples, components) the truth."""
    x_hat: Array
    """(samples, components)."""
    S: Array
    """(samples, components, components): x is believed to lie in E(x_hat, S)."""
    gaussian: bool
    """Whether S is that of a confidence ellipsoid."""
    status: str

    def outside(self) -> Array:
        """Whether x lies outside, sample by sample; DesignError where S is no shape of an ellipsoid."""
        try:
            gap = distance(Value(self.x, "k"), Value(self.x_hat, "k"), Value(self.S, "k")).array
        except EvaluationError as error:
            raise DesignError(f"what a method believes is no ellipsoid: {error}", "") from None
        return np.asarray(gap > 1.0 + EDGE)


def methods_of(point: Trials, order: Sequence[str] | None) -> Sequence[str]:
    """Methods to show, all of which are recorded and believe something.

    Parameters
    ----------
    point : the table that is shown
    order : methods asked for; all that can be shown if not given

    Raises
    ------
    DesignError
        when none can be shown, or one that is asked for cannot
    """
    kept = [name for name, traces in point.traces.items() if {"x", "x_hat"} <= set(traces.signals)]
    if not kept:
        raise DesignError(NO_STATES, "")
    known = set(point.series.loc[point.series["quantity"].isin(["M", "P"]), "method"])
    for name in order or ():
        if name not in known:
            raise DesignError(f"'{name}' {LACKING}", "order")
    shown = [name for name in (order or point.methods) if name in known and name in kept]
    if not shown:
        raise DesignError(NO_BELIEF, "")
    return shown


def tube_of(point: Trials, name: str, run: int, components: Sequence[int], window: Window, level: float) -> Tube:
    """Find what a method believed of a run.

    Parameters
    ----------
    point : the table that is shown
    name : the method
    run : index of the run
    components : the states
    window : the samples
    level : of the ellipsoid of P, for a method without M

    Raises
    ------
    DesignError
        when the run is not recorded, there is no such state, or the states are not those of the plant
    """
    traces = point.traces[name]
    (rows,) = np.nonzero(traces.runs == run)
    if not len(rows):
        raise DesignError(f"run {run} is not recorded (recorded: {', '.join(map(str, traces.runs))})", "run")
    x, x_hat = (traces.signals[signal][rows[0]] for signal in ("x", "x_hat"))
    if x.shape != x_hat.shape:
        raise DesignError(other_states(name, x_hat.shape[1], x.shape[1]), "order")
    n = x.shape[1]
    if max(components) >= n:
        raise DesignError(f"there is no state {max(components)} (they count from 0 to {n - 1})", "components")
    S, gaussian = _shape(point, name, level)
    shown = slice(window.first, window.last + 1)
    S = S[shown] if len(S) > 1 else np.repeat(S, window.last + 1 - window.first, axis=0)
    table = point.frame[(point.frame["method"] == name) & (point.frame["run"] == run)]
    chosen = list(components)
    pair = S[:, chosen][:, :, chosen]  # the shadow of an ellipsoid has this part of its shape
    return Tube(x[shown][:, chosen], x_hat[shown][:, chosen], pair, gaussian, str(table["status"].iloc[0]))


def distance_of(window: Window) -> int:
    """Choose how many samples lie between two ellipses, so that at most `MOST_ELLIPSES` are drawn."""
    return -(-(window.last + 1 - window.first) // MOST_ELLIPSES)


def draw(
    point: Trials,
    title: str,
    tubes: dict[str, Tube],
    components: Sequence[int],
    window: Window,
    size: tuple[float, float],
    *,
    run: int,
    level: float,
    every: int,
    plane: bool,
) -> Figure:
    """Draw the panels; see `tube_figure.tubes`.

    Parameters
    ----------
    point : the table that is shown
    title : the point of the sweep in words
    tubes : method -> what it believed, from top to bottom
    components : the states, the horizontal one of a plane first
    window : the samples that are shown
    size : width and height [in]
    run : index of the run
    level : of the ellipsoids of P
    every : samples from one ellipse of a plane to the next
    plane : whether the panels are planes; else the time is their horizontal axis, and every state has its own
    """
    looks = curves.looks(point.methods, list(tubes))
    labels = [_label(point, i, point.traces[next(iter(tubes))].signals["x"].shape[2]) for i in components]
    rows = [(name, None if plane else place) for place in range(1 if plane else len(components)) for name in tubes]
    with style():
        figure = Figure(figsize=size, layout="constrained")
        panels, seen_outside = curves.panels(figure, len(rows)), False
        for axes, (name, place) in zip(panels, rows, strict=True):
            axes.yaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10]))
            if place is None:
                outside = _draw_plane(axes, tubes[name], every, looks[name].color)
            else:
                outside = _draw_band(axes, tubes[name], place, window, looks[name].color)
            seen_outside |= bool(outside.any())
            axes.set_ylabel(labels[-1 if place is None else place])
            _write_beside(axes, point.labels.get(name, name), looks[name].color, size[1] / len(rows))
        _align(panels, [row[1] for row in rows], [tubes[name].status == Status.OK.word for name, _ in rows])
        panels[-1].set_xlabel(labels[0] if plane else window.label)
        if not plane:
            panels[-1].set_xlim(*window.limits)
        note = _note(tubes, run, window if plane else None, every)
        keys = _keys(list(tubes.values()), level, plane, outside=seen_outside)
        curves.finish(figure, keys, "\n".join(filter(None, [title, note])))
    return figure


def _shape(point: Trials, name: str, level: float) -> tuple[Array, bool]:
    """Return the shape matrices of what a method believes, axis 0 = k, and whether they are made of P."""
    known = point.series.loc[point.series["method"] == name, "quantity"].unique()
    quantity = believed({quantity: quantity for quantity in known})
    assert quantity is not None  # `methods_of` has looked
    values = point.matrix_series(quantity, name)
    return (_quantile(level, values.shape[-1]) * values, True) if quantity == "P" else (values, False)


def _quantile(level: float, n: int) -> float:
    """Quantile of chi-square with n degrees of freedom."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(n / 2.0, level))


def _label(point: Trials, i: int, n: int) -> str:
    unit = point.units.get(f"x.{i}", point.units.get("x", ""))
    return with_unit(symbol("x", str(i) if n > 1 else ""), unit)


def _write_beside(axes: Axes, label: str, color: str, height: float) -> None:
    """Name a panel on its right, in the colour of its method, and no longer than it is high."""
    lines = wrapped(typeset(label), 0.7 * height * 72)
    place: dict[str, Any] = {"xy": (1.0, 0.5), "xycoords": "axes fraction", "xytext": (3.0, 0.0)}
    where: dict[str, Any] = {"textcoords": "offset points", "ha": "left", "va": "center", "rotation": 270}
    axes.annotate("\n".join(lines), **place, **where, color=color, fontsize=FONT_SIZE)


def _draw_plane(axes: Axes, tube: Tube, every: int, color: str) -> Array:
    """Draw both trajectories, and the ellipses of some samples with their true states; return which lie outside."""
    axes.plot(*curves.drawable(tube.x).T, **TRUTH)
    axes.plot(*curves.drawable(tube.x_hat).T, color=color, lw=0.9, zorder=2.7)
    some = tube._replace(x=tube.x[::every], x_hat=tube.x_hat[::every], S=tube.S[::every])
    for centre, S in zip(some.x_hat, some.S, strict=True):
        points = outline(Ellipse(centre, S), 1.0)
        if points is not None:
            x, y = curves.drawable(points).T
            axes.fill(x, y, facecolor=curves.paler(color, FILL), alpha=0.5, zorder=2.1, lw=0)
            axes.plot(x, y, color=color, zorder=2.2, **EDGES[tube.gaussian])
    for x, x_hat in zip(curves.drawable(some.x), curves.drawable(some.x_hat), strict=True):
        axes.plot(*np.stack([x, x_hat]).T, color=REFERENCE, lw=0.5, zorder=2.5)
    outside = some.outside()
    _draw_states(axes, some.x[:, 0], some.x[:, 1], outside)
    axes.plot(*curves.drawable(some.x_hat).T, ls="", marker="+", ms=4, mew=0.9, color=color, zorder=2.75)
    return outside


def _draw_band(axes: Axes, tube: Tube, place: int, window: Window, color: str) -> Array:
    """Draw one state and its estimate over time, and how far the sets reach; return where it lies beyond them."""
    t = window.sample * np.arange(window.first, window.last + 1)
    x, x_hat = tube.x[:, place], tube.x_hat[:, place]
    half = np.sqrt(np.maximum(tube.S[:, place, place], 0.0))
    low, high = curves.drawable(x_hat - half), curves.drawable(x_hat + half)
    axes.fill_between(t, low, high, color=curves.paler(color, FILL), linewidth=0, zorder=2.1)
    for edge in (low, high):
        axes.plot(t, edge, color=color, zorder=2.2, **{**EDGES[tube.gaussian], "lw": 0.5})
    axes.plot(t, curves.drawable(x_hat), color=color, lw=0.9, zorder=2.7)
    axes.plot(t, curves.drawable(x), **TRUTH)
    beyond = np.abs(x - x_hat) > half * (1.0 + EDGE)
    _draw_states(axes, t[beyond], x[beyond], beyond[beyond])
    return np.asarray(beyond)


def _draw_states(axes: Axes, x: Array, y: Array, outside: Array) -> None:
    for which, look in ((~outside, INSIDE), (outside, OUTSIDE)):
        axes.plot(curves.drawable(x[which]), curves.drawable(y[which]), **look)


def _align(panels: Sequence[Axes], places: Sequence[int | None], ok: Sequence[bool]) -> None:
    """Give panels of the same states the same limits; what fails may go far away and must not shrink the others."""
    for place in set(places):
        group = [number for number, each in enumerate(places) if each == place]
        good = [panels[number].dataLim for number in group if ok[number]] or [panels[group[0]].dataLim]
        limits = _padded([box.intervaly for box in good])
        for number in group:
            panels[number].set_ylim(*limits)
        if place is None:
            panels[0].set_xlim(*_padded([box.intervalx for box in good]))


def _padded(intervals: Sequence[Array]) -> tuple[float, float]:
    """Limits that hold all intervals, with some room."""
    low, high = float(np.min(intervals)), float(np.max(intervals))
    room = 0.05 * (high - low) or 1.0
    return low - room, high + room


def _keys(tubes: Sequence[Tube], level: float, plane: bool, *, outside: bool) -> list[tuple[str, Artist]]:
    """Say what lines, areas and dots mean; what has the colour of the method is grey."""
    dot: dict[str, Any] = {"marker": "o", "ms": 2.6} if plane else {}
    cross: dict[str, Any] = {"marker": "+", "ms": 4.0} if plane else {}
    found: list[tuple[str, Artist]] = [
        ("true state", Line2D([], [], **TRUTH, **dot)),
        ("estimate", Line2D([], [], color=REFERENCE, lw=0.9, **cross)),
    ]
    for gaussian, text in ((False, "set $M$"), (True, rf"{100 * level:g} % of $P$")):
        if any(tube.gaussian == gaussian for tube in tubes):
            fill = curves.paler(REFERENCE, FILL)
            found.append((text, Patch(facecolor=fill, edgecolor=REFERENCE, **EDGES[gaussian])))
    return [*found, ("outside", Line2D([], [], **OUTSIDE))] if outside else found


def _note(tubes: dict[str, Tube], run: int, window: Window | None, every: int) -> str:
    """Say which run is shown, of what is in a plane the samples, and which methods failed."""
    parts = [f"run {run}"]
    if window is not None:
        seconds = window.label != "$k$"
        first, last = (f"{end:g}" for end in window.limits)
        parts.append(f"t = {first} to {last} s" if seconds else f"k = {first} to {last}")
        parts.append("every sample" if every == 1 else f"ellipses every {every} samples")
    parts += [f"{name} {tube.status}" for name, tube in tubes.items() if tube.status != Status.OK.word]
    return ", ".join(parts)
