"""A metric, or its paired change against the baseline, over two swept values: a panel of coloured cells per method."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.heat_cells import Grid, draw_cells
from rmpc_bench.figures.labels import metric_of
from rmpc_bench.figures.shared_content import shared_content
from rmpc_bench.figures.sweep_axis import axis_of, other_paths, panel_title
from rmpc_bench.figures.sweep_captions import cells_caption
from rmpc_bench.figures.sweep_lines import no_path, require_changes
from rmpc_bench.figures.sweep_points import MOST_PANELS, points_at
from rmpc_bench.figures.sweep_values import Content, SpreadKind, changes_at, values_of
from rmpc_bench.types import DesignError
from rmpc_bench.types.figure import SweepFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials


@dataclass(frozen=True, kw_only=True)
class HeatMap(SweepFigure):
    """A metric, or its paired change against the baseline, over two swept values: coloured cells, a panel per method.

    A change has the average and the interval of comparisons.csv.  Its colours run from blue, below 0, over grey to
    yellow; no change and the whole margin of relevance are grey.  Their lightness rises all the way, so that the order
    is visible in black and white.  A cell whose interval contains 0 is hatched.  A value is the mean of the runs, or
    the median of a metric that may not occur, on a scale from dark to light.  The number is written into the cells
    where it fits into all of them.  A point that the sweep leaves out, and one without a value, stays white.

    Parameters
    ----------
    x : swept path of the horizontal axis; the first one of a sweep of two paths if not given
    y : swept path of the vertical axis; the other one if not given
    metric : name of the metric; the primary one if not given
    show : `change` shows the paired change against the baseline, `value` the metric
    log : logarithmic scale of the colours of values, which must be positive
    numbers : whether the numbers are written into the cells where they fit
    height : height of the whole picture [in]; if not given it follows from the numbers of panels and rows
    order : methods to show, from top to bottom; all if not given
    at : points of the sweep to show, each by values of its paths; all if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    x: str | None = None
    y: str | None = None
    metric: str | None = None
    show: Content = "change"
    log: bool = False
    numbers: bool = True

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: two different swept paths, beside which nothing else changes, and few methods."""
        yield from super().check(layout)
        if self.show == "change":
            yield from require_changes(layout, log=self.log)
        if not layout.points:
            return
        issues = list(self._check_paths(layout))
        yield from issues
        n_methods = len(self.order or layout.methods) - (self.show == "change" and self.order is None)
        yield from layout.require_at_most(MOST_PANELS, n_methods, "methods", "order", "choose methods with `order`")
        if not issues and self.at is None:
            others = other_paths(layout.points, *self._paths(layout))
            if others:
                yield Issue("at", f"{', '.join(others)} changes as well: choose points with `at`")

    def _check_paths(self, layout: ResultLayout) -> Iterator[Issue]:
        """Both paths are swept, and they are different."""
        paths = list(layout.points[0])
        if len(paths) != 2 and not (self.x and self.y):
            key = "y" if self.x else "x"
            few = f"two values must be swept (swept: {', '.join(paths) or 'nothing'})"
            yield Issue(key, few if len(paths) < 2 else f"must name one of the swept paths: {', '.join(paths)}")
            return
        for key in ("x", "y"):
            path = getattr(self, key)
            if path is not None and path not in paths:
                yield Issue(key, no_path(path, paths))
                return
        if self.x is not None and self.x == self.y:
            yield Issue("y", "must be another path than x")

    def _paths(self, layout: ResultLayout) -> tuple[str, str]:
        """Return the paths of both axes."""
        paths = list(layout.points[0])
        x = self.x or next(path for path in paths if path != self.y)
        return x, self.y or next(path for path in paths if path != x)

    def draw(self, results: Trials) -> MplFigure:
        """Draw the cells of all methods; see `Figure.draw`."""
        return draw_cells(self, results, self._grid(results), log=self.log, numbers=self.numbers)

    def caption(self, results: Trials) -> str:
        """Say what the colours are, and the range of every method; see `Figure.caption`."""
        return cells_caption(results, self._grid(results))

    def _grid(self, results: Trials) -> Grid:
        return shared_content(results, self, lambda: self._compute(results))

    def _compute(self, results: Trials) -> Grid:
        """Compute what the figure shows."""
        layout = layout_of(results)
        self.require(layout)
        info, points = metric_of(results, self.metric), points_at(results, self.at)
        coordinates = [point.point for point in points]
        x, y = self._paths(layout)
        others = other_paths(layout.points, x, y)
        titles = {panel_title(point, others) for point in coordinates}
        if len(titles) > 1:
            raise DesignError(f"{', '.join(others)} differs between these points: choose points with `at`", "at")
        if self.show == "change":
            values = changes_at(results, points, info, self.order)
        else:
            spread: SpreadKind = "quartiles" if info.may_not_occur else "interval"
            values = values_of(points, info, self.order or results.methods, spread)
        places = {(point[x], point[y]): place for place, point in enumerate(coordinates)}
        return Grid(info, axis_of(coordinates, x), axis_of(coordinates, y), places, titles.pop(), values)
