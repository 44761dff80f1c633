"""Path of one run in the plane of two outputs, with time marks (belda2017, Fig. 1)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures import burst_bands
from rmpc_bench.figures.axes import drawable, few_ticks, stacked_panels
from rmpc_bench.figures.captions import joined, label_of, place, sentences, span_of
from rmpc_bench.figures.direct_labels import Label, write
from rmpc_bench.figures.labels import component_label, unit_of
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import legend_sample, line_styles
from rmpc_bench.figures.recorded_runs import find_run, last_sample
from rmpc_bench.figures.style import GREY, REFERENCE, style
from rmpc_bench.figures.sweep_points import point_at
from rmpc_bench.figures.window import TimeWindow, window_of
from rmpc_bench.types import Array, DesignError, NonNegative, Positive, Status
from rmpc_bench.types.figure import Index, OnePointFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ROUNDING, ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.lines import Line2D

    from rmpc_bench.analysis.trials import Trials

MOST_MARKS = 50
"""Time marks along a path."""
TOO_CLOSE = f"more than {MOST_MARKS} time marks overlap: choose a longer time between two marks"
DASHED = (0, (4, 2))
BURST_WIDTH = 7.0
"""Width of the band under the reference in a burst [points]."""
MARK: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.2, "mew": 0.7, "mfc": "white", "mec": REFERENCE, "zorder": 2.1}


@dataclass(frozen=True, kw_only=True)
class Plane(OnePointFigure):
    """Path of one run in the plane of two outputs, a line for every method; the reference is dashed.

    Both axes have one scale if both outputs have one unit.  During a burst of the noise the reference lies on a broad
    grey band.

    Parameters
    ----------
    components : the two outputs (counted from 0), the horizontal one first
    run : index of the run, which must be recorded with the signal y
    marks : time between two marks on the paths [s], with numbers next to the reference; 0 for none
    magnify : factor by which the control errors are enlarged, r + magnify (y - r)
    from_ : first time to show [s]
    to : last time to show [s]
    height : height of the whole picture [in]; if not given, that of the paths within limits
    order : methods to show, later ones above earlier ones; all that have recorded runs if not given
    """

    needs_runs: ClassVar[bool] = True

    components: tuple[Index, Index] = (0, 1)
    run: Index = 0
    marks: NonNegative = 1.0
    magnify: Positive = 1.0
    from_: NonNegative | None = None
    to: NonNegative | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: a recorded run with two outputs, and time marks that do not overlap."""
        yield from super().check(layout)
        yield from layout.require_signals("y")
        yield from layout.require_traces(self.order)
        yield from layout.require_recorded(self.run)
        shapes = [signals["y"] for signals in layout.signals.values() if signals.get("y")]
        n = min((shape[0] for shape in shapes if shape), default=None)
        yield from layout.require_component("output", self.components, n, "components")
        yield from layout.require_pair("output", self.components, "components")
        first, last = self.from_ or 0.0, layout.end if self.to is None else min(self.to, layout.end)
        if self.marks and layout.end and (last - first) / self.marks > MOST_MARKS:
            yield Issue("marks", TOO_CLOSE)
        yield from layout.require_window(self.from_, self.to)

    def caption(self, results: Trials) -> str:
        """Name the run, the marks and the magnification, and state the largest distances; see `Figure.caption`."""
        point, title = point_at(results, self.at)
        methods = self.order or list(layout_of(point).signals)
        window = window_of(point, last_sample(point, methods[0]), self.from_, self.to)
        paths = {name: path_of(point, name, self.run, self.components, window) for name in methods}
        outputs = joined(component_label(point, "y", i, str(i)) for i in self.components)
        unit = {unit_of(point, f"y.{component}") for component in self.components}
        largest = [
            f"{label_of(point, name)} {np.hypot(*(path.y - path.r).T).max():.3g} {unit.copy().pop()}".rstrip()
            for name, path in paths.items()
            if not path.failed and len(unit) == 1
        ]
        failed = [f"{label_of(point, name)} {path.status}" for name, path in paths.items() if path.failed]
        enlarged = (
            f"Control errors are enlarged {self.magnify:g} times: the lines show $r + {self.magnify:g}\\,(y - r)$"
        )
        every = f"{self.marks:g} {'s' if window.in_seconds else 'samples'}"
        return sentences(
            f"Path of the outputs {outputs} in run {self.run} for {joined(label_of(point, name) for name in methods)}, "
            f"{span_of(window)}; the grey dashed line is the reference",
            place(point, title),
            enlarged if self.magnify != 1.0 else "",
            f"Circles mark every {every} on the reference, dots the same times on the paths" if self.marks else "",
            f"Largest distance from the reference: {joined(largest)}" if largest else "",
            f"Failed: {joined(failed)}" if failed else "",
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw the paths of one run at one point; see `Figure.draw`."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods = self.order or list(layout.signals)
        window = window_of(point, last_sample(point, methods[0]), self.from_, self.to)
        paths = {name: path_of(point, name, self.run, self.components, window) for name in methods}
        one_unit = len({unit_of(point, f"y.{component}") for component in self.components}) == 1
        size = self.size(height_of(paths, self.magnify, self.width, equal=one_unit))
        return _draw(self, point, title, paths, window, size, equal=one_unit)


class OutputPath(NamedTuple):
    """Two outputs of a method in one run, at the samples that are shown."""

    y: Array
    """(samples, 2)."""
    r: Array
    """(samples, 2) reference."""
    status: str

    @property
    def failed(self) -> bool:
        """Whether the run failed."""
        return self.status != Status.OK.word

    def magnified(self, factor: float) -> Array:
        """Return the path with enlarged distances from the reference."""
        # Values of a run that diverges may overflow; they are limited before they are drawn.
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(self.y if factor == 1.0 else self.r + factor * (self.y - self.r))


def path_of(point: Trials, name: str, run: int, components: tuple[int, int], window: TimeWindow) -> OutputPath:
    """Read the path of one method."""
    row, status = find_run(point, name, run)
    traces, chosen = point.traces[name], list(components)
    return OutputPath(traces.signals["y"][row][window.slice][:, chosen], traces.r[window.slice][:, chosen], status)


def height_of(paths: Mapping[str, OutputPath], magnify: float, width: float, *, equal: bool) -> float:
    """Choose the height [in] of a picture of some width [in] by the shape of the paths, within limits.

    Distances from the reference are magnified.
    """
    good = [path for path in paths.values() if not path.failed] or list(paths.values())
    points = np.concatenate([each for path in good for each in (path.r, path.magnified(magnify))])
    across, up = np.ptp(points[np.isfinite(points).all(axis=1)], axis=0) if len(points) else (1.0, 1.0)
    ratio = up / across if equal and across > 0 else 0.8
    return 0.7 + (width - 0.8) * min(1.3, max(0.5, float(ratio)))


def marks_of(window: TimeWindow, marks: float) -> list[int]:
    """Find the samples of the time marks, counted from the first one that is shown; none if their distance is 0.

    Raises a DesignError when they are too close.
    """
    if not marks:
        return []
    first, last = (end / marks for end in window.limits)
    if last - first > MOST_MARKS:
        raise DesignError(TOO_CLOSE, "marks")
    numbers = range(math.ceil(first - ROUNDING), math.floor(last + ROUNDING) + 1)
    return [round(number * marks / window.sample) - window.first for number in numbers]


def _draw(
    keys: Plane,
    point: Trials,
    title: str,
    paths: Mapping[str, OutputPath],
    window: TimeWindow,
    size: tuple[float, float],
    *,
    equal: bool,
) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure

    styles = line_styles(point.all_methods, list(paths))
    reference = next(iter(paths.values())).r
    places = marks_of(window, keys.marks)
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        (axes,) = stacked_panels(figure, 1)
        few_ticks(axes)
        line, burst = _draw_reference(axes, point, paths, keys.run, window)
        for name in sorted(paths, key=lambda name: paths[name].failed):
            limits, look = (axes.get_xlim(), axes.get_ylim()), styles[name]
            y = drawable(paths[name].magnified(keys.magnify))
            axes.plot(*y.T, **look.line())
            dots: dict[str, Any] = {
                "marker": "o",
                "ms": 2.2,
                "mew": 0.0,
                "color": look.color,
                "zorder": look.zorder,
                "gid": look.gid,
            }
            axes.plot(*y[places].T, ls="", **dots)
            if paths[name].failed and not all(path.failed for path in paths.values()):
                # The values of a failed run may be huge and must not shrink the other paths.
                axes.set_xlim(limits[0])
                axes.set_ylim(limits[1])
        axes.plot(*reference[places].T, **MARK)
        axes.margins(0.1)
        axes.set_xlabel(_label(point, keys, keys.components[0]))
        axes.set_ylabel(_label(point, keys, keys.components[1]))
        if equal:
            axes.set_aspect("equal", adjustable="datalim")
        handles: list[Handle] = [(point.labels.get(name, name), legend_sample(styles[name])) for name in paths]
        note = "\n".join(filter(None, [title, _note(keys, paths, window)]))
        finish(figure, [*handles, ("reference", line), *burst], note)
        drawn = [reference, *(path.magnified(keys.magnify) for path in paths.values())]
        times = {k: f"{window.sample * (window.first + k):g}" for k in places}
        numbers = [Label(float(reference[k, 0]), float(reference[k, 1]), text) for k, text in times.items()]
        write(axes, numbers, [(each[:, 0], each[:, 1]) for each in drawn], color=REFERENCE)
    return figure


def _label(point: Trials, keys: Plane, component: int) -> str:
    """Label an axis; that of enlarged errors is no axis of the output alone."""
    label = component_label(point, "y", component, str(component))
    return label if keys.magnify == 1.0 else f"{label}, errors \N{MULTIPLICATION SIGN}{keys.magnify:g}"


def _draw_reference(
    axes: Axes, point: Trials, paths: Mapping[str, OutputPath], run: int, window: TimeWindow
) -> tuple[Line2D, list[Handle]]:
    """Draw the reference, on a broad band in bursts of the noise; return its line and the legend entry of the band."""
    reference = next(iter(paths.values())).r
    rows = {name: np.flatnonzero(point.traces[name].runs == run) for name in paths}
    bursts = burst_bands.bursts_of(point, rows)
    keys: list[Handle] = []
    if bursts is not None and bursts[window.slice].any():
        inside = np.where(bursts[window.slice, None], reference, np.nan)
        (band,) = axes.plot(*inside.T, color=GREY, lw=BURST_WIDTH, solid_capstyle="butt", zorder=1.9)
        keys = [("burst", band)]
    (line,) = axes.plot(*reference.T, color=REFERENCE, linestyle=DASHED, linewidth=0.9, zorder=2.0)
    return line, keys


def _note(keys: Plane, paths: Mapping[str, OutputPath], window: TimeWindow) -> str:
    """Name the run, explain the marks, and name the methods that failed."""
    parts = [f"run {keys.run}"]
    if keys.marks:
        parts.append(f"marks every {keys.marks:g} {'s' if window.in_seconds else 'samples'}")
    return ", ".join([*parts, *(f"{name} {path.status}" for name, path in paths.items() if path.failed)])
