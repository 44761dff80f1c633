"""Trajectories: recorded signals over time, one panel each, as a single run or as median and band of several."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.labels import component_label, symbol, unit_of, with_unit
from rmpc_bench.figures.recorded_runs import (
    ERROR,
    OUTPUT,
    PanelSignal,
    differences,
    last_sample,
    select_runs,
)
from rmpc_bench.figures.run_curves import CurveOptions
from rmpc_bench.figures.sweep_points import point_at
from rmpc_bench.figures.trajectory_panels import Content, caption_of, draw_panels
from rmpc_bench.figures.window import window_of
from rmpc_bench.figures.zoom import Zoom, automatic_zoom
from rmpc_bench.types import DesignError, NonNegative
from rmpc_bench.types.figure import OnePointFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout, Shape

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

SingleRuns = Annotated[int, Ge(0), Le(10)]
USUAL = ("y", "u")
"""Signals that are shown by default."""
MOST_PANELS_WITH_ZOOM = 3
"""Panels up to which an enlarged one is added automatically."""
MOST_SIGNALS = 8
"""Panels, which may be low: four inputs and three errors are usual."""


@dataclass(frozen=True, kw_only=True)
class Trajectories(OnePointFigure):
    """Recorded signals over time, one panel each; the methods share a panel, and the reference is dashed.

    A single recorded run is drawn as it is.  For several runs it shows the median (thick), the band from 5 to 95 %
    and single runs (thin), without the runs that failed.  The first band is filled, the others are hatched.  Bursts of
    the noise are shaded if they are the same in all runs that are shown.  A method without a signal is left out of its
    panels.

    Parameters
    ----------
    signals : signals to show, from top to bottom, such as y, u, a signal that a method reports, the control error
        e = r - y or, a single component counted from 0, x_hat.2; the components of a matrix count row by row; y and u
        if not given
    from_ : first time to show [s]
    to : last time to show [s]
    runs : number of single runs to show beside median and band, from the first one on
    edges : lines around the bands, which distinguish overlapping bands of several methods
    width_of_band : show the distance between the 5 and the 95 % quantile of every method in place of median and band,
        so that the widths can be compared
    difference : show the difference from the baseline in paired runs, in place of the signals
    zoom : a window of a signal that is enlarged in a panel below the others, such as {signal: u, from: 8, to: 10};
        `auto` adds one where a figure of at most three panels has several methods whose curves reach over at most 5 %
        of the panel's range in a seventh of the time but differ by a quarter of this reach; `none` adds none
    height : height of the whole picture [in]; if not given 0.8 and 1.2 for every panel; legend and title add to it if
        they need more than a line
    order : methods to show, later ones above earlier ones; all that have recorded runs if not given
    """

    needs_runs: ClassVar[bool] = True

    signals: list[str] | None = None
    from_: NonNegative | None = None
    to: NonNegative | None = None
    runs: SingleRuns = 1
    edges: bool = False
    width_of_band: bool = False
    difference: bool = False
    zoom: Literal["auto", "none"] | Zoom = "auto"

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: recorded signals, as many as panels fit, in a window that holds samples."""
        yield from super().check(layout)
        yield from layout.require_signals()
        yield from layout.require_traces(self.order)
        if not layout.recorded:
            return
        issues, n_panels = [], 0
        for text in self._names(layout):
            shape, issue = _shape_of(layout, text)
            issues += [issue] if issue else []
            n_panels += 1 if "." in text or shape is None else math.prod(shape)
        yield from issues
        yield from self._check_zoom(layout)
        if self.difference and len(layout.methods) < 2:
            yield Issue("difference", "compares methods with the baseline: needs at least two methods")
        if not issues:
            advice = "choose components such as x.0"
            yield from layout.require_at_most(MOST_SIGNALS, n_panels, "panels", "signals", advice)
        if self.signals == []:
            yield Issue("signals", "must name at least one signal")
        yield from layout.require_window(self.from_, self.to)

    def _check_zoom(self, layout: ResultLayout) -> Iterator[Issue]:
        """Yield an issue for an enlarged signal that does not exist, or that is not one component."""
        if not isinstance(self.zoom, Zoom):
            return
        shape, issue = _shape_of(layout, self.zoom.signal)
        if issue is not None:
            yield Issue("zoom.signal", issue.message)
        elif shape is not None and "." not in self.zoom.signal and math.prod(shape) > 1:
            yield Issue("zoom.signal", f"must be one component, such as {self.zoom.signal}.0")
        if self.zoom.from_ >= self.zoom.to:
            yield Issue("zoom.from", f"must be less than `to` (got {self.zoom.from_:g} and {self.zoom.to:g})")
            return
        for each in layout.require_window(self.zoom.from_, self.zoom.to):
            yield Issue("zoom.from", each.message)

    def caption(self, results: Trials) -> str:
        """Define lines and bands, count the runs and name the enlarged part; see `Figure.caption`."""
        return caption_of(self._content(results))

    def draw(self, results: Trials) -> MplFigure:
        """Draw the recorded runs of one point; see `Figure.draw`."""
        made = self._content(results)
        n = len(made.panels) + (made.zoom is not None)
        return draw_panels(made, self.size(0.8 + 1.2 * n + 0.15 * (made.zoom is not None)))

    def _content(self, results: Trials) -> Content:
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods = self.order or list(layout.signals)
        panels = [each for text in self._names(layout) for each in _components(point, layout, text)]
        if self.difference:
            methods = [name for name in methods if name != point.baseline]
            if not methods:
                raise DesignError(
                    f"no run of a method besides the baseline '{point.baseline}' is recorded", "difference"
                )
            point = differences(point, methods)
        methods = [name for name in methods if any(each.is_in(point.traces[name]) for each in panels)]
        window = window_of(point, last_sample(point, methods[0]), self.from_, self.to)
        runs = {name: select_runs(point, name) for name in methods}
        zoom = None
        if isinstance(self.zoom, Zoom):
            (panel,) = _components(point, layout, self.zoom.signal)
            zoom = panel, window_of(point, last_sample(point, methods[0]), self.zoom.from_, self.zoom.to)
        elif self.zoom == "auto" and len(panels) <= MOST_PANELS_WITH_ZOOM and not self.width_of_band:
            zoom = automatic_zoom(point, panels, window, runs)
        options = CurveOptions(self.runs, self.edges, self.width_of_band)
        return Content(point, title, panels, window, runs, zoom, options, self.difference)

    def _names(self, layout: ResultLayout) -> Sequence[str]:
        """Signals to show; by default the usual ones that are recorded."""
        if self.signals is not None:
            return self.signals
        return tuple(name for name in USUAL if name in layout.signal_names) or USUAL


