"""Axes of all figures: stacked panels, logarithmic scales, and values that matplotlib can draw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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
    """Make the vertical (or horizontal) axis logarithmic, with more ticks than powers of ten where it spans few."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    (axes.set_xscale if horizontal else axes.set_yscale)("log")
    low, high = axes.get_xlim() if horizontal else axes.get_ylim()
    if high < 1e3 * low:
        axis = axes.xaxis if horizontal else axes.yaxis
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(FuncFormatter(_tick))
        axis.set_minor_formatter(NullFormatter())


def _tick(value: float, _place: int | None = None) -> str:
    r"""Write a tick of a logarithmic axis: plain where that is short, else as a multiple of a power of ten.

    Examples
    --------
    >>> _tick(0.02), _tick(5e-5), _tick(1e-5)
    ('0.02', '$5\\times 10^{-5}$', '$10^{-5}$')
    """
    if not value or 1e-3 <= abs(value) < 1e5:
        return f"{value:g}"
    mantissa, exponent = f"{value:.0e}".split("e")
    power = f"10^{{{int(exponent)}}}"
    return f"${power}$" if mantissa == "1" else rf"${mantissa}\times {power}$"
