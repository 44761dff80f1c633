"""Series of a design or of the ensemble over time, such as a gain: one line per method, one panel per component."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import drawable, make_logarithmic_if_positive, stacked_panels
from rmpc_bench.figures.captions import MOST_NUMBERS, joined, label_of, place, sentences, span_of
from rmpc_bench.figures.labels import symbol
from rmpc_bench.figures.legend import finish
from rmpc_bench.figures.line_styles import legend_sample, line_styles
from rmpc_bench.figures.samples import Curve, component_of, cut
from rmpc_bench.figures.style import style
from rmpc_bench.figures.sweep_points import MOST_PANELS, point_at
from rmpc_bench.figures.window import TimeWindow, window_of
from rmpc_bench.types import NonNegative
from rmpc_bench.types.figure import OnePointFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout, Shape

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials


@dataclass(frozen=True, kw_only=True)
class Series(OnePointFigure):
    """A series of the designs over time, such as the gain L of an estimator; the components are panels.

    Parameters
    ----------
    quantity : name in series.csv, such as L or theta
    component : its component as in series.csv, such as 2,0 (counted from 0); all (6 at most) if not given
    from_ : first time to show [s]
    to : last time to show [s]
    log : logarithmic axis; linear, with a remark, if a value is not positive
    height : height of the whole picture [in]; if not given 0.8 and 1.2 for every panel; legend and title add to it if
        they need more than a line
    order : methods to show, later ones above earlier ones; all that have the quantity if not given
    """

    quantity: str
    component: str | int | None = None
    from_: NonNegative | None = None
    to: NonNegative | None = None
    log: bool = False

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: a series that some method has, with this component, in panels that fit."""
        yield from super().check(layout)
        if self.quantity not in layout.series:
            known = ", ".join(layout.series) or "none"
            yield Issue("quantity", f"{self.quantity!r} is not a series of these methods (available: {known})")
            return
        shape = layout.series[self.quantity]
        if self.component is None:
            advice = "choose one with `component`"
            yield from layout.require_at_most(MOST_PANELS, math.prod(shape), "components", "quantity", advice)
        elif not _is_component(str(self.component), shape):
            yield Issue("component", _no_component(self.quantity, self.component, shape))
        yield from layout.require_series_of(self.order, self.quantity)
        yield from layout.require_window(self.from_, self.to)

    def caption(self, results: Trials) -> str:
        """Name the series and state its last values; see `Figure.caption`."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        methods = self.order or layout.methods_having(self.quantity)
        lines = lines_of(point, methods, self.quantity, None if self.component is None else str(self.component))
        last = int(max(curve.k[-1] for drawn in lines.values() for curve in drawn.values()))
        window = window_of(point, last, self.from_, self.to)
        texts = []
        for component, drawn in within(lines, window).items():
            values = (f"{label_of(point, name)} {curve.values[-1]:.4g}" for name, curve in drawn.items())
            texts.append(f"{symbol(self.quantity, component)}: {', '.join(values)}")
        return sentences(
            f"Series {symbol(self.quantity)} of {joined(label_of(point, name) for name in methods)} over time, "
            f"{span_of(window)}; indices count from 0",
            place(point, title),
            f"Last values shown: {'; '.join(texts)}" if len(texts) * len(methods) <= MOST_NUMBERS else "",
            "The axis is logarithmic if all values are positive" if self.log else "",
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw the series of one point; see `Figure.draw`."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods = self.order or layout.methods_having(self.quantity)
        lines = lines_of(point, methods, self.quantity, None if self.component is None else str(self.component))
        last = int(max(curve.k[-1] for drawn in lines.values() for curve in drawn.values()))
        window = window_of(point, last, self.from_, self.to)
        lines = within(lines, window)
        return _draw(point, title, self.quantity, lines, window, self.size(0.8 + 1.2 * len(lines)), log=self.log)


def lines_of(
    point: Trials, methods: Sequence[str], quantity: str, component: str | None
) -> dict[str, dict[str, Curve]]:
    """Read the curves to draw by component, such as ``"2,0"``, and method; all components if none is given."""
    table = point.series[(point.series["quantity"] == quantity) & point.series["method"].isin(methods)]
    found: dict[str, dict[str, Curve]] = {}
    for name in map(str, dict.fromkeys(table["component"])):
        if component in (None, name):
            rows = table[table["component"] == name]
            having = {*rows["method"]}
            found[name] = {each: component_of(rows[rows["method"] == each]).best for each in methods if each in having}
    return found


def within(lines: Mapping[str, Mapping[str, Curve]], window: TimeWindow) -> dict[str, dict[str, Curve]]:
    """Cut curves by component and method to a window.

    A constant covers it, and a curve that ends before it is left out.
    """
    pieces = {
        component: {name: cut(curve, window) for name, curve in drawn.items()} for component, drawn in lines.items()
    }
    return {
        component: {name: piece for name, piece in drawn.items() if piece is not None}
        for component, drawn in pieces.items()
    }


def _is_component(text: str, shape: Shape) -> bool:
    parts = text.split(",")
    index = tuple(int(part) if part.strip().isdecimal() else -1 for part in parts)
    return len(index) == len(shape) and all(0 <= i < length for i, length in zip(index, shape, strict=True))


def _no_component(quantity: str, component: str | int, shape: Shape) -> str:
    last = ",".join(str(length - 1) for length in shape)
    way_out = f"the components are {','.join('0' for _ in shape)} to {last}" if shape else "it is a number and has none"
    return f"{component!r} is not a component of {quantity}: {way_out}"


def _draw(
    point: Trials,
    title: str,
    quantity: str,
    lines: Mapping[str, Mapping[str, Curve]],
    window: TimeWindow,
    size: tuple[float, float],
    *,
    log: bool,
) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure

    methods = [name for name in point.methods if any(name in drawn for drawn in lines.values())]
    styles = line_styles(point.all_methods, methods)
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels = stacked_panels(figure, len(lines))
        for axes, (component, drawn) in zip(panels, lines.items(), strict=True):
            for name, curve in drawn.items():
                axes.plot(window.sample * curve.k, drawable(curve.values), **styles[name].line())
            values = [curve.values for curve in drawn.values()]
            remark = make_logarithmic_if_positive(axes, values) if log else ""
            axes.set_ylabel(symbol(quantity, component) + remark)
        ends = [end for drawn in lines.values() for curve in drawn.values() for end in (curve.k[0], curve.k[-1])]
        if min(ends) < max(ends):
            panels[-1].set_xlim(window.sample * min(ends), window.sample * max(ends))
        panels[-1].set_xlabel(window.label)
        handles = [(point.labels.get(name, name), legend_sample(styles[name])) for name in methods]
        finish(figure, handles, title)
    return figure