def _shape_of(layout: ResultLayout, text: str) -> tuple[Shape | None, Issue | None]:
    """Find the shape of a signal, None if it is not known, and what is wrong with a text such as ``x_hat.2``."""
    name, dot, index = text.partition(".")
    recorded = OUTPUT if name == ERROR and ERROR not in layout.signal_names else name
    shapes = [signals[recorded] for signals in layout.signals.values() if recorded in signals]
    if not shapes:
        return None, Issue("signals", f"{name!r} is not recorded (recorded: {', '.join(layout.signal_names)})")
    shape = None if None in shapes else min((each for each in shapes if each is not None), key=math.prod)
    n = None if shape is None else math.prod(shape)
    if dot and not (index.isdecimal() and (n is None or int(index) < n)):
        last = f" to {name}.{n - 1}" if n is not None else ""
        return shape, Issue("signals", f"{text!r} is not a component (they count from {name}.0{last})")
    return shape, None


def _components(point: Trials, layout: ResultLayout, text: str) -> list[PanelSignal]:
    """Find the panels of a text such as ``y`` or ``x_hat.2``; a signal stands for all its components."""
    name, dot, index = text.partition(".")
    shape, _ = _shape_of(layout, text)
    assert shape is not None, "recorded signals have known shapes"
    found = []
    for component in [int(index)] if dot else range(math.prod(shape)):
        place = ",".join(map(str, np.unravel_index(component, shape))) if math.prod(shape) > 1 else ""
        label = component_label(point, name, component, place)
        if name == ERROR:
            label = with_unit(symbol(name, place), unit_of(point, f"{OUTPUT}.{component}"))
        found.append(PanelSignal(name, component, label))
    return found
