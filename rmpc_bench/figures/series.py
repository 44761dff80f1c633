"""A quantity of the designs, such as a gain, over time: one line per method, one panel per component."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures import curves
from rmpc_bench.figures.curves import Window
from rmpc_bench.figures.labels import symbol
from rmpc_bench.figures.samples import Curve, cut, known
from rmpc_bench.figures.style import style
from rmpc_bench.figures.sweep_points import MOST_PANELS
from rmpc_bench.types import DesignError


def draw(
    point: Trials,
    title: str,
    quantity: str,
    lines: Mapping[str, Mapping[str, Curve]],
    window: Window,
    size: tuple[float, float],
    *,
    log: bool,
) -> Figure:
    """Draw a series; see `figures.series`.

    Parameters
    ----------
    point : the table that the series belong to
    title : the point of the sweep in words
    quantity : name of the series
    lines : component -> method -> curve
    window : the samples to show
    size : width and height [in]
    log : logarithmic axis where all values are positive
    """
    methods = [name for name in point.methods if any(name in drawn for drawn in lines.values())]
    looks = curves.looks(point.methods, methods)
    with style():
        figure = Figure(figsize=size, layout="constrained")
        panels = curves.panels(figure, len(lines))
        for axes, (component, drawn) in zip(panels, lines.items(), strict=True):
            for name, curve in drawn.items():
                axes.plot(window.sample * curve.k, curves.drawable(curve.values), **looks[name].line())
            values = [curve.values for curve in drawn.values()]
            remark = curves.make_logarithmic_if_positive(axes, values) if log else ""
            axes.set_ylabel(symbol(quantity, component) + remark)
        ends = [end for drawn in lines.values() for curve in drawn.values() for end in (curve.k[0], curve.k[-1])]
        if min(ends) < max(ends):
            panels[-1].set_xlim(window.sample * min(ends), window.sample * max(ends))
        panels[-1].set_xlabel(window.label)
        handles = [(point.labels.get(name, name), curves.sample(looks[name])) for name in methods]
        curves.finish(figure, handles, title)
    return figure


def lines_of(
    point: Trials, methods: Sequence[str] | None, quantity: str, component: str | None
) -> dict[str, dict[str, Curve]]:
    """Find the curves to draw.

    Parameters
    ----------
    point : the table that the series belong to
    methods : methods to show; those that have the quantity if not given
    quantity : name of the series
    component : such as ``"2,0"``; all if not given

    Returns
    -------
    component -> method -> curve

    Raises
    ------
    DesignError
        when there is no such quantity, method or component, or more components than panels
    """
    table = point.series[point.series["quantity"] == quantity]
    having = [name for name in point.methods if (table["method"] == name).any()]
    if not having:
        there = ", ".join(dict.fromkeys(point.series["quantity"])) or "none"
        raise DesignError(f"'{quantity}' is not a series of these methods (known: {there})", "quantity")
    for name in methods or ():
        if name not in having:
            raise DesignError(f"'{name}' has no series {quantity} (those that have: {', '.join(having)})", "order")
    shown = methods or having
    table = table[table["method"].isin(shown)]
    components = [str(name) for name in dict.fromkeys(table["component"])]
    if component is not None and component not in components:
        raise DesignError(f"{quantity} has no component '{component}' (known: {'; '.join(components)})", "component")
    wanted = components if component is None else [component]
    if len(wanted) > MOST_PANELS:
        message = (
            f"{quantity} has {len(wanted)} components, at most {MOST_PANELS} fit: choose one of {'; '.join(wanted)}"
        )
        raise DesignError(message, "component")
    found: dict[str, dict[str, Curve]] = {}
    for one in wanted:
        rows = table[table["component"] == one]
        found[one] = {name: known(rows[rows["method"] == name]).best for name in shown if name in {*rows["method"]}}
    return found


def last_of(lines: Mapping[str, Mapping[str, Curve]]) -> int:
    """Find the last sample of all curves."""
    return int(max(curve.k[-1] for drawn in lines.values() for curve in drawn.values()))


def within(lines: Mapping[str, Mapping[str, Curve]], window: Window) -> dict[str, dict[str, Curve]]:
    """Cut curves to a window; a constant goes through, what ends before is left out.

    Parameters
    ----------
    lines : component -> method -> curve
    window : the samples to show
    """
    pieces = {
        component: {name: cut(curve, window) for name, curve in drawn.items()} for component, drawn in lines.items()
    }
    return {
        component: {name: piece for name, piece in drawn.items() if piece is not None}
        for component, drawn in pieces.items()
    }
