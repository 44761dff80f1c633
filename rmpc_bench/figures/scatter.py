"""Methods in the plane of two metrics with their Pareto front, or one run in the plane of two signals."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import quantile, standard_error
from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.analysis.shown_numbers import Estimate
from rmpc_bench.figures.axes import drawable, few_ticks, make_logarithmic, stacked_panels
from rmpc_bench.figures.labels import (
    LINEAR,
    joined,
    literal,
    metric_of,
    name_of,
    quantity,
    runs_sentence,
    sentence,
    short_title,
    typeset,
    with_unit,
)
from rmpc_bench.figures.legend import Handle, Label, finish, write
from rmpc_bench.figures.palette import DIM, GROUND, LineStyle, line_styles, paler, sample
from rmpc_bench.figures.points import points_at
from rmpc_bench.figures.scatter_paths import SignalPlane, draw_paths, paths_caption, paths_content
from rmpc_bench.figures.style import new_figure, style
from rmpc_bench.types import Array, DesignError, MetricInfo, NonNegative, Positive
from rmpc_bench.types.errors import Issue, unknown
from rmpc_bench.types.figure import Index, SweepFigure
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials


class Dot(NamedTuple):
    """A method at a point of the sweep."""

    method: str
    point: Trials
    x: Estimate
    y: Estimate
    n: int  # runs that have both values
    n_runs: int

    @property
    def at(self) -> tuple[float, float]:
        """Its place."""
        return self.x.value, self.y.value

    @property
    def is_finite(self) -> bool:
        """Whether it can be drawn."""
        return bool(np.isfinite(self.at).all())


def dots_of(
    points: Sequence[Trials], methods: Sequence[str], infos: tuple[MetricInfo, MetricInfo], bars: str
) -> list[Dot]:
    """Find the dots of every method in the order of the sweep, shared trials once; a DesignError if there is none."""
    found: dict[tuple[str, str], Dot] = {}
    for name in methods:
        for point in points:
            key = name, point.keys.get(name, point.title)
            if name in point.methods and key not in found:
                found[key] = _dot(point, name, infos, bars)
    if not any(dot.is_finite for dot in found.values()):
        raise DesignError(f"no method has a value of both {infos[0].name} and {infos[1].name}", "x")
    return list(found.values())


def not_dominated(dots: Sequence[Dot], infos: tuple[MetricInfo, MetricInfo]) -> list[Dot]:
    """Find the drawable dots that are not dominated, from best in x to best in y, by the metrics' directions."""
    signs = [-1.0 if info.direction == "higher" else 1.0 for info in infos]
    costs = [(signs[0] * dot.x.value, signs[1] * dot.y.value) for dot in dots]
    found = sorted(zip(costs, dots, strict=True), key=lambda each: each[0])
    return [dot for (x, y), dot in found if not any(a <= x and b <= y and (a, b) != (x, y) for a, b in costs)]


def _dot(point: Trials, name: str, infos: tuple[MetricInfo, MetricInfo], bars: str) -> Dot:
    from rmpc_bench.analysis.pairs import distance_from_best

    columns = [point.column(info.name, name) for info in infos]
    both: Array = ~np.isnan(np.stack(columns)).any(axis=0)
    x, y = (
        _estimate(distance_from_best(column[both], info.direction), bars)
        for column, info in zip(columns, infos, strict=True)
    )
    return Dot(name, point, x, y, int(both.sum()), len(both))


def _estimate(values: Array, bars: str) -> Estimate:
    """Return the median with the quartiles, or the mean with one standard error (`se`) on both sides, without NaN."""
    if bars == "quartiles":
        return Estimate(*(float(quantile(values, share)) for share in (0.5, 0.25, 0.75)))
    with np.errstate(invalid="ignore", over="ignore"):
        mean = float(values.mean()) if len(values) else np.nan
    error = standard_error(values)
    return Estimate(mean, mean - error, mean + error)


MOST_DOTS = 60  # dots that can still be distinguished
MEANING = {"quartiles": "medians, bars: interquartile range", "se": "means, bars: standard errors"}
FRONT: dict[str, Any] = {"color": DIM, "lw": 0.9, "zorder": 2.1}


