"""Bursts of the measurement noise in pictures of recorded runs: grey bands behind the curves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.figures.palette import BAND
from rmpc_bench.figures.window import TimeWindow
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.figures.legend import Handle

SIGNAL = "bursts"


def bursts_of(point: Trials, rows: Mapping[str, Array]) -> Array | None:
    """Find the samples at which the noise of the shown runs is in a burst; None if not recorded, or if the runs differ.

    `rows` has the places of the shown runs in the traces of each method.
    """
    if not all(SIGNAL in point.traces[name].signals for name in rows):
        return None
    kept = [point.traces[name].signals[SIGNAL][shown] for name, shown in rows.items()]
    if not sum(map(len, kept)):
        return None
    flags = np.concatenate(kept)[:, :, 0] > 0.5
    return np.asarray(flags[0]) if (flags == flags[0]).all() else None


def spans(bursts: Array | None, window: TimeWindow) -> list[tuple[float, float]]:
    """Find where bursts begin and end on the axis: half a sample beyond their samples, but not outside the window."""
    if bursts is None:
        return []
    shown = np.concatenate([[False], bursts[window.first : window.last + 1], [False]]).astype(np.int64)
    starts, stops = (window.first + np.flatnonzero(np.diff(shown) == step) for step in (1, -1))
    low, high = window.limits
    return [
        (max(low, (start - 0.5) * window.sample), min(high, (stop - 0.5) * window.sample))
        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True)
    ]


def shade(panels: Iterable[Axes], bands: Sequence[tuple[float, float]]) -> list[Handle]:
    """Draw the bands of `spans` behind the curves of panels over time; return their legend entry."""
    from matplotlib.patches import Patch

    for axes in panels:
        for start, end in bands:
            axes.axvspan(start, end, color=BAND, lw=0, zorder=0.2)
    return [("burst", Patch(color=BAND, lw=0))] if bands else []
