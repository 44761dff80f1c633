"""Bursts of the measurement noise in pictures of recorded runs: grey bands behind the curves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.curves import Window
from rmpc_bench.types import Array

SIGNAL = "bursts"
PALE = "#ebebeb"
"""Paler than the grid, which stays seen on it."""


def bursts_of(point: Trials, rows: Mapping[str, Array]) -> Array | None:
    """Tell the samples at which the noise of the shown runs is in a burst.

    Parameters
    ----------
    point : the table whose traces are shown
    rows : method -> places of the shown runs in its traces

    Returns
    -------
    (samples,) whether it is; None where nobody knows, or where some of the runs are and others are not
    """
    kept = [point.traces[name].signals[SIGNAL][shown] for name, shown in rows.items() if _knows(point, name)]
    if len(kept) < len(rows) or not sum(map(len, kept)):
        return None
    flags = np.concatenate(kept)[:, :, 0] > 0.5
    return np.asarray(flags[0]) if (flags == flags[0]).all() else None


def spans(bursts: Array | None, window: Window) -> list[tuple[float, float]]:
    """Find where bursts begin and end on the axis: half a sample beyond their samples, but not outside the window.

    Parameters
    ----------
    bursts : as `bursts_of` tells them
    window : the samples that are shown
    """
    if bursts is None:
        return []
    shown = np.concatenate([[False], bursts[window.first : window.last + 1], [False]]).astype(np.int64)
    starts, stops = (window.first + np.flatnonzero(np.diff(shown) == step) for step in (1, -1))
    low, high = window.limits
    return [
        (max(low, (start - 0.5) * window.sample), min(high, (stop - 0.5) * window.sample))
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True)
    ]


def shade(panels: Iterable[Axes], bands: Sequence[tuple[float, float]]) -> list[tuple[str, Artist]]:
    """Draw bands behind the curves of panels over time; return what the legend says of them.

    Parameters
    ----------
    panels : with the time on their horizontal axis
    bands : as `spans` finds them
    """
    for axes in panels:
        for start, end in bands:
            axes.axvspan(start, end, color=PALE, lw=0, zorder=0.2)
    return [("burst", Patch(color=PALE, lw=0))] if bands else []


def _knows(point: Trials, name: str) -> bool:
    return SIGNAL in point.traces[name].signals
