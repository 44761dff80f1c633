"""Axis of changes against the baseline, of ratios, differences or shares of the runs, and what is drawn behind them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

from rmpc_bench.analysis.shown_numbers import Estimate
from rmpc_bench.figures.axes import FAR
from rmpc_bench.figures.palette import BAND, INK
from rmpc_bench.figures.scales import WIDE, Axis, difference_axis, ratio_axis, share_axis, value_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from rmpc_bench.analysis.result_rows import Form

Log = bool | Literal["auto"]
NONE: dict[str, float] = {"ratio": 1.0, "share": 0.5}
"""Form of a change -> where there is none, else 0."""


def change_axis(form: Form, changes: Sequence[Estimate], margin: float, most: int = 6) -> Axis:
    """Choose the axis of changes; ratios are relative to 1."""
    if form == "share":
        return share_axis()
    found = [each for each in changes if math.isfinite(each.value)]
    if form == "difference":
        return difference_axis(found, margin, most)
    return ratio_axis([Estimate(*(100 * (end - 1) for end in each)) for each in found], margin, most)


def scaled_axis(values: Sequence[float], log: Log) -> Axis:
    """Choose the axis of values: logarithmic as asked for, or where the largest exceeds 20 times the smallest."""
    drawn = [min(max(each, -FAR), FAR) for each in values if math.isfinite(each)]
    return value_axis(drawn, wide=WIDE if log == "auto" else 1.0 if log else math.inf)


def set_axis(axes: Axes, axis: Axis, *, upright: bool = False) -> None:
    """Give a panel the scale, limits and ticks of an axis: the vertical one if upright, else the horizontal one."""
    back, side = math.exp if axis.log else float, "y" if upright else "x"
    how: dict[str, Any] = {f"{side}scale": "log" if axis.log else "linear"}
    how |= {f"{side}lim": (back(axis.low), back(axis.high)), f"{side}ticks": [back(tick.at) for tick in axis.ticks]}
    axes.set(**how)
    axes.set(**{f"{side}ticklabels": [tick.label for tick in axis.ticks]})
    axes.minorticks_off()


def draw_no_change(axes: Axes, form: Form, margin: float, *, upright: bool = False, gid: str | None = None) -> None:
    """Draw where nothing changes, and the margin of relevance around it."""
    line, span = (axes.axhline, axes.axhspan) if upright else (axes.axvline, axes.axvspan)
    if margin and form != "share":
        ends = (1 / (1 + margin), 1 + margin) if form == "ratio" else (-margin, margin)
        span(*ends, color=BAND, lw=0, zorder=0.2)
    line(NONE.get(form, 0.0), color=INK, lw=0.9, zorder=2.1, gid=gid)
