"""Paths of one run in the plane of two signals, with time marks, limits, and sets that the methods report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import STEPS, drawable, few_ticks
from rmpc_bench.figures.burst_bands import bursts_of
from rmpc_bench.figures.captions import joined, place, sentences, span_of
from rmpc_bench.figures.curves import limits_of
from rmpc_bench.figures.direct_labels import Label, write
from rmpc_bench.figures.ellipse_outline import Ellipse, outline
from rmpc_bench.figures.labels import literal, name_of, typeset, unit_of
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import line_styles, paler
from rmpc_bench.figures.method_groups import grouped
from rmpc_bench.figures.palette import BAND, DIM, GROUND, INK, LINE, PRINT
from rmpc_bench.figures.quantities import Quantity, issue_of, methods_with, n_rows, quantities
from rmpc_bench.figures.recorded_runs import OUTPUT, PanelSignal, find_run, last_sample
from rmpc_bench.figures.reported_sets import Tube, tube_of
from rmpc_bench.figures.style import style
from rmpc_bench.figures.sweep_points import short_title
from rmpc_bench.figures.window import TimeWindow, window_of
from rmpc_bench.types import Array, DesignError, Status
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ROUNDING, ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

MOST_MARKS = 50
"""Time marks along a path."""
MOST_ELLIPSES = 12
TOO_CLOSE = f"more than {MOST_MARKS} time marks overlap: choose a longer time between two marks"
MARK: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.2, "mew": 0.7, "mfc": GROUND, "mec": DIM, "zorder": 2.1}
TRUE: dict[str, Any] = {"color": INK, "lw": 0.7, "zorder": 2.6}
STATE: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.0, "mew": 0.6, "mec": INK, "zorder": 2.8}


class SignalPlane(NamedTuple):
    """The keys of a path."""

    x: str
    y: str
    run: int
    marks: float
    magnify: float
    sets: bool
    level: float
    start: float | None
    stop: float | None
    order: tuple[str, ...] | None

    def methods(self, layout: ResultLayout) -> list[str]:
        """Methods to show: the named ones, or all that have both signals."""
        texts = (self.x, self.y, "tube") if self.sets else (self.x, self.y)
        having = set.intersection(*(set(methods_with(layout, text)) for text in texts))
        return [name for name in self.order or layout.methods if name in having]

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Yield an issue for a signal or a run that is not recorded, or for marks that overlap."""
        for key, text in (("x", self.x), ("y", self.y)):
            issue = issue_of(layout, text)
            if issue is not None:
                yield Issue(key if issue.key else "", issue.message)
            elif n_rows(layout, [text]) > 1 or text.partition(".")[0] not in layout.signal_names:
                yield Issue(key, f"must be one component of a recorded signal, such as {text.partition('.')[0]}.0")
        if self.sets and {self.x.partition(".")[0], self.y.partition(".")[0]} != {"x"}:
            yield Issue("sets", "are sets of the state: x and y must be two of its components, such as x.0 and x.1")
        elif self.sets and (issue := issue_of(layout, "tube")) is not None:
            yield Issue("sets", issue.message)
        yield from layout.require_traces(self.order)
        yield from layout.require_recorded(self.run)
        first, last = self.start or 0.0, layout.end if self.stop is None else min(self.stop, layout.end)
        if self.marks and layout.end and (last - first) / self.marks > MOST_MARKS:
            yield Issue("marks", TOO_CLOSE)
        yield from layout.require_window(self.start, self.stop)


class Path(NamedTuple):
    """Two signals of a method in one run, at the samples that are shown."""

    values: Array
    """(samples, 2), with enlarged distances from the reference."""
    reference: Array | None
    """(samples, 2) of two outputs."""
    status: str
    tube: Tube | None

    @property
    def failed(self) -> bool:
        """Whether the run failed."""
        return self.status != Status.OK.word


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
        good = [path for path in self.paths.values() if not path.failed] or list(self.paths.values())
        points = np.concatenate([path.values for path in good])
        points = points[np.isfinite(points).all(axis=1)]
        across, up = np.ptp(points, axis=0) if len(points) else (1.0, 1.0)
        ratio = up / across if self.one_unit and across > 0 else 0.8
        columns = len(self.paths) if self.keys.sets else 1
        return 0.7 + (width - 0.8) / columns * min(1.3, max(0.5, float(ratio)))