@dataclass(frozen=True, kw_only=True)
class Scatter(SweepFigure):
    """Two metrics, one point per method with its spread and the Pareto front, or two signals of a run as a path.

    Two metrics: a point is not dominated if no other point is better in one metric and at least as good in the other.
    Such points are filled, and a step line connects them.  For a metric that is best at 0 the absolute value is
    compared, for a ratio that is best at 1 the larger of it and its inverse.  Failed runs and methods with an infinite
    median or mean are left out.  In a sweep over numbers a line connects the points of a method.  All points are
    compared, so that the sweep should not change plant, noises or reference.

    Two signals, each a component such as y.0 or x.1: the path of one recorded run, a line for every method.  Both axes
    have one scale if both have one unit.  The reference of two outputs is dashed, with a broad grey band in bursts of
    the noise; limits of the controller are dotted.

    Parameters
    ----------
    x : metric, or component of a recorded signal, of the horizontal axis
    y : the same of the vertical axis
    bars : `quartiles` shows medians with interquartile ranges, `se` means with standard errors
    front : whether to show the Pareto front
    log : logarithmic axes of metrics; linear, with a remark, if a value is not positive
    run : index of the recorded run of a path
    marks : time between two marks on the paths [s], with numbers next to the reference; 0 for none
    magnify : factor on the distances from the reference, r + magnify (y - r)
    from_ : first time of a path to show [s]
    to : last time of a path to show [s]
    height : height of the whole picture [in]; if not given 0.8 of the width, or that of the paths within limits
    order : methods to show, later ones above earlier ones; all if not given
    at : points of the sweep, each by values of its paths (default: all), and the first one of a path
    """

    needs_runs: ClassVar[bool] = True

    x: str
    y: str
    bars: Literal["quartiles", "se"] = "quartiles"
    front: bool = True
    log: bool = False
    run: Index = 0
    marks: NonNegative = 0.0
    magnify: Positive = 1.0
    from_: NonNegative | None = None
    to: NonNegative | None = None

    @property
    def plane(self) -> SignalPlane:
        """The keys of a path."""
        keys = (self.x, self.y, self.run, self.marks, self.magnify, self.from_, self.to)
        return SignalPlane(*keys, tuple(self.order) if self.order else None)

    def check_names(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add two metrics, or two signals where neither is a metric."""
        yield from super().check_names(layout)
        if self.x == self.y:
            yield Issue("y", "must be another metric or signal than x")
        elif not self._of_signals(layout):
            for key, name in (("x", self.x), ("y", self.y)):
                if name not in layout.metrics:
                    signals = f"; recorded signals: {', '.join(layout.signal_names)}" if layout.signal_names else ""
                    yield Issue(key, unknown(name, layout.metrics, "metric of this configuration") + signals)

    def _of_signals(self, layout: ResultLayout) -> bool:
        """Whether a path is asked for: neither name is a metric, and one of them is that of a recorded signal."""
        stems = {name.partition(".")[0] for name in (self.x, self.y)}
        return not {self.x, self.y} & {*layout.metrics} and bool(stems & {*layout.signal_names, "y", "x", "u"})

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: a recorded run of a path, and no more points than can be distinguished."""
        yield from super().check(layout)
        if self._of_signals(layout):
            yield from self.plane.check(layout)
            return
        n = len(self.order or layout.methods) * max(1, layout.n_points_at(self.at))
        advice = "choose some points of the sweep, or fewer methods"
        yield from layout.require_at_most(MOST_DOTS, n, "points of methods", "at", advice)

    def caption(self, results: Trials) -> str:
        """Define what is drawn; see `Figure.caption`."""
        if self._of_signals(layout_of(points_at(results, self.at)[0])):
            return paths_caption(paths_content(self.plane, points_at(results, self.at)))
        infos = metric_of(results, self.x), metric_of(results, self.y)
        points, methods = points_at(results, self.at), self.order or list(results.methods)
        dots = dots_of(points, methods, infos, self.bars)
        left_out = dict.fromkeys(name_of(results, dot.method) for dot in dots if not dot.is_finite)
        each = "method and point of the sweep" if len(points) > 1 else "method"
        return sentence(
            f"{quantity(infos[1])} against {quantity(infos[0])}, one point for every {each}: {MEANING[self.bars]}",
            "filled points, connected by the step line, are not dominated" if self.front else "",
            f"left out, as a value is infinite: {joined(left_out)}" if left_out else "",
            runs_sentence(points, methods),
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw points or paths; see `Figure.draw`."""
        points = points_at(results, self.at)
        if self._of_signals(layout := layout_of(points[0])):
            self.require(layout)
            made = paths_content(self.plane, points)
            return draw_paths(made, self.size(made.height(self.width)))
        self.require(layout_of(results))
        infos = metric_of(results, self.x), metric_of(results, self.y)
        dots = dots_of(points, self.order or results.methods, infos, self.bars)
        shown = [dot for dot in dots if dot.is_finite]
        best = not_dominated(shown, infos) if self.front else []
        styles = line_styles(results.all_methods, list(dict.fromkeys(dot.method for dot in shown)))
        several = frozenset(name for name in styles if sum(dot.method == name for dot in shown) > 1)
        for listed in (several, frozenset(styles)):
            with style():
                figure = new_figure(self.size(0.8 * self.width))
                (axes,) = stacked_panels(figure, 1)
                few_ticks(axes)
                for dot in shown:
                    filled = not self.front or dot in best
                    axes.plot(*dot.at, zorder=3.0, **_marker(styles[dot.method], filled=filled))
                _set_limits(axes, shown, infos, log=self.log)
                lines = _draw_lines(axes, shown, best, styles)
                handles = _handles(results, shown, listed, styles, front=self.front)
                finish(figure, handles, _note(dots, MEANING[self.bars]))
                # If labels beside the dots overlap, all methods go into the legend.
                if write(axes, _labels(results, shown, listed, several), lines):
                    break
        return figure


def _marker(look: LineStyle, *, filled: bool) -> dict[str, Any]:
    """Return the marker of a method; that of a dominated dot is hollow."""
    inside = look.color if filled else GROUND
    return {"ls": "", "marker": look.marker, "ms": 4.2, "mew": 1.0, "mec": look.color, "mfc": inside, "gid": look.gid}


def _set_limits(axes: Axes, shown: Sequence[Dot], infos: tuple[MetricInfo, MetricInfo], *, log: bool) -> None:
    """Choose scales and limits that contain all dots and the finite ends of their bars, with room for labels."""
    from rmpc_bench.analysis.pairs import name_of_distance

    ends = np.array([[[*dot.x], [*dot.y]] for dot in shown])  # (dots, 2, 3)
    finite = np.where(np.isfinite(ends), ends, ends[:, :, :1])
    axes.update_datalim(np.concatenate([finite.min(axis=2), finite.max(axis=2)]))
    axes.margins(0.14)
    for place, info in enumerate(infos):
        unit = "" if info.direction == "one" else info.unit
        positive = bool((finite[:, place] > 0).all())
        axes.autoscale_view()
        if log and positive:
            make_logarithmic(axes, horizontal=place == 0)
        remark = LINEAR if log and not positive else ""
        label = with_unit(typeset(name_of_distance(info, info.words)), unit) + remark
        (axes.set_ylabel if place else axes.set_xlabel)(label)
    axes.autoscale_view()
    axes.autoscale(False)


def _draw_lines(
    axes: Axes, shown: Sequence[Dot], best: Sequence[Dot], styles: Mapping[str, LineStyle]
) -> list[tuple[Array, Array]]:
    """Draw bars, the lines through the dots of a method and the steps from one of the best dots to the next."""
    lines: list[tuple[Array, Array, dict[str, Any]]] = []
    for dot in shown:
        look = styles[dot.method]
        bar: dict[str, Any] = {"color": paler(look.color, 0.35), "lw": 1.0, "zorder": 2.4, "gid": look.gid}
        x, y = (drawable(np.array([each.low, each.high])) for each in (dot.x, dot.y))
        lines += [(x, np.full(2, dot.y.value), bar), (np.full(2, dot.x.value), y, bar)]
    values = {value for dot in shown for value in dot.point.point.values()}
    # Points with names are in no order that a line could show.
    if all(re.fullmatch(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?", value) for value in values):
        for name, look in styles.items():
            mine = [dot.at for dot in shown if dot.method == name]
            line = {"color": paler(look.color, 0.5), "lw": 0.9, "zorder": 2.3, "gid": look.gid}
            lines.append((*np.array(mine).T, line))
    if best:
        across, up = np.array([dot.at for dot in best]).T
        lines.append((np.repeat(across, 2)[1:], np.repeat(up, 2)[:-1], FRONT))
    for x, y, how in lines:
        axes.plot(x, y, **how)
    return [(x, y) for x, y, _ in lines if np.isfinite(np.stack([x, y])).all()]


def _handles(
    trials: Trials, shown: Sequence[Dot], listed: frozenset[str], styles: Mapping[str, LineStyle], *, front: bool
) -> list[Handle]:
    """Make the legend entries of methods without labels beside their dots, and of the front."""
    found: list[Handle] = []
    for name in (name for name in styles if name in listed):
        mine = [dot for dot in shown if dot.method == name]
        text = name_of(trials, name) + (_count(mine[0], shown) if len(mine) == 1 else "")
        found.append((text, sample(**_marker(styles[name], filled=True))))
    filled = {**FRONT, "marker": "o", "ms": 4.2, "mec": DIM, "mfc": DIM}
    return [*found, ("not dominated", sample(**filled))] if front else found


def _labels(trials: Trials, shown: Sequence[Dot], listed: frozenset[str], several: frozenset[str]) -> list[Label]:
    """Label a dot with its method, or with its point of the sweep if the method has several."""
    found = []
    for dot in shown:
        if dot.method in several or dot.method not in listed:
            text = literal(short_title(dot.point)) if dot.method in several else name_of(trials, dot.method)
            found.append(Label(*dot.at, text + _count(dot, shown), f"method-{dot.method}"))
    return found


def _count(dot: Dot, shown: Sequence[Dot]) -> str:
    """Give the number of runs of a dot, if it is not the same for all."""
    return "" if _runs(shown) else f", n={dot.n}" if dot.n == dot.n_runs else f", {dot.n}/{dot.n_runs}"


def _runs(dots: Sequence[Dot]) -> int:
    """Return the number of runs if it is the same everywhere and none is missing, else 0."""
    counts = {n for dot in dots for n in (dot.n, dot.n_runs)}
    return counts.pop() if len(counts) == 1 else 0


def _note(dots: Sequence[Dot], meaning: str) -> str:
    """Explain dots and bars, and name the methods that have no dot."""
    n = _runs([dot for dot in dots if dot.is_finite])
    names = dict.fromkeys(dot.method for dot in dots if not dot.is_finite)
    text = "1 run" if n == 1 else f"{meaning}, {n} runs" if n else meaning
    return text + (f"; left out: {', '.join(names)}" if names else "")
