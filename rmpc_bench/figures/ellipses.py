"""Covariance ellipses of the methods among the runs, as in Fig. 3 of souto2011."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures import curves
from rmpc_bench.figures.labels import literal, with_unit
from rmpc_bench.figures.samples import Curve, components
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.types import Array, DesignError, MetricInfo

SMOOTH = 181
"""Points of an ellipse."""
FLAT = 1e-12
"""How close to 1 the correlation of a segment is; the rounding of a singular P."""
RINGS: tuple[dict[str, Any], ...] = (
    {"ls": "-", "lw": 1.2},
    {"ls": (0, (4, 2)), "lw": 0.9},
    {"ls": (0, (1.2, 1.2)), "lw": 0.9},
    {"ls": (0, (7, 1.5, 1.2, 1.5)), "lw": 0.7},
)
"""Lines of the radii, the first one first."""
DOTS: dict[str, Any] = {"ls": "", "marker": "o", "ms": 1.7, "mew": 0.0}


class Ellipse(NamedTuple):
    """Where a method believes the state to be."""

    centre: Array
    """(2,) estimate."""
    P: Array
    """(2, 2) covariance."""


class Dots(NamedTuple):
    """The runs, all those that ended well and have finite values."""

    x: Array
    y: Array
    n_failed: int
    n_never: int


def ellipses_of(
    point: Trials, methods: Sequence[str], pair: tuple[int, int], k: int | None
) -> tuple[int, dict[str, Ellipse]]:
    """Find the ellipses of the methods.

    Parameters
    ----------
    point : the table that the series belong to
    methods : methods to show, all of which have P and mean(x_hat)
    pair : the two states
    k : the sample; the last one that all methods have if not given

    Returns
    -------
    the sample, and the ellipse of every method

    Raises
    ------
    DesignError
        when there is no such state or sample
    """
    P, x_hat = (components(point.series, name, methods) for name in ("P", "mean(x_hat)"))
    if len(set(pair)) < 2:
        raise DesignError("must be two different states", "components")
    found: dict[str, dict[str, Curve]] = {}
    for name in methods:
        parts = {component: values.best for component, values in (P[name] | x_hat[name]).items()}
        wanted = [*map(str, pair), *(f"{i},{j}" for i in pair for j in pair)]
        if not set(wanted) <= set(parts):
            raise DesignError(f"'{name}' has {len(x_hat[name])} states (they count from 0)", "components")
        found[name] = {component: parts[component] for component in wanted}
    last = min(_last(list(parts.values())) for parts in found.values())
    if k is not None and not 0 <= k <= last:
        raise DesignError(f"there is no sample {k} (they go from 0 to {last})", "k")
    k = last if k is None else k
    values = {name: {entry: curve.at(k) for entry, curve in parts.items()} for name, parts in found.items()}
    i, j = pair
    return k, {
        name: Ellipse(
            np.array([at[str(i)], at[str(j)]]),
            np.array([[at[f"{i},{i}"], at[f"{i},{j}"]], [at[f"{j},{i}"], at[f"{j},{j}"]]]),
        )
        for name, at in values.items()
    }


def outline(ellipse: Ellipse, radius: float) -> Array | None:
    """Find the points z with (z - centre)' P^-1 (z - centre) = radius^2; the segment where P is singular.

    Parameters
    ----------
    ellipse : centre and covariance
    radius : in standard deviations

    Returns
    -------
    (points, 2) coordinates, two of them for a segment; None where P is no covariance or not finite
    """
    if not (np.isfinite(ellipse.P).all() and np.isfinite(ellipse.centre).all()):
        return None
    covariance = (ellipse.P[0, 1] + ellipse.P[1, 0]) / 2
    if min(ellipse.P[0, 0], ellipse.P[1, 1]) < 0:
        return None
    # Each coordinate in its own unit: states of very different sizes make no ellipse degenerate.
    deviations = np.sqrt(np.diag(ellipse.P))
    product = float(deviations.prod())
    if abs(covariance) > (1 + math.sqrt(FLAT)) * product:
        return None
    correlation = min(1.0, max(-1.0, covariance / product)) if product else 1.0
    t = np.array([0.0, math.pi]) if abs(correlation) > 1 - FLAT else np.linspace(0.0, 2 * math.pi, SMOOTH)
    across = math.sqrt(1 - correlation**2)
    unit = np.stack([np.cos(t), correlation * np.cos(t) + across * np.sin(t)], axis=1)
    return np.asarray(ellipse.centre + radius * deviations * unit)


def dots_of(point: Trials, methods: Sequence[str], x: str, y: str) -> dict[str, Dots]:
    """Find the dots of every method, or of the first one for all where the values do not depend on the method.

    Parameters
    ----------
    point : the table that the metrics belong to
    methods : methods to show
    x, y : names of the metrics
    """
    found = {name: (point.column(x, name), point.column(y, name)) for name in methods}
    first = found[methods[0]]
    common = all(_same(a, b) for columns in found.values() for a, b in zip(first, columns, strict=True))
    return {name: _dots(*found[name], point.n_failed(name)) for name in (methods[:1] if common else methods)}


def draw(
    point: Trials,
    title: str,
    ellipses: dict[str, Ellipse],
    axes_of: tuple[MetricInfo, MetricInfo],
    k: int,
    radii: Sequence[float],
    size: tuple[float, float],
) -> Figure:
    """Draw ellipses and runs; see `figures.ellipses`.

    Parameters
    ----------
    point : the table whose runs are shown
    title : the point of the sweep in words
    ellipses : method -> ellipse, from below to above
    axes_of : the metrics of the horizontal and of the vertical axis
    k : the sample of the ellipses
    radii : of the ellipses, in standard deviations
    size : width and height [in]
    """
    methods = list(ellipses)
    looks = curves.looks(point.methods, methods)
    dots = dots_of(point, methods, *(info.name for info in axes_of))
    with style():
        figure = Figure(figsize=size, layout="constrained")
        (axes,) = curves.panels(figure, 1)
        axes.yaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10]))
        handles: list[tuple[str, Artist]] = []
        for name, ellipse in ellipses.items():
            seen = _draw_ellipse(axes, ellipse, radii, looks[name].color, looks[name].zorder)
            label = point.labels.get(name, name) + ("" if seen else " (no ellipse)")
            handles.append((label, Line2D([], [], color=looks[name].color, lw=1.3)))
        keys: list[tuple[str, Artist]] = [
            (rf"${radius:g}\sigma$", Line2D([], [], color=REFERENCE, **ring))
            for radius, ring in zip(radii, RINGS, strict=False)
        ]
        keys += _draw_dots(axes, dots, {name: looks[name].color for name in methods})
        axes.set_xlabel(with_unit(literal(axes_of[0].name), axes_of[0].unit))
        axes.set_ylabel(with_unit(literal(axes_of[1].name), axes_of[1].unit))
        curves.finish(figure, handles, "\n".join(filter(None, [title, _note(k, dots)])), keys=keys)
    return figure


def _last(parts: Sequence[Curve]) -> int:
    """Find the last sample of curves, some of which may be constant."""
    return int(min([curve.k[-1] for curve in parts if len(curve.k) > 1], default=0))


def _same(a: Array, b: Array) -> bool:
    """Whether two columns are equal in the runs that both methods finished."""
    both = ~(np.isnan(a) | np.isnan(b))
    return bool(np.array_equal(a[both], b[both]))


def _dots(x: Array, y: Array, n_failed: int) -> Dots:
    finite = np.isfinite(x) & np.isfinite(y)
    n_never = int((np.isinf(x) | np.isinf(y)).sum())
    return Dots(curves.drawable(x[finite]), curves.drawable(y[finite]), n_failed, n_never)


def _draw_ellipse(axes: Axes, ellipse: Ellipse, radii: Sequence[float], color: str, zorder: float) -> bool:
    """Draw one ellipse per radius and its centre; return whether there is one."""
    outlines = [outline(ellipse, radius) for radius in radii]
    for points, ring in zip(outlines, RINGS, strict=False):
        if points is not None:
            x, y = curves.drawable(points).T
            axes.plot(x, y, color=color, zorder=zorder, solid_capstyle="round", **ring)
    if outlines[0] is None:
        return False
    axes.plot(*curves.drawable(ellipse.centre), color=color, zorder=zorder, marker="+", ms=4, mew=0.9)
    return True


def _draw_dots(axes: Axes, dots: dict[str, Dots], colours: dict[str, str]) -> list[tuple[str, Artist]]:
    """Draw the runs below the ellipses; return what the legend says of them."""
    for name, (x, y, *_) in dots.items():
        color = REFERENCE if len(dots) == 1 else curves.paler(colours[name], 0.35)
        axes.plot(x, y, color=color, zorder=2.0, **DOTS)
    numbers = sorted({len(each.x) for each in dots.values()})
    text = f"{numbers[0]} runs" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]} runs"
    return [(text, Line2D([], [], color=REFERENCE, **{**DOTS, "ms": 3.0}))]


def _note(k: int, dots: dict[str, Dots]) -> str:
    """Say which sample the ellipses belong to, and which runs are missing."""
    n_failed, n_never = (sum(each[place] for each in dots.values()) for place in (2, 3))
    parts = [f"at k = {k}", f"{n_failed} failed" if n_failed else "", f"{n_never} never" if n_never else ""]
    return ", ".join(filter(None, parts))