def paths_content(keys: SignalPlane, points: Sequence[Trials]) -> PathContent:
    """Read the paths of the first point that is shown."""
    point = points[0]
    layout = layout_of(point)
    methods = keys.methods(layout)
    if not methods:
        raise DesignError(f"no method has both {keys.x} and {keys.y}", "x")
    x, y = quantities(layout, [keys.x, keys.y])
    window = window_of(point, last_sample(point, methods[0]), keys.start, keys.stop)
    title = short_title(point) + (f" (first of {len(points)} points)" if len(points) > 1 else "")
    return PathContent(
        keys, point, title, (x, y), window, {name: _path(keys, point, name, (x, y), window) for name in methods}
    )


def _path(
    keys: SignalPlane, point: Trials, name: str, quantities: tuple[Quantity, Quantity], window: TimeWindow
) -> Path:
    """Read the path of one method."""
    row, status = find_run(point, name, keys.run)
    traces = point.traces[name]
    columns = [
        PanelSignal(each.name, each.number, "").curves(traces, window, np.array([row]))[1][0] for each in quantities
    ]
    values, reference = np.stack(columns, axis=1), None
    if all(each.name == OUTPUT for each in quantities):
        reference = traces.r[window.slice][:, [each.number for each in quantities]]
        with np.errstate(over="ignore", invalid="ignore"):
            values = values if keys.magnify == 1.0 else reference + keys.magnify * (values - reference)
    components = [each.number for each in quantities]
    tube = tube_of(point, name, keys.run, components, window, keys.level) if keys.sets else None
    return Path(drawable(values), reference, status, tube)


def paths_caption(made: PathContent) -> str:
    """Name the run, the marks and the magnification."""
    keys, names = made.keys, joined(name_of(made.point, name) for name in made.paths)
    failed = [f"{name_of(made.point, name)} {path.status}" for name, path in made.paths.items() if path.failed]
    axes = joined(each.label(made.point) for each in made.quantities)
    has_reference = any(path.reference is not None for path in made.paths.values())
    return sentences(
        f"Path of {axes} in run {keys.run} for {names}, {span_of(made.window)}"
        + ("; dashed: reference" if has_reference else ""),
        place(made.point, made.title),
        f"Lines show $r + {keys.magnify:g}\\,(y - r)$" if keys.magnify != 1.0 else "",
        f"Marks every {keys.marks:g} {'s' if made.window.in_seconds else 'samples'}" if keys.marks else "",
        f"Black: true state; ellipses: sets about the estimate, M or {100 * keys.level:g} % of P; hollow: outside"
        if keys.sets
        else "",
        f"Failed: {joined(failed)}" if failed else "",
    )


def draw_paths(made: PathContent, size: tuple[float, float]) -> MplFigure:
    """Draw all paths in a panel, or with their sets in a panel per method."""
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator

    styles = line_styles(made.point.all_methods, list(made.paths))
    groups = [[name] for name in made.paths] if made.keys.sets else [list(made.paths)]
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels: list[Axes] = list(figure.subplots(1, len(groups), sharex=True, sharey=True, squeeze=False)[0])
        handles: list[Handle] = []
        for axes, names in zip(panels, groups, strict=True):
            axes.grid(color=LINE, linewidth=0.4)
            axes.set_axisbelow(True)
            axes.xaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
            few_ticks(axes)
            handles = _draw_reference(axes, made)
            for name in sorted(names, key=lambda name: made.paths[name].failed):
                limits = axes.get_xlim(), axes.get_ylim()
                with grouped(axes, styles[name].gid):
                    _draw_path(axes, made, name, styles[name].line())
                if made.paths[name].failed and not all(path.failed for path in made.paths.values()):
                    # The values of a failed run may be huge and must not shrink the other paths.
                    axes.set_xlim(limits[0])
                    axes.set_ylim(limits[1])
            if made.keys.sets:
                axes.set_title(typeset(name_of(made.point, names[0])), loc="left", weight="bold").set_gid(
                    styles[names[0]].gid
                )
            axes.margins(0.1)
            handles += _draw_limits(axes, made, names)
            axes.set_xlabel(_label(made, 0))
            if made.one_unit:
                axes.set_aspect("equal", adjustable="box" if made.keys.sets else "datalim")
        panels[0].set_ylabel(_label(made, 1))
        own = [(name_of(made.point, name), Line2D([], [], **styles[name].line())) for name in made.paths]
        note = ", ".join(filter(None, [made.title, f"run {made.keys.run}"]))
        finish(
            figure,
            [*([] if made.keys.sets else own), *handles, *_set_keys(made)],
            literal(note),
            columns=made.keys.sets,
        )
        _write_times(panels[0], made)
    return figure


