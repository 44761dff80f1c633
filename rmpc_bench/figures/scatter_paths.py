"""Paths of one run in the plane of two signals, with time marks and limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import drawable, few_ticks, stacked_panels
from rmpc_bench.figures.curves import limits_of
from rmpc_bench.figures.labels import at_point, joined, name_of, sentence, short_title, unit_of
from rmpc_bench.figures.legend import Handle, Label, finish, write
from rmpc_bench.figures.palette import BAND, DIM, GROUND, PRINT, grouped, line_styles, sample
from rmpc_bench.figures.quantities import Quantity, issue_of, methods_with, n_rows, quantities
from rmpc_bench.figures.recorded_runs import OUTPUT, TimeWindow, bursts_of, find_run, shown_part, signal_of, window_of
from rmpc_bench.figures.style import new_figure, style
from rmpc_bench.types import Array, DesignError
from rmpc_bench.types.errors import Issue
from rmpc_bench.types.result_layout import ROUNDING, ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

MOST_MARKS = 50  # time marks along a path
TOO_CLOSE = f"more than {MOST_MARKS} time marks overlap: choose a longer time between two marks"
MARK: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.2, "mew": 0.7, "mfc": GROUND, "mec": DIM, "zorder": 2.1}


class SignalPlane(NamedTuple):
    """The keys of a path."""

    x: str
    y: str
    run: int
    marks: float
    magnify: float
    start: float | None
    stop: float | None
    order: tuple[str, ...] | None

    def methods(self, layout: ResultLayout) -> list[str]:
        """Methods to show: the named ones, or all that have both signals."""
        having = set(methods_with(layout, self.x)) & set(methods_with(layout, self.y))
        return [name for name in self.order or layout.methods if name in having]

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Yield an issue for a signal or a run that is not recorded, or for marks that overlap."""
        for key, text in (("x", self.x), ("y", self.y)):
            issue = issue_of(layout, text)
            if issue is not None:
                yield Issue(key if issue.key else "", issue.message)
            elif n_rows(layout, [text]) > 1 or text.partition(".")[0] not in layout.signal_names:
                yield Issue(key, f"must be one component of a recorded signal, such as {text.partition('.')[0]}.0")
        yield from layout.require_traces(self.order)
        yield from layout.require_recorded(self.run)
        first, last = self.start or 0.0, layout.end if self.stop is None else min(self.stop, layout.end)
        if self.marks and layout.end and (last - first) / self.marks > MOST_MARKS:
            yield Issue("marks", TOO_CLOSE)
        yield from layout.require_window(self.start, self.stop)


class Path(NamedTuple):
    """Two signals of a method in one run, at the samples that are shown."""

    values: Array  # (samples, 2), with enlarged distances from the reference
    reference: Array | None  # (samples, 2) of two outputs
    failure: str  # status of the run where it failed, else empty


class PathContent(NamedTuple):
    """What a figure of paths shows."""

    keys: SignalPlane
    point: Trials
    title: str
    quantities: tuple[Quantity, Quantity]
    window: TimeWindow
    paths: Mapping[str, Path]

    @property
    def one_unit(self) -> bool:
        """Whether both axes have one scale."""
        return len({unit_of(self.point, f"{each.name}.{each.number}") for each in self.quantities}) == 1

    def height(self, width: float) -> float:
        """Choose the height [in] of a picture of some width [in] by the shape of the paths, within limits."""
        good = [path for path in self.paths.values() if not path.failure] or list(self.paths.values())
        points = np.concatenate([path.values for path in good])
        points = points[np.isfinite(points).all(axis=1)]
        across, up = np.ptp(points, axis=0) if len(points) else (1.0, 1.0)
        ratio = up / across if self.one_unit and across > 0 else 0.8
        return 0.7 + (width - 0.8) * min(1.3, max(0.5, float(ratio)))


def paths_content(keys: SignalPlane, points: Sequence[Trials]) -> PathContent:
    """Read the paths of the first point that is shown."""
    point = points[0]
    layout = layout_of(point)
    methods = keys.methods(layout)
    if not methods:
        raise DesignError(f"no method has both {keys.x} and {keys.y}", "x")
    x, y = quantities(layout, [keys.x, keys.y])
    window = window_of(point, len(point.traces[methods[0]].r) - 1, keys.start, keys.stop)
    title = short_title(point) + (f" (first of {len(points)} points)" if len(points) > 1 else "")
    paths = {name: _path(keys, point, name, (x, y), window) for name in methods}
    return PathContent(keys, point, title, (x, y), window, paths)


def _path(
    keys: SignalPlane, point: Trials, name: str, quantities: tuple[Quantity, Quantity], window: TimeWindow
) -> Path:
    """Read the path of one method."""
    row, failure = find_run(point, name, keys.run)
    traces = point.traces[name]
    signals = [signal_of(traces, each.name, each.number) for each in quantities]
    columns = [shown_part(each[[row]], traces, window)[0] for each in signals if each is not None]
    values, reference = np.stack(columns, axis=1), None
    if all(each.name == OUTPUT for each in quantities):
        numbers = [each.number for each in quantities]
        reference = traces.r[window.slice][:, numbers]
        with np.errstate(over="ignore", invalid="ignore"):
            error = traces.difference(OUTPUT, values, reference, numbers)
            values = values if keys.magnify == 1.0 else reference + keys.magnify * error
    return Path(drawable(values), reference, failure)


