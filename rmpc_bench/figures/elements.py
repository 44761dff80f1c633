"""The entries of a matrix that a method reports over time, a panel for each, as in Fig. 4 of belda2017."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures import burst_bands, curves
from rmpc_bench.figures.curves import Look, Window
from rmpc_bench.figures.labels import symbol
from rmpc_bench.figures.requirements import is_square, not_square
from rmpc_bench.figures.style import FONT_SIZE, GREY, style
from rmpc_bench.types import Array, DesignError, Status

THINNER = 0.7
"""Width of lines in these small panels, as a share of that in others."""
ANY = "\N{MIDDLE DOT}"


class Entries(NamedTuple):
    """A matrix of one method over one run."""

    values: Array
    """(samples, n, n); NaN where there is none yet."""
    held: bool
    """Whether it is constant over a sample."""
    status: str


def run_of(point: Trials, name: str, run: int) -> tuple[int, str]:
    """Find a recorded run: its place in the traces of a method, and its status.

    Parameters
    ----------
    point : the table that is shown
    name : the method
    run : index of the run

    Raises
    ------
    DesignError
        when it is not recorded
    """
    runs = point.traces[name].runs
    (rows,) = np.nonzero(runs == run)
    if not len(rows):
        raise DesignError(f"run {run} is not recorded (recorded: {', '.join(map(str, runs))})", "run")
    table = point.frame[(point.frame["method"] == name) & (point.frame["run"] == run)]
    return int(rows[0]), str(table["status"].iloc[0])


def entries_of(point: Trials, order: Sequence[str] | None, signal: str, run: int) -> dict[str, Entries]:
    """Find the matrix of every method.

    Parameters
    ----------
    point : the table that is shown
    order : methods asked for; all that report the signal if not given
    signal : what they report
    run : index of the run

    Raises
    ------
    DesignError
        when the run is not recorded, a method does not report the signal, or it is no square matrix
    """
    having = [name for name in point.methods if name in point.traces and signal in point.traces[name].signals]
    if not having:
        there = ", ".join(dict.fromkeys(each for traces in point.traces.values() for each in traces.signals))
        raise DesignError(f"'{signal}' is not a recorded signal (recorded: {there})", "signal")
    for name in order or ():
        if name not in having:
            raise DesignError(f"'{name}' does not report {signal}", "order")
    found = {}
    for name in order or having:
        traces = point.traces[name]
        shape = traces.shapes.get(signal)
        if shape is None or not is_square(shape):
            raise DesignError(not_square(signal, shape), "signal")
        row, status = run_of(point, name, run)
        values = traces.signals[signal][row].reshape(-1, *shape)
        missing = len(traces.r) - len(values)
        found[name] = Entries(np.concatenate([values, values[len(values) - missing :]]), bool(missing), status)
    if len({entries.values.shape for entries in found.values()}) > 1:
        raise DesignError(f"{signal} has not the same size in all methods: name some with `order`", "order")
    return found


def draw(
    point: Trials,
    title: str,
    signal: str,
    found: Mapping[str, Entries],
    run: int,
    window: Window,
    size: tuple[float, float],
) -> Figure:
    """Draw the panels; see `recorded_figures.elements`.

    Parameters
    ----------
    point : the table that is shown
    title : the point of the sweep in words
    signal : name of the matrix
    found : method -> its matrix, from below to above
    run : index of the run
    window : the samples to show
    size : width and height [in]
    """
    looks = curves.looks(point.methods, list(found))
    n = next(iter(found.values())).values.shape[1]
    with style():
        figure = Figure(figsize=size, layout="constrained")
        grid = _grid(figure, n)
        _draw_entries(grid, found, window, looks)
        for place in range(n):
            grid[0, place].set_title(symbol(signal, f"{ANY},{place}"))
            grid[place, 0].set_ylabel(symbol(signal, f"{place},{ANY}"))
        rows = {name: np.flatnonzero(point.traces[name].runs == run) for name in found}
        bands = burst_bands.spans(burst_bands.bursts_of(point, rows), window)
        keys = burst_bands.shade(grid.ravel(), bands)
        grid[0, 0].set_xlim(*window.limits)
        figure.supxlabel(window.label, fontsize=FONT_SIZE)
        curves.finish(figure, [*_handles(point, found, looks), *keys], _note(title, run, found), columns=True)
    return figure


def _grid(figure: Figure, n: int) -> Any:
    """Panels on one horizontal axis; those of the diagonal have one vertical axis, and so have all others."""
    grid: Any = figure.subplots(n, n, sharex=True, squeeze=False)
    for index in np.ndindex(n, n):
        axes, first = grid[index], grid[0, int(index[0] != index[1])]
        axes.grid(color=GREY, linewidth=0.4)
        axes.set_axisbelow(True)
        axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.tick_params(pad=2.0, length=2.5)
        if axes is not first:
            axes.sharey(first)
    return grid


def _draw_entries(grid: Any, found: Mapping[str, Entries], window: Window, looks: Mapping[str, Look]) -> None:
    """Draw the matrices of all methods, those that failed at last: they must not shrink the others."""
    shown = slice(window.first, window.last + 1)
    t = window.sample * np.arange(window.first, window.last + 1)
    failed = {name: entries.status != Status.OK.word for name, entries in found.items()}
    first = [name for name in found if not failed[name]] or list(found)
    for names in (first, [name for name in found if name not in first]):
        limits = [axes.get_ylim() for axes in grid.ravel()]
        for i, j in np.ndindex(grid.shape):
            values = {name: curves.drawable(found[name].values[shown, i, j]) for name in found}
            rough = curves.are_rough([values[name] for name in first])
            for name in names:
                line = looks[name].line(held=found[name].held, rough=rough)
                grid[i, j].plot(t, values[name], **{**line, "lw": THINNER * line["lw"]})
        if names is not first:
            for axes, limit in zip(grid.ravel(), limits, strict=True):
                axes.set_ylim(limit)


def _handles(point: Trials, found: Mapping[str, Entries], looks: Mapping[str, Look]) -> list[tuple[str, Artist]]:
    return [(point.labels.get(name, name), curves.sample(looks[name])) for name in found]


def _note(title: str, run: int, found: Mapping[str, Entries]) -> str:
    """Say which run is shown, and which methods failed in it."""
    failed = [f"{name} {entries.status}" for name, entries in found.items() if entries.status != Status.OK.word]
    return "\n".join(filter(None, [title, ", ".join([f"run {run}", *failed])]))
