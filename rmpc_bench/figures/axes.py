"""Axes of all figures: stacked panels, logarithmic scales, and values that matplotlib can draw."""

from __future__ import annotations

import math
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


def scale_by_ratio(axes: Axes, low: float, high: float) -> None:
    """Give equal ratios equal lengths on a horizontal axis of changes [%] above -100, with ticks at round ratios."""
    from matplotlib.ticker import FixedLocator, NullLocator

    axes.set_xscale("function", functions=(_log_of_ratio, _change_of_log))
    first, last = (float(_log_of_ratio(np.array(end))) for end in (low, high))
    margin = 0.05 * (last - first)
    axes.set_xlim(float(_change_of_log(np.array(first - margin))), float(_change_of_log(np.array(last + margin))))
    step = max(1, math.ceil((last - first) / 4))
    # Few powers of ten leave room for halves and doubles.
    between = (0.5, 2.0) if last - first < 2 else ()
    ratios = sorted({*(10.0**n for n in range(step * math.floor(first / step), math.ceil(last) + 1, step)), *between})
    ticks = [100 * (ratio - 1) for ratio in ratios if first - margin <= math.log10(ratio) <= last + margin]
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(ticks, [f"{tick:+.6g}" if tick else "0" for tick in ticks])


def _log_of_ratio(change: Array) -> Array:
    """Turn a change in per cent into the decimal logarithm of a ratio, limited to what can be drawn."""
    return np.log10(np.clip(1 + np.asarray(change, dtype=float) / 100, 1 / FAR, FAR))


def _change_of_log(logarithm: Array) -> Array:
    """Turn the decimal logarithm of a ratio into a change in per cent."""
    far = math.log10(FAR)
    ratio: Array = 10.0 ** np.clip(np.asarray(logarithm, dtype=float), -far, far)
    return 100 * (ratio - 1)


def make_logarithmic_if_positive(axes: Axes, values: Sequence[Array]) -> str:
    """Make the vertical axis logarithmic if all numbers are positive; else return a remark for its label."""
    if all((each[np.isfinite(each)] > 0).all() for each in values):
        make_logarithmic(axes)
        return ""
    return LINEAR
