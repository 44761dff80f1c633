"""Objective of every tuned method over its parameter, on the tuning runs and on the runs of the experiment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import few_ticks, make_logarithmic, stacked_panels
from rmpc_bench.figures.labels import at_point, literal, sentence, typeset
from rmpc_bench.figures.legend import finish
from rmpc_bench.figures.palette import DIM, line_styles, sample
from rmpc_bench.figures.points import point_at
from rmpc_bench.figures.style import new_figure, style
from rmpc_bench.types import Array, DesignError, ResultLayout
from rmpc_bench.types.errors import Issue
from rmpc_bench.types.figure import OnePointFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.types.tuning import TunedParameter, TuningSearch

MOST_METHODS = 8  # tuned methods that fit below each other
PANEL = 1.35  # height of a panel [in]
WIDE = 10.0  # factor between the smallest and the largest objective from which on their axis is logarithmic
TUNING: dict[str, Any] = {"ls": "-", "marker": "o", "ms": 3.0, "lw": 1.0}
TEST: dict[str, Any] = {"ls": (0, (4, 2)), "marker": "s", "ms": 3.5, "lw": 1.0, "mfc": "white"}
CHOSEN: dict[str, Any] = {"color": DIM, "ls": "-", "lw": 1.0}
DEFAULT: dict[str, Any] = {"color": DIM, "ls": (0, (1.2, 1.2)), "lw": 1.2}


@dataclass(frozen=True, kw_only=True)
class TuningOverParameter(OnePointFigure):
    """Objective of every tuned method over its parameter, on the tuning runs and on the runs of the experiment.

    Each value that was tried is a mark: a circle for the tuning runs, a square for the runs of the experiment, which
    are left out with ``regret: false``.  Vertical lines show the tuned value and the default.  A method with several
    parameters has a panel for each, in which the marks are not connected.  Values with which all runs have failed
    have no mark.  A parameter with an offset is shown without it.

    Parameters
    ----------
    height : height of the whole picture [in]; if not given 0.4 plus 1.35 for every panel
    order : methods to show, from top to bottom; all tuned ones if not given
    """

    needs_runs: ClassVar[bool] = True

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: a tuned method, and no more of them than fit."""
        yield from super().check(layout)
        shown = [name for name in layout.tuned if self.order is None or name in self.order]
        if not shown:
            way_out = "give one a range with `tune`" if not layout.tuned else f"tuned: {', '.join(layout.tuned)}"
            yield Issue("order" if layout.tuned else "", f"shows tuned methods, and there is none: {way_out}")
        yield from layout.require_at_most(MOST_METHODS, len(shown), "tuned methods", "order", "choose with `order`")

    def draw(self, results: Trials) -> MplFigure:
        """Draw a panel for every parameter; see `Figure.draw`."""
        title, panels = self._content(results)
        with style():
            figure = new_figure(self.size(0.4 + PANEL * len(panels)))
            for axes, panel in zip(stacked_panels(figure, len(panels), sharex=False), panels, strict=True):
                _draw(axes, panel)
            finish(figure, _legend(panels), title)
        return figure

    def caption(self, results: Trials) -> str:
        """Say what marks and lines are; see `Figure.caption`."""
        title, panels = self._content(results)
        search = panels[0].search
        test = "" if search.test is None else f", squares on the {search.test.shape[1]} runs of the experiment"
        return sentence(
            f"Objective of every value that was tried{at_point(title)} ({search.protocol.statistic} of "
            f"{search.protocol.metric}, failed runs cost a penalty): circles on the {search.tuning.shape[1]} tuning "
            f"runs{test}; solid vertical lines at the tuned value, dotted ones at the default"
        )

    def _content(self, results: Trials) -> tuple[str, list[Panel]]:
        """Find the title of the point and a panel for every parameter."""
        self.require(layout_of(results))
        point, title = point_at(results, self.at)
        searches = point.tuning.searches if point.tuning is not None else ()
        found = {each.method: each for each in searches if each.point == point.title}
        shown = [found[name] for name in self.order or point.methods if name in found]
        if not shown:
            raise DesignError("no search of these methods is recorded at this point", "order")
        styles = line_styles(point.all_methods, point.all_methods)
        return title, [Panel(each, k, styles[each.method].color) for each in shown for k in range(len(each.parameters))]


class Panel(NamedTuple):
    """A parameter of a method."""

    search: TuningSearch
    number: int  # of the parameter
    color: str  # of the method

    @property
    def parameter(self) -> TunedParameter:
        """The parameter."""
        return self.search.parameters[self.number]

    @property
    def default(self) -> float | None:
        """The default without the offset; None where it is no number, or outside of a logarithmic axis."""
        value = self.search.default[self.number]
        found = None if value is None else value - self.parameter.offset
        return None if found is None or (self.parameter.scale == "log" and found <= 0) else found


def _draw(axes: Axes, panel: Panel) -> None:
    """Draw both objectives, the tuned value and the default of a parameter."""
    search = panel.search
    places = search.candidates[:, panel.number] - panel.parameter.offset
    order = np.argsort(places, kind="stable")
    tested = None if search.test_objectives is None else search.test_objectives[:-1]
    drawn: list[Array] = []
    for values, keys in ((search.objectives, TUNING), (tested, TEST)):
        if values is None:
            continue
        use = order[np.isfinite(values[order])]
        line = keys if len(search.parameters) == 1 else {**keys, "ls": ""}
        axes.plot(places[use], values[use], color=panel.color, **line)
        drawn.append(values[use])
    if search.chosen is not None:
        axes.axvline(places[search.chosen], zorder=0.5, **CHOSEN)
    if panel.default is not None:
        axes.axvline(panel.default, zorder=0.5, **DEFAULT)
    if panel.parameter.scale == "log":
        axes.set_xscale("log")
    every = np.concatenate(drawn)
    if len(every) and every.min() > 0 and every.max() > WIDE * every.min():
        make_logarithmic(axes)
    else:
        few_ticks(axes)
    offset = f" - {panel.parameter.offset:g}" if panel.parameter.offset else ""
    axes.set_xlabel(literal(f"{search.method}: {panel.parameter.path}{offset}"))
    axes.set_ylabel(literal(search.protocol.metric))


def _legend(panels: Sequence[Panel]) -> list[tuple[str, Any]]:
    entries = [("tuning runs", {**TUNING, "color": "black"})]
    if any(panel.search.test is not None for panel in panels):
        entries.append(("runs of the experiment", {**TEST, "color": "black"}))
    entries.append(("tuned", CHOSEN))
    entries += [("default", DEFAULT)] if any(panel.default is not None for panel in panels) else []
    return [(typeset(text), sample(**keys)) for text, keys in entries]
