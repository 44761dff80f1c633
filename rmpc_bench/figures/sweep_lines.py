"""A metric, or its paired change against the baseline, over a swept value: one line per method, with its spread."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.labels import metric_of
from rmpc_bench.figures.shared_content import shared_content
from rmpc_bench.figures.sweep_axis import POINTS, axis_of, other_paths, panel_title, usual_path
from rmpc_bench.figures.sweep_captions import lines_caption
from rmpc_bench.figures.sweep_panels import SweepContent, draw_sweep
from rmpc_bench.figures.sweep_points import MOST_PANELS, points_at, short_title
from rmpc_bench.figures.sweep_values import Content, SpreadKind, changes_at, values_of
from rmpc_bench.types import DesignError
from rmpc_bench.types.figure import SweepFigure
from rmpc_bench.types.issue import Issue, unknown
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

MOST_ROWS = 48
"""Rows of methods in all categories that fit below each other."""


@dataclass(frozen=True, kw_only=True)
class SweepLines(SweepFigure):
    """A metric, or its paired change against the baseline, over a swept value, one line per method.

    For numbers the figure shows curves with bands, or with bars where more than three methods share a panel.  Their
    axis is logarithmic where the ratios of neighbouring numbers vary less than their differences.  Other values, such
    as names, are categories, each a row with one mark per method.  Points that differ in another coordinate of the
    sweep are panels, one below the other, with a common axis.  Values are those of summary.csv, changes those of
    comparisons.csv; the grey band of a change is the margin of relevance.  A grey line shows the best value of a metric
    that is best at 0 or 1, and no change.  Failed runs are left out.

    Parameters
    ----------
    path : swept path of the axis, or `points`, which makes every point of the sweep a category; if not given, the only
        path of the sweep, or the names of its points
    metric : name of the metric; the primary one if not given
    show : `value` shows the metric, `change` its paired change against the baseline with its confidence interval
    spread : for values: `quartiles` shows medians with interquartile ranges, `se` means with standard errors and
        `interval` means with confidence intervals
    drawn : spreads as `bands` or as `bars`; `auto` chooses bands for at most three methods
    log : logarithmic axis of the values; linear, with a remark, if a value is not positive
    label : text of the axis of the swept value; made from the path if not given
    height : height of the whole picture [in]; if not given it follows from the numbers of panels and rows; legend and
        title add to it if they need more than a line
    order : methods to show, later ones above earlier ones; all if not given
    at : points of the sweep to show, each by values of its paths; all if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    path: str | None = None
    metric: str | None = None
    show: Content = "value"
    spread: SpreadKind = "quartiles"
    drawn: Literal["auto", "bands", "bars"] = "auto"
    log: bool = False
    label: str | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: a swept path, and no more panels and rows than fit."""
        yield from super().check(layout)
        if self.show == "change":
            yield from require_changes(layout, log=self.log)
        if not layout.points:
            return
        paths = list(layout.points[0])
        path = self.path or usual_path(layout.points)
        if not paths or path is None or path not in (*paths, POINTS):
            yield Issue("path", no_path(self.path, paths))
        elif self.at is None:
            others = other_paths(layout.points, path)
            panels = {panel_title(point, others) for point in layout.points}
            yield from layout.require_at_most(MOST_PANELS, len(panels), "panels", "at", "choose points with `at`")
            # The baseline has no change against itself.
            n_methods = len(self.order or layout.methods[self.show == "change" :])
            axis = axis_of(layout.points, path, [str(place) for place in range(len(layout.points))])
            if axis.numbers is None:
                n_rows = len(axis.texts) * n_methods * len(panels)
                advice = "choose points with `at` or methods with `order`"
                yield from layout.require_at_most(MOST_ROWS, n_rows, "rows", "at", advice)

    def draw(self, results: Trials) -> MplFigure:
        """Draw the lines of all panels; see `Figure.draw`."""
        content = self._content(results)
        return draw_sweep(self, results, content, drawn=self.drawn, spread=self.spread, log=self.log)

    def caption(self, results: Trials) -> str:
        """Say what the lines and spreads are, and where every method is best; see `Figure.caption`."""
        return lines_caption(results, self._content(results), self.spread)

    def _content(self, results: Trials) -> SweepContent:
        return shared_content(results, self, lambda: self._compute(results))

    def _compute(self, results: Trials) -> SweepContent:
        """Compute what the figure shows."""
        layout = layout_of(results)
        self.require(layout)
        info, points = metric_of(results, self.metric), points_at(results, self.at)
        path = self.path or usual_path(layout.points)
        assert path is not None, "the check of the figure requires one"
        titles = [short_title(point) for point in points]
        axis = axis_of([point.point for point in points], path, titles)
        others = other_paths(layout.points, path)
        panels: dict[str, dict[str, int]] = {}
        for place, point in enumerate(points):
            text = titles[place] if path == POINTS else point.point[path]
            panels.setdefault(panel_title(point.point, others), {})[text] = place
        if len(panels) > MOST_PANELS:
            raise DesignError(f"{len(panels)} panels do not fit into one figure (at most {MOST_PANELS})", "at")
        if self.show == "change":
            values = changes_at(results, points, info, self.order)
        else:
            values = values_of(points, info, self.order or results.methods, self.spread)
        return SweepContent(info, axis if self.label is None else axis._replace(words=self.label), panels, values)


def require_changes(layout: ResultLayout, *, log: bool) -> Iterator[Issue]:
    """There is a method besides the baseline, and no logarithmic axis for changes, which may be negative."""
    if len(layout.methods) < 2:
        yield Issue("show", "compares methods with the baseline: needs at least two methods")
    if log:
        yield Issue("log", "changes may be negative: leave log out, or show the value")


def no_path(path: str | None, paths: Sequence[str]) -> str:
    """Say why a path is no path of the sweep."""
    if not paths:
        return "nothing is swept in this configuration"
    if path is None:
        return f"must name one of the swept paths: {', '.join(paths)}; `{POINTS}` shows every point of the sweep"
    return unknown(path, [*paths, POINTS], "path of the sweep")
