"""Tubes: one run among the sets that the methods report for its state (ma2025, Figs. 1 to 3)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Gt, Len, Lt

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import drawable, few_ticks, stacked_panels
from rmpc_bench.figures.captions import joined, label_of, place, sentences, span_of
from rmpc_bench.figures.ellipse_outline import Ellipse, outline
from rmpc_bench.figures.labels import POINTS_PER_INCH, component_label, typeset, wrapped
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import line_styles, paler
from rmpc_bench.figures.method_groups import grouped
from rmpc_bench.figures.recorded_runs import last_sample
from rmpc_bench.figures.reported_sets import EDGE, Tube, reported_set, tube_of
from rmpc_bench.figures.style import BLACK, FONT_SIZE, REFERENCE, WHITE, style
from rmpc_bench.figures.sweep_points import MOST_PANELS, point_at
from rmpc_bench.figures.window import TimeWindow, window_of
from rmpc_bench.types import Array, Count, NonNegative, Status
from rmpc_bench.types.figure import Index, OnePointFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

OneOrTwo = Annotated[tuple[Index, ...], Len(1, 2)]
Level = Annotated[float, Gt(0), Lt(1)]
NO_SET = "no method reports a set M or a covariance P"
MOST_ELLIPSES = 12
"""Ellipses in a panel by default."""
EDGES: dict[bool, dict[str, Any]] = {False: {"ls": "-", "lw": 0.8}, True: {"ls": (0, (3, 1.5)), "lw": 0.8}}
"""Lines around a set, and around the ellipsoid of a covariance."""
FILL = 0.75
"""Share of white in the inside of a set."""
TRUE_STATE: dict[str, Any] = {"color": BLACK, "lw": 0.7, "zorder": 2.6}
INSIDE: dict[str, Any] = {"ls": "", "marker": "o", "ms": 2.6, "mew": 0.6, "mfc": BLACK, "mec": BLACK, "zorder": 2.8}
OUTSIDE: dict[str, Any] = {**INSIDE, "ms": 3.2, "mfc": WHITE}


@dataclass(frozen=True, kw_only=True)
class Tubes(OnePointFigure):
    """One run among the sets that the methods report for its state, one panel per method, all of one scale.

    A set is the ellipsoid about the estimate whose shape is the reported set M; a method without M has the confidence
    ellipsoid of its reported covariance P at the level (dashed).  If there are more states than are shown, it is the
    projection of the ellipsoid.  A true state outside of its projected set is hollow.

    Parameters
    ----------
    over : plane shows both states and some ellipses; time shows every state with the band from its smallest to its
        largest value in the set, which is easier to read
    run : index of the run, which must be recorded with the signals x and x_hat
    components : the states (counted from 0), the horizontal one first; over time there may be one
    from_ : first time to show [s]
    to : last time to show [s]
    every : samples from one ellipse of a plane to the next; if not given, so many that at most 12 are drawn
    level : of the ellipsoid of P, such as 95%
    height : height of the whole picture [in]; if not given 0.8 and 1.6 for every plane or 1.2 for every band; legend
        and title add to it if they need more than a line
    order : methods to show, from top to bottom; all that are recorded and have M or P if not given
    """

    needs_runs: ClassVar[bool] = True

    over: Literal["plane", "time"] = "plane"
    run: Index = 0
    components: OneOrTwo = (0, 1)
    from_: NonNegative | None = None
    to: NonNegative | None = None
    every: Count | None = None
    level: Level = 0.95

    @property
    def panels_per_method(self) -> int:
        """Panels that a method has."""
        return 1 if self.over == "plane" else len(self.components)

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: a recorded run, methods that report a set of its states, panels that fit."""
        yield from super().check(layout)
        yield from layout.require_signals("x", "x_hat")
        if not {"x", "x_hat"} <= set(layout.signal_names):
            return
        sizes = _sizes(layout)
        if not sizes:
            yield Issue("", NO_SET)
            return
        for name in self.order or ():
            if name in layout.methods and name not in sizes:
                yield Issue("order", f"'{name}' reports neither a set M nor a covariance P")
        yield from layout.require_recorded(self.run)
        shown = [name for name in self.order or sizes if name in sizes]
        for name in shown:
            x = layout.signals.get(name, {}).get("x")
            if x is not None and x[0] != sizes[name]:
                message = f"x_hat of '{name}' has {sizes[name]} components and x of the plant {x[0]}"
                yield Issue("order" if self.order else "", f"{message}: leave the method out with `order`")
        n = min((sizes[name] for name in shown), default=None)
        yield from layout.require_component("state", self.components, n, "components")
        n_different = 2 if self.over == "plane" else len(self.components)
        yield from layout.require_pair("state", self.components, "components", n_different)
        advice = "name fewer methods or states"
        yield from layout.require_at_most(MOST_PANELS, len(shown) * self.panels_per_method, "panels", "order", advice)
        yield from layout.require_window(self.from_, self.to)

    def caption(self, results: Trials) -> str:
        """Define sets and marks, and count the states outside; see `Figure.caption`."""
        point, title = point_at(results, self.at)
        methods = self.order or list(_sizes(layout_of(point)))
        window = window_of(point, last_sample(point, methods[0]), self.from_, self.to)
        tubes = {name: tube_of(point, name, self.run, self.components, window, self.level) for name in methods}
        sets = [
            f"{label_of(point, name)}: {f'{100 * self.level:g} % of $P$' if tube.gaussian else 'set $M$'}"
            for name, tube in tubes.items()
        ]
        outside = [
            f"{label_of(point, name)} {int(tube.outside().sum())} of {len(tube.x)}" for name, tube in tubes.items()
        ]
        states = joined(component_label(point, "x", i, str(i)) for i in self.components)
        what = "ellipses of some samples" if self.over == "plane" else "bands from the smallest to the largest value"
        return sentences(
            f"State {states} (black) of run {self.run} and the sets that the methods report for it, {span_of(window)}: "
            f"{what} in the set about the estimate (coloured line)",
            place(point, title),
            f"Sets: {'; '.join(sets)}",
            "Hollow circles are true states outside of the projection of their set",
            f"States outside, at all samples of the window: {'; '.join(outside)}",
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw one run at one point; see `Figure.draw`."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods = self.order or list(_sizes(layout))
        window = window_of(point, last_sample(point, methods[0]), self.from_, self.to)
        tubes = {name: tube_of(point, name, self.run, self.components, window, self.level) for name in methods}
        n_panels = len(methods) * self.panels_per_method
        size = self.size(0.8 + (1.6 if self.over == "plane" else 1.2) * n_panels)
        n_samples = window.last + 1 - window.first
        return _draw(self, point, title, tubes, window, size, self.every or -(-n_samples // MOST_ELLIPSES))


def _sizes(layout: ResultLayout) -> dict[str, int]:
    """Count the states of the reported sets of recorded methods; without methods that report none."""
    shapes = {name: reported_set(layout.arrays.get(name, {})) for name in layout.methods if name in layout.signals}
    return {name: shape[-1] for name, shape in shapes.items() if shape is not None}


def _draw(
    keys: Tubes,
    point: Trials,
    title: str,
    tubes: dict[str, Tube],
    window: TimeWindow,
    size: tuple[float, float],
    every: int,
) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure

    plane = keys.over == "plane"
    styles = line_styles(point.all_methods, list(tubes))
    n_states = point.traces[next(iter(tubes))].signals["x"].shape[2]
    labels = [component_label(point, "x", i, str(i) if n_states > 1 else "") for i in keys.components]
    rows = [(name, None if plane else place) for place in range(keys.panels_per_method) for name in tubes]
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels, any_outside = stacked_panels(figure, len(rows)), False
        for axes, (name, place) in zip(panels, rows, strict=True):
            few_ticks(axes)
            color = styles[name].color
            with grouped(axes, styles[name].gid):
                if place is None:
                    outside = _draw_plane(axes, tubes[name], every, color)
                else:
                    outside = _draw_band(axes, tubes[name], place, window, color)
                _write_beside(axes, point.labels.get(name, name), color, size[1] / len(rows))
            any_outside |= bool(outside.any())
            axes.set_ylabel(labels[-1 if place is None else place])
        _align(panels, [row[1] for row in rows], [tubes[name].status == Status.OK.word for name, _ in rows])
        panels[-1].set_xlabel(labels[0] if plane else window.label)
        if not plane:
            panels[-1].set_xlim(*window.limits)
        note = _note(tubes, keys.run, window if plane else None, every)
        handles = _handles(list(tubes.values()), keys.level, plane, outside=any_outside)
        finish(figure, handles, "\n".join(filter(None, [title, note])))
    return figure


def _write_beside(axes: Axes, label: str, color: str, height: float) -> None:
    """Write the name of a panel on its right, in the colour of its method, in lines as long as the panel is high."""
    lines = wrapped(typeset(label), 0.7 * height * POINTS_PER_INCH)
    place: dict[str, Any] = {"xy": (1.0, 0.5), "xycoords": "axes fraction", "xytext": (3.0, 0.0)}
    where: dict[str, Any] = {"textcoords": "offset points", "ha": "left", "va": "center", "rotation": 270}
    axes.annotate("\n".join(lines), **place, **where, color=color, fontsize=FONT_SIZE)


def _draw_plane(axes: Axes, tube: Tube, every: int, color: str) -> Array:
    """Draw both trajectories, and the ellipses of some samples with their true states; return which lie outside."""
    axes.plot(*drawable(tube.x).T, **TRUE_STATE)
    axes.plot(*drawable(tube.x_hat).T, color=color, lw=0.9, zorder=2.7)
    some = tube._replace(x=tube.x[::every], x_hat=tube.x_hat[::every], S=tube.S[::every])
    for centre, S in zip(some.x_hat, some.S, strict=True):
        points = outline(Ellipse(centre, S), 1.0)
        if points is not None:
            x, y = drawable(points).T
            axes.fill(x, y, facecolor=paler(color, FILL), alpha=0.5, zorder=2.1, lw=0)
            axes.plot(x, y, color=color, zorder=2.2, **EDGES[tube.gaussian])
    for x, x_hat in zip(drawable(some.x), drawable(some.x_hat), strict=True):
        axes.plot(*np.stack([x, x_hat]).T, color=REFERENCE, lw=0.5, zorder=2.5)
    outside = some.outside()
    _draw_states(axes, some.x[:, 0], some.x[:, 1], outside)
    axes.plot(*drawable(some.x_hat).T, ls="", marker="+", ms=4, mew=0.9, color=color, zorder=2.75)
    return outside


def _draw_band(axes: Axes, tube: Tube, place: int, window: TimeWindow, color: str) -> Array:
    """Draw one state, its estimate and the band of the sets over time; return where the state lies outside."""
    t = window.sample * np.arange(window.first, window.last + 1)
    x, x_hat = tube.x[:, place], tube.x_hat[:, place]
    half = np.sqrt(np.maximum(tube.S[:, place, place], 0.0))
    low, high = drawable(x_hat - half), drawable(x_hat + half)
    axes.fill_between(t, low, high, color=paler(color, FILL), linewidth=0, zorder=2.1)
    for edge in (low, high):
        axes.plot(t, edge, color=color, zorder=2.2, **{**EDGES[tube.gaussian], "lw": 0.5})
    axes.plot(t, drawable(x_hat), color=color, lw=0.9, zorder=2.7)
    axes.plot(t, drawable(x), **TRUE_STATE)
    beyond = np.abs(x - x_hat) > half * (1.0 + EDGE)
    _draw_states(axes, t[beyond], x[beyond], beyond[beyond])
    return np.asarray(beyond)


def _draw_states(axes: Axes, x: Array, y: Array, outside: Array) -> None:
    for which, marker in ((~outside, INSIDE), (outside, OUTSIDE)):
        axes.plot(drawable(x[which]), drawable(y[which]), **marker)


def _align(panels: Sequence[Axes], places: Sequence[int | None], ok: Sequence[bool]) -> None:
    """Give panels of the same states the same limits, which a failed run does not change: its values may be huge."""
    for state in set(places):
        group = [number for number, each in enumerate(places) if each == state]
        good = [panels[number].dataLim for number in group if ok[number]] or [panels[group[0]].dataLim]
        limits = _padded([box.intervaly for box in good])
        for number in group:
            panels[number].set_ylim(*limits)
        if state is None:
            panels[0].set_xlim(*_padded([box.intervalx for box in good]))


def _padded(intervals: Sequence[Array]) -> tuple[float, float]:
    """Return limits that contain all intervals, with some room."""
    low, high = float(np.min(intervals)), float(np.max(intervals))
    room = 0.05 * (high - low) or 1.0
    return low - room, high + room


def _handles(tubes: Sequence[Tube], level: float, plane: bool, *, outside: bool) -> list[Handle]:
    """Make the legend entries of lines, areas and dots, in grey what has the colour of its method."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    dot: dict[str, Any] = {"marker": "o", "ms": 2.6} if plane else {}
    cross: dict[str, Any] = {"marker": "+", "ms": 4.0} if plane else {}
    found: list[Handle] = [
        ("true state", Line2D([], [], **TRUE_STATE, **dot)),
        ("estimate", Line2D([], [], color=REFERENCE, lw=0.9, **cross)),
    ]
    for gaussian, text in ((False, "set $M$"), (True, rf"{100 * level:g} % of $P$")):
        if any(tube.gaussian == gaussian for tube in tubes):
            fill = paler(REFERENCE, FILL)
            found.append((text, Patch(facecolor=fill, edgecolor=REFERENCE, **EDGES[gaussian])))
    return [*found, ("outside", Line2D([], [], **OUTSIDE))] if outside else found


def _note(tubes: dict[str, Tube], run: int, window: TimeWindow | None, every: int) -> str:
    """Name the run, the samples of a plane, and the methods that failed."""
    parts = [f"run {run}"]
    if window is not None:
        first, last = (f"{end:g}" for end in window.limits)
        parts.append(f"t = {first} to {last} s" if window.in_seconds else f"k = {first} to {last}")
        parts.append("every sample" if every == 1 else f"ellipses every {every} samples")
    parts += [f"{name} {tube.status}" for name, tube in tubes.items() if tube.status != Status.OK.word]
    return ", ".join(parts)
