"""Elements of a matrix that methods report, over time: a panel for each, as in the matrix (belda2017, Fig. 4)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import dress_small
from rmpc_bench.figures.labels import at_point, joined, name_of, sentence, symbol
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.palette import are_rough, line_styles, sample
from rmpc_bench.figures.points import point_at
from rmpc_bench.figures.recorded_runs import TimeWindow, bursts_of, find_run, shade, shown_part, spans, window_of
from rmpc_bench.figures.style import FONT_SIZE, new_figure, style
from rmpc_bench.types import Array, NonNegative
from rmpc_bench.types.errors import Issue
from rmpc_bench.types.figure import Index, OnePointFigure
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

THINNER = 0.7  # width of lines in these small panels, as a share of that in others
ANY = r"\cdot"


@dataclass(frozen=True, kw_only=True)
class Elements(OnePointFigure):
    """All elements of a matrix that methods report, such as Q_yw, over time: a panel for each, as in the matrix.

    The panels of the diagonal have one vertical axis, the others another one.  Bursts of the noise are shaded.  Held
    values are drawn in steps.

    Parameters
    ----------
    signal : name of the matrix, which must be recorded and square, such as Q_yw
    run : index of the run, which must be recorded
    from_ : first time to show [s]
    to : last time to show [s]
    width : width of the whole picture [in]; 3.5 is enough for three columns
    height : height of the whole picture [in]; if not given 0.7 and 0.8 for every row; long legends and titles add to it
    order : methods to show, later ones above earlier ones; all that report the signal if not given
    """

    needs_runs: ClassVar[bool] = True

    signal: str
    run: Index = 0
    from_: NonNegative | None = None
    to: NonNegative | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: a recorded run of methods that report such a square matrix, which fits."""
        yield from super().check(layout)
        yield from layout.require_signals()
        yield from layout.require_recorded(self.run)
        if layout.recorded and self.signal not in layout.signal_names:
            known = ", ".join(layout.signal_names)
            yield Issue("signal", f"{self.signal!r} is not recorded (recorded: {known})")
        elif layout.recorded:
            yield from self._check_matrix(layout)
        yield from layout.require_window(self.from_, self.to)

    def _check_matrix(self, layout: ResultLayout) -> Iterator[Issue]:
        shapes = {name: signals[self.signal] for name, signals in layout.signals.items() if self.signal in signals}
        for name in self.order or ():
            if name in layout.methods and name not in shapes:
                yield Issue("order", f"'{name}' does not report {self.signal}")
        shown = {shapes[name] for name in self.order or shapes if name in shapes}
        for shape in sorted(shown, key=str):
            if shape is None or len(shape) != 2 or shape[0] != shape[1]:
                sizes = f" ({' x '.join(map(str, shape))})" if shape else ""
                yield Issue("signal", f"{self.signal} is not a square matrix{sizes}: show it with signals")
                return
        if len(shown) > 1:
            yield Issue("order", f"{self.signal} has different sizes in the methods: select some with `order`")
        n = max((shape[0] for shape in shown if shape), default=1)
        least = 0.5 + 0.9 * n
        if self.width < least:
            yield Issue("width", f"{n} columns need a width of {least:g} inches (got {self.width:g})")

    def caption(self, results: Trials) -> str:
        """Name the matrix, its methods, the run and the axes; see `Figure.caption`."""
        made = self._content(results)
        names = joined(name_of(made.point, name) for name in made.matrices)
        return sentence(
            f"Elements of the matrix {symbol(self.signal)} of {names} in run {self.run}{at_point(made.title)}, "
            f"{made.window.words}, with one vertical axis for the diagonal and another one for all others",
            "bursts of the noise are shaded" if made.bursts else "",
            f"failed: {joined(made.failed)}" if made.failed else "",
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw the matrices of one run at one point; see `Figure.draw`."""
        made = self._content(results)
        n = next(iter(made.matrices.values())).values.shape[1]
        with style():
            figure = new_figure(self.size(0.7 + 0.8 * n))
            grid = _grid(figure, n)
            handles = _draw_elements(grid, made)
            for each in range(n):
                grid[0, each].set_title(symbol(self.signal, f"{ANY},{each}"))
                grid[each, 0].set_ylabel(symbol(self.signal, f"{each},{ANY}"))
            handles += shade(grid.ravel(), made.bursts)
            grid[0, 0].set_xlim(*made.window.limits)
            figure.supxlabel(made.window.label, fontsize=FONT_SIZE)
            note = ", ".join([f"run {self.run}", *made.failed])
            finish(figure, handles, "\n".join(filter(None, [made.title, note])), columns=True)
        return figure

    def _content(self, results: Trials) -> Content:
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods = self.order or [name for name, signals in layout.signals.items() if self.signal in signals]
        window = window_of(point, len(point.traces[methods[0]].r) - 1, self.from_, self.to)
        rows = {name: np.flatnonzero(point.traces[name].runs == self.run) for name in methods}
        matrices = {name: matrix_of(point, name, self.signal, self.run, window) for name in methods}
        return Content(point, title, matrices, window, spans(bursts_of(point, rows), window))


class RecordedMatrix(NamedTuple):
    """A matrix of one method over one run."""

    values: Array  # (shown samples, n, n); NaN before the first one is reported
    held: bool  # whether it is constant over a sample
    failure: str  # status of the run where it failed, else empty


class Content(NamedTuple):
    """What the figure shows."""

    point: Trials
    title: str
    matrices: Mapping[str, RecordedMatrix]
    window: TimeWindow
    bursts: Sequence[tuple[float, float]]

    @property
    def failed(self) -> list[str]:
        """Methods that failed in the run, with their status."""
        return [f"{name_of(self.point, name)} {each.failure}" for name, each in self.matrices.items() if each.failure]


def matrix_of(point: Trials, name: str, signal: str, run: int, window: TimeWindow) -> RecordedMatrix:
    """Read the matrix that a method reports in a run."""
    traces = point.traces[name]
    row, failure = find_run(point, name, run)
    every = traces.signals[signal][[row]]
    values = shown_part(every, traces, window).reshape(-1, *traces.shapes[signal])
    return RecordedMatrix(values, every.shape[1] < len(traces.r), failure)


def _grid(figure: MplFigure, n: int) -> Any:
    """Make panels on one horizontal axis; those of the diagonal share a vertical axis, and so do all others."""
    grid: Any = figure.subplots(n, n, sharex=True, squeeze=False)
    for index in np.ndindex(n, n):
        axes, first = grid[index], grid[0, int(index[0] != index[1])]
        dress_small(axes)
        axes.tick_params(pad=2.0, length=2.5)
        if axes is not first:
            axes.sharey(first)
    return grid


def _draw_elements(grid: Any, made: Content) -> list[Handle]:
    """Draw all methods, those that failed last, so that they do not shrink the others; return their legend entries.

    An entry looks as the lines do: it has no marker, and no dashes where no panel has them.
    """
    styles = line_styles(made.point.all_methods, list(made.matrices))
    values = {name: each.values for name, each in made.matrices.items()}
    first = [name for name, each in made.matrices.items() if not each.failure] or list(values)
    rough = {(i, j): are_rough([values[name][:, i, j] for name in first]) for i, j in np.ndindex(grid.shape)}
    for names in (first, [name for name in values if name not in first]):
        limits = [axes.get_ylim() for axes in grid.ravel()]
        for (i, j), name in product(rough, names):
            line = styles[name].line(held=made.matrices[name].held, rough=rough[i, j])
            grid[i, j].plot(made.window.times, values[name][:, i, j], **{**line, "lw": THINNER * line["lw"]})
        if names is not first:
            for axes, limit in zip(grid.ravel(), limits, strict=True):
                axes.set_ylim(limit)
    looks = {name: styles[name].line(rough=all(rough.values())) for name in values}
    return [(name_of(made.point, name), sample(**look)) for name, look in looks.items()]