def _draw_path(axes: Axes, made: PathContent, name: str, look: dict[str, Any]) -> None:
    """Draw a path with its marks, or an estimate with the sets about it."""
    path = made.paths[name]
    if path.tube is None:
        axes.plot(*path.values.T, **look)
        dots = path.values[marks_of(made.window, made.keys.marks)]
        axes.plot(*dots.T, ls="", marker="o", ms=2.2, mew=0.0, color=look["color"], zorder=look["zorder"])
        return
    axes.plot(*path.values.T, **TRUE)
    axes.plot(*drawable(path.tube.x_hat).T, color=look["color"], lw=0.9, zorder=2.7)
    every = -(-len(path.tube.x) // MOST_ELLIPSES)
    some = path.tube._replace(x=path.tube.x[::every], x_hat=path.tube.x_hat[::every], S=path.tube.S[::every])
    for centre, S in zip(some.x_hat, some.S, strict=True):
        points = outline(Ellipse(centre, S), 1.0)
        if points is not None:
            x, y = drawable(points[::4]).T
            axes.fill(x, y, facecolor=paler(look["color"], 0.8), edgecolor=look["color"], lw=0.8, zorder=2.1)
    outside = some.outside()
    axes.plot(*drawable(some.x[~outside]).T, mfc=INK, **STATE)
    axes.plot(*drawable(some.x[outside]).T, mfc=GROUND, **STATE)
    axes.plot(*drawable(some.x_hat).T, ls="", marker="+", ms=4, mew=0.9, color=look["color"], zorder=2.75)


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


def _draw_limits(axes: Axes, made: PathContent, names: Sequence[str]) -> list[Handle]:
    """Draw the limits of both signals in the controllers of a panel, if they are near."""
    found: list[Handle] = []
    for place_of, each in enumerate(made.quantities):
        levels = set.union(*({*limits_of(made.point, name, each)} for name in names))
        low, high = axes.get_ylim() if place_of else axes.get_xlim()
        for level in sorted(levels):
            if 2 * low - high <= level <= 2 * high - low:
                draw = axes.axhline if place_of else axes.axvline
                line = draw(level, color=PRINT["worse"], lw=1.0, ls=(0, (1.2, 1.6)), zorder=2.5)
                found = [("limit", line)]
    return found


def _set_keys(made: PathContent) -> list[Handle]:
    """Explain states and sets."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if not made.keys.sets:
        return []
    kinds = {path.tube.gaussian for path in made.paths.values() if path.tube is not None}
    texts = {False: "set $M$", True: f"{100 * made.keys.level:g} % of $P$"}
    areas = [texts[kind] for kind in sorted(kinds)]
    return [
        ("true state", Line2D([], [], **{**STATE, "ls": "-"}, mfc=INK, color=INK, lw=0.7)),
        ("estimate", Line2D([], [], color=DIM, lw=0.9, marker="+", ms=4)),
        (" or ".join(areas), Patch(facecolor=paler(DIM, 0.8), edgecolor=DIM)),
        ("outside", Line2D([], [], mfc=GROUND, **STATE)),
    ]


def _label(made: PathContent, which: int) -> str:
    """Label an axis; that of enlarged distances is no axis of the output alone."""
    label = made.quantities[which].label(made.point)
    magnify = made.keys.magnify
    return label if magnify == 1.0 else f"{label}, errors \N{MULTIPLICATION SIGN}{magnify:g}"


def _write_times(axes: Axes, made: PathContent) -> None:
    """Write the times of the marks next to the reference, else to the first path."""
    first = next(iter(made.paths.values()))
    line = first.values if first.reference is None else first.reference
    labels = [
        Label(float(line[k, 0]), float(line[k, 1]), f"{made.window.sample * (made.window.first + k):g}")
        for k in marks_of(made.window, made.keys.marks)
    ]
    drawn = [line, *(path.values for path in made.paths.values())]
    write(axes, labels, [(each[:, 0], each[:, 1]) for each in drawn], color=DIM)


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
