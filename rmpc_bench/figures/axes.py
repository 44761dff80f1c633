"""Axes of all figures: stacked panels, logarithmic scales, and values that matplotlib can draw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.figures.labels import LINEAR
from rmpc_bench.figures.style import GREY
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

FAR = 1e100
"""Largest magnitude that is drawn: matplotlib fails on the last values of a run that diverges."""
STEPS = (1, 2, 5, 10)
"""Ticks are multiples of these."""


def stacked_panels(figure: MplFigure, n: int, *, sharex: bool = True) -> list[Axes]:
    """Stack panels, on a common horizontal axis by default."""
    from matplotlib.ticker import MaxNLocator

    rows = list(figure.subplots(n, sharex=sharex, squeeze=False)[:, 0])
    for axes in rows:
        axes.grid(color=GREY, linewidth=0.4)
        axes.set_axisbelow(True)
        axes.xaxis.set_major_locator(MaxNLocator("auto", steps=STEPS))
    return rows


def few_ticks(axes: Axes) -> None:
    """Give the vertical axis round ticks."""
    from matplotlib.ticker import MaxNLocator

    axes.yaxis.set_major_locator(MaxNLocator("auto", steps=STEPS))


def drawable(values: Array) -> Array:
    """Limit values to a magnitude that matplotlib can draw; NaN, a gap, stays NaN."""
    return np.where(np.isnan(values), np.nan, np.clip(values, -FAR, FAR))


def make_logarithmic(axes: Axes, *, horizontal: bool = False) -> None:
    """Make the vertical axis logarithmic, with more than powers of ten on it where it spans few of them.

    Parameters
    ----------
    axes : a panel
    horizontal : the horizontal axis and not the vertical one
    """
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    (axes.set_xscale if horizontal else axes.set_yscale)("log")
    low, high = axes.get_xlim() if horizontal else axes.get_ylim()
    if high < 1e3 * low:
        axis = axes.xaxis if horizontal else axes.yaxis
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def make_logarithmic_if_positive(axes: Axes, values: Sequence[Array]) -> str:
    """Make the vertical axis logarithmic if all numbers are positive; else return a remark for its label."""
    if all((each[np.isfinite(each)] > 0).all() for each in values):
        make_logarithmic(axes)
        return ""
    return LINEAR
