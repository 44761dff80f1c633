"""Methods in the plane of two metrics, with their spread over the runs, and which of them none is better than."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from rmpc_bench.analysis.intervals import quantile, standard_error
from rmpc_bench.analysis.statistics import from_best, name_from_best
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures import curves
from rmpc_bench.figures.curves import Look
from rmpc_bench.figures.direct_labels import Label, write
from rmpc_bench.figures.labels import literal, with_unit
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.figures.sweep_points import MOST_DOTS, TOO_MANY_DOTS, short
from rmpc_bench.types import Array, DesignError, MetricInfo

MARKERS = ("o", "s", "^", "D", "v")
MEANING = {"quartiles": "medians, bars: middle half", "se": "means, bars: standard errors"}
FRONT: dict[str, Any] = {"color": REFERENCE, "lw": 0.9, "zorder": 2.1}


Line: TypeAlias = tuple[Array, Array]
"""Coordinates of a broken line."""


class Spread(NamedTuple):
    """A value and the ends of its bar, NaN where there is none."""

    low: float
    middle: float
    high: float


class Dot(NamedTuple):
    """A method at a point of the sweep."""

    method: str
    point: Trials
    x: Spread
    y: Spread
    n: int
    """Runs that have both values."""
    n_runs: int

    @property
    def is_finite(self) -> bool:
        """Whether it can be drawn."""
        return bool(np.isfinite([self.x.middle, self.y.middle]).all())


def dots_of(
    points: Sequence[Trials], methods: Sequence[str], infos: tuple[MetricInfo, MetricInfo], bars: str
) -> list[Dot]:
    """Find the dots of every method in the order of the sweep, what points share once.

    Parameters
    ----------
    points : the tables of the points
    methods : methods to show
    infos : the metrics of both axes
    bars : `quartiles` or `se`

    Raises
    ------
    DesignError
        when no method has a value of both metrics, or there are too many dots
    """
    found: dict[tuple[str, str], Dot] = {}
    for name in methods:
        for point in points:
            key = name, point.keys.get(name, point.title)
            if name in point.methods and key not in found:
                found[key] = _dot(point, name, infos, bars)
    if len(found) > MOST_DOTS:
        raise DesignError(f"{len(found)} points {TOO_MANY_DOTS}", "at")
    if not any(dot.is_finite for dot in found.values()):
        raise DesignError(f"no method has a value of both {infos[0].name} and {infos[1].name}", "x")
    return list(found.values())


def not_dominated(dots: Sequence[Dot], infos: tuple[MetricInfo, MetricInfo]) -> list[Dot]:
    """Find the dots that none is better than, from the best in x to the best in y.

    Parameters
    ----------
    dots : all of which can be drawn
    infos : the metrics, of which those with the direction `higher` are better where they are larger
    """
    signs = [-1.0 if info.direction == "higher" else 1.0 for info in infos]
    costs = [(signs[0] * dot.x.middle, signs[1] * dot.y.middle) for dot in dots]
    best = [
        place
        for place, (x, y) in enumerate(costs)
        if not any(other[0] <= x and other[1] <= y and other != (x, y) for other in costs)
    ]
    return [dots[place] for place in sorted(best, key=lambda place: costs[place])]


def draw(
    trials: Trials,
    dots: Sequence[Dot],
    infos: tuple[MetricInfo, MetricInfo],
    size: tuple[float, float],
    *,
    bars: str,
    front: bool,
    log: bool,
) -> Figure:
    """Draw the dots; see `figures.pareto`.

    Parameters
    ----------
    trials : the whole table
    dots : of all methods, in the order of the sweep
    infos : the metrics of both axes
    size : width and height [in]
    bars : `quartiles` or `se`
    front : whether to show which dots are not dominated
    log : logarithmic axes where all values are positive
    """
    shown = [dot for dot in dots if dot.is_finite]
    best = not_dominated(shown, infos) if front else []
    looks = curves.looks(trials.methods, list(dict.fromkeys(dot.method for dot in shown)))
    several = frozenset(name for name in looks if sum(dot.method == name for dot in shown) > 1)
    for listed in (several, frozenset(looks)):
        with style():
            figure = Figure(figsize=size, layout="constrained")
            (axes,) = curves.panels(figure, 1)
            axes.yaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10]))
            for dot in shown:
                filled = not front or dot in best
                axes.plot(dot.x.middle, dot.y.middle, zorder=3.0, **_marker(trials, looks, dot.method, filled=filled))
            _set_limits(axes, shown, infos, log=log)
            lines = _draw_lines(axes, shown, best, looks)
            handles = _handles(trials, shown, listed, looks, front=front)
            curves.finish(figure, handles, _note(dots, MEANING[bars]))
            if write(axes, _labels(trials, shown, listed, several), lines):
                break  # else, where labels cover each other, all methods go to the legend
    return figure


def _dot(point: Trials, name: str, infos: tuple[MetricInfo, MetricInfo], bars: str) -> Dot:
    columns = [point.column(info.name, name) for info in infos]
    both: Array = ~np.isnan(np.stack(columns)).any(axis=0)
    x, y = (_spread(from_best(column[both], info.direction), bars) for column, info in zip(columns, infos, strict=True))
    return Dot(name, point, x, y, int(both.sum()), len(both))


def _spread(values: Array, bars: str) -> Spread:
    """Middle half about the median, or one standard error about the mean."""
    if bars == "quartiles":
        return Spread(*(float(quantile(values, share)) for share in (0.25, 0.5, 0.75)))
    with np.errstate(invalid="ignore", over="ignore"):
        mean = float(values.mean()) if len(values) else np.nan
    error = standard_error(values)
    return Spread(mean - error, mean, mean + error)


def _marker(trials: Trials, looks: Mapping[str, Look], name: str, *, filled: bool) -> dict[str, Any]:
    """How the dots of a method look; one that is dominated is hollow."""
    color, marker = looks[name].color, MARKERS[trials.methods.index(name) % len(MARKERS)]
    return {"ls": "", "marker": marker, "ms": 4.2, "mew": 1.0, "mec": color, "mfc": color if filled else "white"}


def _set_limits(axes: Axes, shown: Sequence[Dot], infos: tuple[MetricInfo, MetricInfo], *, log: bool) -> None:
    """Choose scales and limits that hold all dots and the finite ends of their bars, with room for labels."""
    ends = np.array([[[*dot.x], [*dot.y]] for dot in shown])  # (dots, 2, 3)
    finite = np.where(np.isfinite(ends), ends, ends[:, :, 1:2])
    axes.update_datalim(np.concatenate([finite.min(axis=2), finite.max(axis=2)]))
    axes.margins(0.14)
    for place, info in enumerate(infos):
        unit = "" if info.direction == "one" else info.unit
        positive = bool((finite[:, place] > 0).all())
        axes.autoscale_view()
        if log and positive:
            curves.make_logarithmic(axes, horizontal=place == 0)
        remark = "\n(linear: some <= 0)" if log and not positive else ""
        label = with_unit(literal(name_from_best(info)), unit) + remark
        if place:
            axes.set_ylabel(label)
        else:
            axes.set_xlabel(label)
    axes.autoscale_view()
    axes.autoscale(False)


def _draw_lines(axes: Axes, shown: Sequence[Dot], best: Sequence[Dot], looks: Mapping[str, Look]) -> list[Line]:
    """Draw bars, the lines through the dots of a method and the steps from one of the best dots to the next."""
    lines: list[tuple[Array, Array, dict[str, Any]]] = []
    for dot in shown:
        bar: dict[str, Any] = {"color": curves.paler(looks[dot.method].color, 0.35), "lw": 1.0, "zorder": 2.4}
        x, y = (curves.drawable(np.array([each.low, each.high])) for each in (dot.x, dot.y))
        lines += [(x, np.full(2, dot.y.middle), bar), (np.full(2, dot.x.middle), y, bar)]
    for name, look in looks.items():
        mine = [(dot.x.middle, dot.y.middle) for dot in shown if dot.method == name]
        lines.append((*np.array(mine).T, {"color": curves.paler(look.color, 0.5), "lw": 0.9, "zorder": 2.3}))
    if best:
        corners = np.array([(dot.x.middle, dot.y.middle) for dot in best])
        lines.append((np.repeat(corners[:, 0], 2)[1:], np.repeat(corners[:, 1], 2)[:-1], FRONT))
    for x, y, how in lines:
        axes.plot(x, y, **how)
    return [(x, y) for x, y, _ in lines if np.isfinite(np.stack([x, y])).all()]


def _handles(
    trials: Trials, shown: Sequence[Dot], listed: frozenset[str], looks: Mapping[str, Look], *, front: bool
) -> list[tuple[str, Artist]]:
    """Legend entries of methods that have no labels of their own, and of what is not dominated."""
    found: list[tuple[str, Artist]] = []
    for name in (name for name in looks if name in listed):
        mine = [dot for dot in shown if dot.method == name]
        text = trials.labels.get(name, name) + (_count(mine[0], shown) if len(mine) == 1 else "")
        found.append((text, Line2D([], [], **_marker(trials, looks, name, filled=True))))
    if front:
        filled = {**FRONT, "marker": "o", "ms": 4.2, "mec": REFERENCE, "mfc": REFERENCE}
        found.append(("not dominated", Line2D([], [], **filled)))
    return found


def _labels(trials: Trials, shown: Sequence[Dot], listed: frozenset[str], several: frozenset[str]) -> list[Label]:
    """Label a dot with its method, one of several of a method with its point of the sweep."""
    found = []
    for dot in shown:
        if dot.method in several:
            text = literal(short(dot.point))
        elif dot.method not in listed:
            text = trials.labels.get(dot.method, dot.method)
        else:
            continue
        found.append(Label(dot.x.middle, dot.y.middle, text + _count(dot, shown)))
    return found


def _count(dot: Dot, shown: Sequence[Dot]) -> str:
    """Say how many runs a dot has, where it is not the same everywhere."""
    return "" if _runs(shown) else f", n={dot.n}" if dot.n == dot.n_runs else f", {dot.n}/{dot.n_runs}"


def _runs(dots: Sequence[Dot]) -> int:
    """Return the number of runs if it is the same everywhere and none is missing, else 0."""
    counts = {n for dot in dots for n in (dot.n, dot.n_runs)}
    return counts.pop() if len(counts) == 1 else 0


def _note(dots: Sequence[Dot], meaning: str) -> str:
    """Say what dots and bars are, of how many runs, and which methods have no dot."""
    n = _runs([dot for dot in dots if dot.is_finite])
    names = dict.fromkeys(dot.method for dot in dots if not dot.is_finite)
    text = "1 run" if n == 1 else f"{meaning}, {n} runs" if n else meaning
    return text + (f"; left out: {', '.join(names)}" if names else "")
