"""An enlarged panel of a signal over time, chosen by a configuration or where curves of several methods coincide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.figures.recorded_runs import PanelSignal, RunSelection
from rmpc_bench.figures.window import TimeWindow
from rmpc_bench.types import Array, NonNegative

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

N_PARTS = 7
"""Parts of the time axis, one of which an automatic zoom shows."""
COINCIDE = 0.05
"""Reach of the curves in a part, as a share of that in the whole panel, up to which they coincide on its scale."""
DIFFERENT = 0.25
"""Distance between curves, as a share of their reach in a part, from which on they differ on a scale of their own."""
ROUNDING = 1e-6
"""Distance between curves, as a share of the whole reach, up to which they are equal but for rounding."""


@dataclass(frozen=True)
class Zoom:
    """A signal in a window of time, enlarged in a panel of its own.

    Parameters
    ----------
    signal : a signal, or a component of one such as x_hat.2
    from_ : first time to show [s]
    to : last time to show [s]
    """

    signal: str
    from_: NonNegative
    to: NonNegative


def automatic_zoom(
    point: Trials, panels: Sequence[PanelSignal], window: TimeWindow, runs: Mapping[str, RunSelection]
) -> tuple[PanelSignal, TimeWindow] | None:
    """Find a panel and a part of its time in which curves coincide on its scale and differ on a scale of their own.

    Of every method the first run that is shown counts.  The time is divided into 7 parts.  A part is chosen if the
    curves reach over at most 5 % of the panel's range there, and if two of them are at least a quarter of this reach
    apart at some sample.  Signals that are held over a sample, such as the input, come first, and later parts.

    Parameters
    ----------
    point : the table that is shown
    panels : the signals
    window : the samples that are shown
    runs : method -> the runs that are shown

    Returns
    -------
    the signal and the samples to enlarge; None where there is no such part
    """
    having = [name for name in runs if not runs[name].failed]
    if len(having) < 2 or window.last - window.first < 2 * N_PARTS:
        return None
    for panel in sorted(panels, key=lambda each: not any(each.is_held(point.traces[name]) for name in having)):
        names = [name for name in having if panel.is_in(point.traces[name])]
        if len(names) < 2:
            continue
        curves = np.stack([panel.curves(point.traces[name], window, runs[name].rows[:1])[1][0] for name in names])
        part = _part(curves)
        if part is not None:
            first, last = (window.first + end for end in part)
            return panel, window._replace(first=first, last=last)
    return None


def _part(curves: Array) -> tuple[int, int] | None:
    """Find the first and the last sample of the last part to enlarge, (methods, samples) -> samples."""
    whole = _reach(curves)
    if not whole > 0:
        return None
    ends = np.linspace(0, curves.shape[1] - 1, N_PARTS + 1).round().astype(int).tolist()
    for first, last in reversed(list(zip(ends[:-1], ends[1:], strict=True))):
        inside = curves[:, first : last + 1]
        if not np.isfinite(inside).all():
            continue
        reach, apart = _reach(inside), float(np.ptp(inside, axis=0).max())
        if reach <= COINCIDE * whole and apart >= DIFFERENT * reach and apart > ROUNDING * whole:
            return first, last
    return None


def _reach(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if len(finite) else 0.0
