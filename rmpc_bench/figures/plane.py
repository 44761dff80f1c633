"""The path of one run in the plane of two outputs, with time marks, as in Fig. 1 of belda2017."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures import burst_bands, curves
from rmpc_bench.figures.curves import ROUND, Window
from rmpc_bench.figures.direct_labels import Label, write
from rmpc_bench.figures.elements import run_of
from rmpc_bench.figures.keys import MOST_MARKS, TOO_CLOSE
from rmpc_bench.figures.labels import symbol, with_unit
from rmpc_bench.figures.style import GREY, REFERENCE, style
from rmpc_bench.types import Array, DesignError, Status

DASHED = (0, (4, 2))
BROAD = 7.0  # points; of the band under a path in a burst
MARK: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.2, "mew": 0.7, "mfc": "white", "mec": REFERENCE, "zorder": 2.1}


class Path(NamedTuple):
    """Where a run of a method went, at the samples that are shown."""

    y: Array
    """(samples, 2)."""
    r: Array
    """(samples, 2) where it was meant to go."""
    status: str

    def magnified(self, factor: float) -> Array:
        """Return the path with the distances from the reference so many times as large."""
        with np.errstate(over="ignore", invalid="ignore"):  # of a run on the way to divergence
            return np.asarray(self.y if factor == 1.0 else self.r + factor * (self.y - self.r))


def path_of(point: Trials, name: str, run: int, components: tuple[int, int], window: Window) -> Path:
    """Find the path of one method.

    Parameters
    ----------
    point : the table that is shown
    name : the method
    run : index of the run
    components : the outputs, the horizontal one first
    window : the samples to show

    Raises
    ------
    DesignError
        when the run is not recorded, or there is no such output
    """
    row, status = run_of(point, name, run)
    traces = point.traces[name]
    n = traces.r.shape[1]
    if max(components) >= n:
        raise DesignError(f"there is no output {max(components)} (they count from 0 to {n - 1})", "components")
    shown = slice(window.first, window.last + 1)
    chosen = list(components)
    return Path(traces.signals["y"][row][shown][:, chosen], traces.r[shown][:, chosen], status)


def height_of(paths: Mapping[str, Path], magnify: float, width: float, *, equal: bool) -> float:
    """Choose the height of the picture [in]: that of the paths, but neither flat nor more than half as high again.

    Parameters
    ----------
    paths : all that are shown
    magnify : factor of the distances from the reference
    width : of the picture [in]
    equal : whether both axes have one scale
    """
    good = [path for path in paths.values() if path.status == Status.OK.word] or list(paths.values())
    points = np.concatenate([each for path in good for each in (path.r, path.magnified(magnify))])
    across, up = np.ptp(points[np.isfinite(points).all(axis=1)], axis=0) if len(points) else (1.0, 1.0)
    ratio = up / across if equal and across > 0 else 0.8
    return 0.7 + (width - 0.8) * min(1.3, max(0.5, float(ratio)))


def draw(
    point: Trials,
    title: str,
    paths: Mapping[str, Path],
    components: tuple[int, int],
    window: Window,
    size: tuple[float, float],
    *,
    run: int,
    marks: float,
    magnify: float,
) -> Figure:
    """Draw the paths; see `recorded_figures.plane`.

    Parameters
    ----------
    point : the table that is shown
    title : the point of the sweep in words
    paths : method -> path, from below to above
    components : the outputs, the horizontal one first
    window : the samples that are shown
    size : width and height [in]
    run : index of the run
    marks : time between two marks, in seconds or samples; 0 for no marks
    magnify : factor of the distances from the reference
    """
    looks = curves.looks(point.methods, list(paths))
    failed = {name: path.status != Status.OK.word for name, path in paths.items()}
    reference = next(iter(paths.values())).r
    places = marks_of(window, marks)
    with style():
        figure = Figure(figsize=size, layout="constrained")
        (axes,) = curves.panels(figure, 1)
        axes.yaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 5, 10]))
        line, keys = _draw_reference(axes, point, paths, run, window)
        handles: list[tuple[str, Artist]] = []
        for name in sorted(paths, key=lambda name: failed[name]):
            limits, look = (axes.get_xlim(), axes.get_ylim()), looks[name]
            y = curves.drawable(paths[name].magnified(magnify))
            axes.plot(*y.T, **look.line())
            axes.plot(*y[places].T, ls="", marker="o", ms=2.2, mew=0.0, color=look.color, zorder=look.zorder)
            if failed[name] and not all(failed.values()):
                axes.set_xlim(limits[0])  # what fails may go far away; it must not shrink the others
                axes.set_ylim(limits[1])
        handles += [(point.labels.get(name, name), curves.sample(looks[name])) for name in paths]
        axes.plot(*reference[places].T, **MARK)
        axes.margins(0.1)
        axes.set_xlabel(label_of(point, components[0]))
        axes.set_ylabel(label_of(point, components[1]))
        if is_equal(point, components):
            axes.set_aspect("equal", adjustable="datalim")
        note = _note(paths, run, window, marks, magnify)
        curves.finish(figure, [*handles, ("reference", line), *keys], "\n".join(filter(None, [title, note])))
        drawn = [reference, *(path.magnified(magnify) for path in paths.values())]
        write(axes, _times(reference, places, window), [(each[:, 0], each[:, 1]) for each in drawn], color=REFERENCE)
    return figure


def marks_of(window: Window, marks: float) -> list[int]:
    """Find the samples of the time marks, counted from the first one that is shown.

    Parameters
    ----------
    window : the samples that are shown
    marks : time between two of them; 0 for none

    Raises
    ------
    DesignError
        when they are too close
    """
    if not marks:
        return []
    first, last = (end / marks for end in window.limits)
    if last - first > MOST_MARKS:
        raise DesignError(TOO_CLOSE, "marks")
    numbers = range(math.ceil(first - ROUND), math.floor(last + ROUND) + 1)
    return [round(number * marks / window.sample) - window.first for number in numbers]


def is_equal(point: Trials, components: tuple[int, int]) -> bool:
    """Whether both outputs have the same unit, so that one scale makes sense."""
    one, other = (_unit(point, component) for component in components)
    return one == other


def label_of(point: Trials, component: int) -> str:
    """Label of an axis."""
    return with_unit(symbol("y", str(component)), _unit(point, component))


def _unit(point: Trials, component: int) -> str:
    return point.units.get(f"y.{component}", point.units.get("y", ""))


def _draw_reference(
    axes: Axes, point: Trials, paths: Mapping[str, Path], run: int, window: Window
) -> tuple[Line2D, list[tuple[str, Artist]]]:
    """Draw the reference, with a broad band where the noise is in a burst; return its line and the key of the band."""
    reference = next(iter(paths.values())).r
    rows = {name: np.flatnonzero(point.traces[name].runs == run) for name in paths}
    found = burst_bands.bursts_of(point, rows)
    keys: list[tuple[str, Artist]] = []
    if found is not None and found[window.first : window.last + 1].any():
        inside = np.where(found[window.first : window.last + 1, None], reference, np.nan)
        (band,) = axes.plot(*inside.T, color=GREY, lw=BROAD, solid_capstyle="butt", zorder=1.9)
        keys = [("burst", band)]
    (line,) = axes.plot(*reference.T, color=REFERENCE, linestyle=DASHED, linewidth=0.9, zorder=2.0)
    return line, keys


def _times(reference: Array, places: Sequence[int], window: Window) -> list[Label]:
    """Numbers of the time marks."""
    return [
        Label(float(reference[k, 0]), float(reference[k, 1]), f"{window.sample * (window.first + k):g}") for k in places
    ]


def _note(paths: Mapping[str, Path], run: int, window: Window, marks: float, magnify: float) -> str:
    """Say which run is shown, what marks and distances mean, and which methods failed."""
    seconds = window.label != "$k$"
    parts = [f"run {run}"]
    if marks:
        parts.append(f"marks every {marks:g} {'s' if seconds else 'samples'}")
    if magnify != 1.0:
        parts.append(f"errors \N{MULTIPLICATION SIGN}{magnify:g}")
    parts += [f"{name} {path.status}" for name, path in paths.items() if path.status != Status.OK.word]
    return ", ".join(parts)
