"""Metric over a swept value: one line per method, the other coordinates of the sweep as panels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import drawable, few_ticks, make_logarithmic_if_positive, stacked_panels
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, metric_label, metric_of, wrapped
from rmpc_bench.figures.legend import finish
from rmpc_bench.figures.line_styles import LineStyle, line_styles
from rmpc_bench.figures.pareto_front import Spread, spread_of
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.figures.sweep_points import MOST_PANELS, points_at
from rmpc_bench.types import DesignError, MetricInfo
from rmpc_bench.types.figure import SweepFigure
from rmpc_bench.types.issue import Issue, unknown
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

MEANING = {"quartiles": "medians, bars: interquartile range", "se": "means, bars: standard errors"}
BEST = {"one": 1.0, "zero": 0.0}
"""Best values of the metrics for which neither low nor high values are best."""


@dataclass(frozen=True, kw_only=True)
class SweepLines(SweepFigure):
    """A metric over a swept number: one line per method, with the spread over the runs as bars.

    Points that differ in another coordinate of the sweep are panels, one below the other, with a common axis.  A grey
    line shows the best value of a metric that is best at 0 or 1.  Failed runs are left out.

    Parameters
    ----------
    path : swept path of the horizontal axis, whose values are numbers; the only path of the sweep if not given
    metric : name of the metric; the primary one if not given
    bars : `quartiles` shows medians with interquartile ranges, `se` means with standard errors
    log : logarithmic vertical axis; linear, with a remark, if a value is not positive
    height : height of the whole picture [in]; if not given 1.2 and 1.4 for every panel; legend and title add to it if
        they need more than a line
    order : methods to show, later ones above earlier ones; all if not given
    at : points of the sweep to show, each by values of its paths; all if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    path: str | None = None
    metric: str | None = None
    bars: Literal["quartiles", "se"] = "quartiles"
    log: bool = False

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: a swept path of numbers, and no more panels than fit."""
        yield from super().check(layout)
        paths = list(layout.points[0]) if layout.points else []
        if not layout.points:
            return
        if self.path not in paths and (self.path is not None or len(paths) != 1):
            yield Issue("path", _no_path(self.path, paths))
            return
        path = self.path or paths[0]
        others = {value for value in (point[path] for point in layout.points) if _number(value) is None}
        if others:
            yield Issue("path", f"the values of {path} must be numbers (got {min(others)})")
        elif self.at is None:
            panels = {panel_title(point, path) for point in layout.points}
            yield from layout.require_at_most(MOST_PANELS, len(panels), "panels", "at", "choose points with `at`")

    def draw(self, results: Trials) -> MplFigure:
        """Draw the lines of all panels; see `Figure.draw`."""
        layout = layout_of(results)
        self.require(layout)
        path, info = self.path or next(iter(layout.points[0])), metric_of(results, self.metric)
        panels = lines_of(points_at(results, self.at), path, info, self.order or results.methods, self.bars)
        if len(panels) > MOST_PANELS:
            raise DesignError(f"{len(panels)} panels do not fit into one figure (at most {MOST_PANELS})", "at")
        return _draw(self, results, panels, path, info)


class SweepLine(NamedTuple):
    """The line of a method: values of the path, ascending, and the spread of the metric at each."""

    x: list[float]
    y: list[Spread]


def lines_of(
    points: Sequence[Trials], path: str, info: MetricInfo, methods: Sequence[str], bars: str
) -> dict[str, dict[str, SweepLine]]:
    """Find the lines of every panel.

    Parameters
    ----------
    points : the tables of the points to show
    path : swept path of the horizontal axis
    info : the metric
    methods : methods to show
    bars : `quartiles` or `se`

    Returns
    -------
    title of the panel, empty if nothing else is swept -> method -> line
    """
    found: dict[str, dict[str, SweepLine]] = {panel_title(point.point, path): {} for point in points}
    for point in sorted(points, key=lambda point: float(point.point[path])):
        panel = found[panel_title(point.point, path)]
        for name in methods:
            column = point.column(info.name, name)
            line = panel.setdefault(name, SweepLine([], []))
            line.x.append(float(point.point[path]))
            line.y.append(spread_of(column[~np.isnan(column)], bars))
    return found


def panel_title(point: Mapping[str, str], path: str) -> str:
    """Name the coordinates of a point besides the one of the horizontal axis, such as ``set=stacked``."""
    others = {name: value for name, value in point.items() if name != path}
    last = [name.rpartition(".")[2] for name in others]
    names = last if len(set(last)) == len(last) else list(others)
    return ", ".join(f"{name}={value}" for name, value in zip(names, others.values(), strict=True))


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _no_path(path: str | None, paths: Sequence[str]) -> str:
    if not paths:
        return "nothing is swept in this configuration"
    if path is None:
        return f"must name one of the swept paths: {', '.join(paths)}"
    return unknown(path, paths, "path of the sweep")


def _draw(
    keys: SweepLines, trials: Trials, panels: Mapping[str, Mapping[str, SweepLine]], path: str, info: MetricInfo
) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.lines import Line2D

    size = keys.size(1.2 + 1.4 * len(panels))
    methods = list(dict.fromkeys(name for lines in panels.values() for name in lines))
    styles = line_styles(trials.all_methods, methods)
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        rows = stacked_panels(figure, len(panels))
        for axes, (title, lines) in zip(rows, panels.items(), strict=True):
            few_ticks(axes)
            axes.set_title("\n".join(wrapped(literal(title), 0.8 * size[0] * POINTS_PER_INCH)))
            for name, line in lines.items():
                middle = np.array([spread.middle for spread in line.y])
                axes.plot(line.x, np.where(np.isfinite(middle), middle, np.nan), ms=3.0, **_look(styles[name]))
            axes.set_ylabel(metric_label(info) + _set_limits(axes, lines, info, log=keys.log))
            for name, line in lines.items():
                low, high = (drawable(np.array(ends)) for ends in zip(*((y.low, y.high) for y in line.y), strict=True))
                axes.vlines(line.x, low, high, color=styles[name].color, lw=0.9, zorder=2.4)
        rows[-1].set_xlabel(literal(path.rpartition(".")[2]))
        handles = [(trials.labels.get(name, name), Line2D([], [], ms=3.0, **_look(styles[name]))) for name in methods]
        finish(figure, handles, _note(trials, next(iter(panels)), keys.bars))
    return figure


def _look(look: LineStyle) -> dict[str, Any]:
    """Return line and marker of a method."""
    return {**look.line(), "marker": look.marker}


def _set_limits(axes: Axes, lines: Mapping[str, SweepLine], info: MetricInfo, *, log: bool) -> str:
    """Choose scale and limits for the finite ends of all bars; return a remark for the label of the axis."""
    places = [(x, end) for line in lines.values() for x, y in zip(line.x, line.y, strict=True) for end in y]
    finite = np.array([place for place in places if math.isfinite(place[1])])
    if len(finite):
        axes.update_datalim(finite)
    if info.direction in BEST:
        axes.axhline(BEST[info.direction], color=REFERENCE, lw=0.9, zorder=2.1)
    axes.autoscale_view()
    remark = make_logarithmic_if_positive(axes, [finite[:, 1]]) if log and len(finite) else ""
    axes.autoscale_view()
    axes.autoscale(False)
    return remark


def _note(trials: Trials, title: str, bars: str) -> str:
    """Name the first panel and explain the bars."""
    n = len(trials.each[0].runs)
    meaning = "1 run" if n == 1 else f"{MEANING[bars]}, {n} runs"
    return f"{title}; {meaning}" if title else meaning