def paths_caption(made: PathContent) -> str:
    """Name the run, the marks and the magnification."""
    keys, names = made.keys, joined(name_of(made.point, name) for name in made.paths)
    failed = [f"{name_of(made.point, name)} {path.failure}" for name, path in made.paths.items() if path.failure]
    axes = joined(each.label(made.point) for each in made.quantities)
    return sentence(
        f"Path of {axes} in run {keys.run}{at_point(made.title)} for {names}, {made.window.words}",
        "dashed: reference" if any(path.reference is not None for path in made.paths.values()) else "",
        f"lines show $r + {keys.magnify:g}\\,(y - r)$" if keys.magnify != 1.0 else "",
        f"marks every {keys.marks:g} {made.window.unit or 'samples'}" if keys.marks else "",
        f"failed: {joined(failed)}" if failed else "",
    )


def draw_paths(made: PathContent, size: tuple[float, float]) -> MplFigure:
    """Draw all paths in a panel."""
    styles = line_styles(made.point.all_methods, list(made.paths))
    with style():
        figure = new_figure(size)
        (axes,) = stacked_panels(figure, 1)
        few_ticks(axes)
        handles: list[Handle] = [(name_of(made.point, n), sample(**styles[n].line())) for n in made.paths]
        handles += _draw_reference(axes, made)
        for name in sorted(made.paths, key=lambda name: bool(made.paths[name].failure)):
            limits = axes.get_xlim(), axes.get_ylim()
            with grouped(axes, styles[name].gid):
                look, values = styles[name].line(), made.paths[name].values
                axes.plot(*values.T, **look)
                dots = values[marks_of(made.window, made.keys.marks)]
                axes.plot(*dots.T, ls="", marker="o", ms=2.2, mew=0.0, color=look["color"], zorder=look["zorder"])
            if made.paths[name].failure and not all(path.failure for path in made.paths.values()):
                # The values of a failed run may be huge and must not shrink the other paths.
                axes.set_xlim(limits[0])
                axes.set_ylim(limits[1])
        axes.margins(0.1)
        handles += _draw_limits(axes, made)
        # An axis of enlarged distances is no axis of the output alone.
        enlarged = "" if made.keys.magnify == 1.0 else f", errors \N{MULTIPLICATION SIGN}{made.keys.magnify:g}"
        x, y = (each.label(made.point) + enlarged for each in made.quantities)
        axes.set(xlabel=x, ylabel=y)
        if made.one_unit:
            axes.set_aspect("equal", adjustable="datalim")
        finish(figure, handles, ", ".join(filter(None, [made.title, f"run {made.keys.run}"])))
        _write_times(axes, made)
    return figure


def _draw_reference(axes: Axes, made: PathContent) -> list[Handle]:
    """Draw the reference of outputs, on a broad band in bursts of the noise; return the legend entries."""
    reference = next(iter(made.paths.values())).reference
    if reference is None:
        return []
    (line,) = axes.plot(*reference.T, color=DIM, linestyle=(0, (4, 2)), linewidth=0.9, zorder=2.0)
    axes.plot(*reference[marks_of(made.window, made.keys.marks)].T, **MARK)
    rows = {name: np.flatnonzero(made.point.traces[name].runs == made.keys.run) for name in made.paths}
    bursts = bursts_of(made.point, rows)
    if bursts is None or not bursts[made.window.slice].any():
        return [("reference", line)]
    inside = np.where(bursts[made.window.slice, None], reference, np.nan)
    (band,) = axes.plot(*inside.T, color=BAND, lw=7.0, solid_capstyle="butt", zorder=1.9)
    return [("reference", line), ("burst", band)]


def _draw_limits(axes: Axes, made: PathContent) -> list[Handle]:
    """Draw the limits of both signals in the controllers, if they are near."""
    found: list[Handle] = []
    for place_of, each in enumerate(made.quantities):
        levels = set.union(*({*limits_of(made.point, name, each)} for name in made.paths))
        low, high = axes.get_ylim() if place_of else axes.get_xlim()
        for level in sorted(levels):
            if 2 * low - high <= level <= 2 * high - low:
                draw = axes.axhline if place_of else axes.axvline
                line = draw(level, color=PRINT["worse"], lw=1.0, ls=(0, (1.2, 1.6)), zorder=2.5)
                found = [("limit", line)]
    return found


def _write_times(axes: Axes, made: PathContent) -> None:
    """Write the times of the marks next to the reference, else to the first path."""
    first = next(iter(made.paths.values()))
    line = first.values if first.reference is None else first.reference
    times = {k: f"{made.window.sample * (made.window.first + k):g}" for k in marks_of(made.window, made.keys.marks)}
    labels = [Label(float(line[k, 0]), float(line[k, 1]), text) for k, text in times.items()]
    drawn = [line, *(path.values for path in made.paths.values())]
    write(axes, labels, [(each[:, 0], each[:, 1]) for each in drawn], color=DIM)


def marks_of(window: TimeWindow, marks: float) -> list[int]:
    """Find the samples of the time marks, from the first shown one; none for distance 0, a DesignError if too close."""
    if not marks:
        return []
    first, last = (end / marks for end in window.limits)
    if last - first > MOST_MARKS:
        raise DesignError(TOO_CLOSE, "marks")
    numbers = range(math.ceil(first - ROUNDING), math.floor(last + ROUNDING) + 1)
    return [round(number * marks / window.sample) - window.first for number in numbers]
