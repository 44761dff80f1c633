"""Elements of a matrix that methods report, over time: a panel for each, as in the matrix (belda2017, Fig. 4)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import STEPS, drawable
from rmpc_bench.figures.captions import joined, label_of, place, sentences
from rmpc_bench.figures.labels import symbol
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.palette import LINE, LineStyle, are_rough, legend_sample, line_styles
from rmpc_bench.figures.points import point_at
from rmpc_bench.figures.recorded_runs import TimeWindow, bursts_of, find_run, shade, spans, window_of
from rmpc_bench.figures.style import FONT_SIZE, new_figure, style
from rmpc_bench.types import Array, NonNegative, Status
from rmpc_bench.types.figure import Index, OnePointFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

THINNER = 0.7
"""Width of lines in these small panels, as a share of that in others."""
ANY = r"\cdot"


@dataclass(frozen=True, kw_only=True)
class Elements(OnePointFigure):
    """All elements of a matrix that methods report, such as Q_yw, over time: a panel for each, as in the matrix.

    The panels of the diagonal have one vertical axis, all others another one.  Bursts of the noise are shaded.  A value
    that is held over a sample is drawn in steps; there is a gap before the first one.

    Parameters
    ----------
    signal : name of the matrix, which must be recorded and square, such as Q_yw
    run : index of the run, which must be recorded
    from_ : first time to show [s]
    to : last time to show [s]
    width : width of the whole picture [in]; 3.5 is enough for three columns
    height : height of the whole picture [in]; if not given 0.7 and 0.8 for every row; legend and title add to it if
        they need more than a line
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
        """Name the matrix, the run and the axes, and state the mean of every element; see `Figure.caption`."""
        point, title = point_at(results, self.at)
        signals = layout_of(point).signals
        methods = self.order or [name for name in signals if self.signal in signals[name]]
        matrices = {name: matrix_of(point, name, self.signal, self.run) for name in methods}
        window = window_of(point, len(point.traces[methods[0]].r) - 1, self.from_, self.to)
        rows = {name: np.flatnonzero(point.traces[name].runs == self.run) for name in methods}
        bursts = spans(bursts_of(point, rows), window)
        means = [f"{label_of(point, name)} {_means(matrix, window)}" for name, matrix in matrices.items()]
        failed = [f"{label_of(point, name)} {each.status}" for name, each in matrices.items() if each.status != "ok"]
        return sentences(
            f"Elements of the matrix {symbol(self.signal)} of {joined(label_of(point, name) for name in methods)} in "
            f"run {self.run}, {window.words}, a panel for each, as in the matrix; indices count from 0",
            place(point, title),
            "The panels of the diagonal have one vertical axis, all others another one",
            "Bursts of the noise are shaded" if bursts else "",
            f"Mean over time, row by row: {'; '.join(means)}",
            f"Failed: {joined(failed)}" if failed else "",
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw the matrices of one run at one point; see `Figure.draw`."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods = self.order or [name for name, signals in layout.signals.items() if self.signal in signals]
        matrices = {name: matrix_of(point, name, self.signal, self.run) for name in methods}
        window = window_of(point, len(point.traces[methods[0]].r) - 1, self.from_, self.to)
        styles = line_styles(point.all_methods, list(matrices))
        n = next(iter(matrices.values())).values.shape[1]
        with style():
            figure = new_figure(self.size(0.7 + 0.8 * n))
            grid = _grid(figure, n)
            _draw_elements(grid, matrices, window, styles)
            for place in range(n):
                grid[0, place].set_title(symbol(self.signal, f"{ANY},{place}"))
                grid[place, 0].set_ylabel(symbol(self.signal, f"{place},{ANY}"))
            rows = {name: np.flatnonzero(point.traces[name].runs == self.run) for name in matrices}
            keys = shade(grid.ravel(), spans(bursts_of(point, rows), window))
            grid[0, 0].set_xlim(*window.limits)
            figure.supxlabel(window.label, fontsize=FONT_SIZE)
            handles: list[Handle] = [(point.labels.get(name, name), legend_sample(styles[name])) for name in matrices]
            finish(figure, [*handles, *keys], _note(title, self.run, matrices), columns=True)
        return figure


class RecordedMatrix(NamedTuple):
    """A matrix of one method over one run."""

    values: Array
    """(samples, n, n); NaN before the first one is reported."""
    held: bool
    """Whether it is constant over a sample."""
    status: str


def matrix_of(point: Trials, name: str, signal: str, run: int) -> RecordedMatrix:
    """Read the matrix that a method reports in a run."""
    traces = point.traces[name]
    row, status = find_run(point, name, run)
    values = traces.signals[signal][row].reshape(-1, *traces.shapes[signal])
    # The last value of a held signal is continued to the last sample.
    missing = len(traces.r) - len(values)
    return RecordedMatrix(np.concatenate([values, values[len(values) - missing :]]), bool(missing), status)


def _grid(figure: MplFigure, n: int) -> Any:
    """Make panels on one horizontal axis; those of the diagonal share a vertical axis, and so do all others."""
    from matplotlib.ticker import MaxNLocator

    grid: Any = figure.subplots(n, n, sharex=True, squeeze=False)
    for index in np.ndindex(n, n):
        axes, first = grid[index], grid[0, int(index[0] != index[1])]
        axes.grid(color=LINE, linewidth=0.4)
        axes.set_axisbelow(True)
        axes.xaxis.set_major_locator(MaxNLocator(4, steps=STEPS))
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=STEPS))
        axes.tick_params(pad=2.0, length=2.5)
        if axes is not first:
            axes.sharey(first)
    return grid


def _draw_elements(
    grid: Any, matrices: Mapping[str, RecordedMatrix], window: TimeWindow, styles: Mapping[str, LineStyle]
) -> None:
    """Draw the matrices of all methods, those that failed last, so that they do not shrink the others."""
    failed = {name: matrix.status != Status.OK.word for name, matrix in matrices.items()}
    first = [name for name in matrices if not failed[name]] or list(matrices)
    for names in (first, [name for name in matrices if name not in first]):
        limits = [axes.get_ylim() for axes in grid.ravel()]
        for i, j in np.ndindex(grid.shape):
            values = {name: drawable(matrix.values[window.slice, i, j]) for name, matrix in matrices.items()}
            rough = are_rough([values[name] for name in first])
            for name in names:
                line = styles[name].line(held=matrices[name].held, rough=rough)
                grid[i, j].plot(window.times, values[name], **{**line, "lw": THINNER * line["lw"]})
        if names is not first:
            for axes, limit in zip(grid.ravel(), limits, strict=True):
                axes.set_ylim(limit)


def _means(matrix: RecordedMatrix, window: TimeWindow) -> str:
    """Write the means of all elements over the samples that have values."""
    values = matrix.values[window.slice]
    finite = values[np.isfinite(values).all(axis=(1, 2))]
    rows = finite.mean(axis=0) if len(finite) else np.full(values.shape[1:], np.nan)
    return "[" + "; ".join(" ".join(f"{value:.3g}" for value in row) for row in rows) + "]"


def _note(title: str, run: int, matrices: Mapping[str, RecordedMatrix]) -> str:
    """Name the run, and the methods that failed in it."""
    failed = [f"{name} {matrix.status}" for name, matrix in matrices.items() if matrix.status != Status.OK.word]
    return "\n".join(filter(None, [title, ", ".join([f"run {run}", *failed])]))
