"""Axes of all figures and of the table of the page: scales with their ticks, panels, and values that can be drawn.

An axis of ratios is that of their logarithm: ends and places of ticks are logs.  One row far from the others does not
squeeze them: it lies beyond the end of the axis, where an arrow stands for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from rmpc_bench.analysis.shown_numbers import MINUS, TIMES, Estimate, number
from rmpc_bench.figures.palette import BAND, INK, LINE
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.result_rows import Form

FACTORS = (0.001, 0.01, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 10, 20, 50, 100, 1000)
"""Ticks of a wide axis of ratios."""
PER_CENT_STEPS = (1, 2, 5, 10, 20, 25, 50)  # distances of the ticks of a narrow one [%]
APART = 0.14  # smallest distance of two tick labels as a part of the axis
REACH = 8.0  # rows that reach farther than this many times the middle one lie beyond the axis
WIDE = 20.0  # ratio of the largest to the smallest value from which on an axis of values is logarithmic
_SMALLEST, _LARGEST = 1e-12, 1e100


class Tick(NamedTuple):
    """A place on an axis and its label."""

    at: float
    label: str


class Axis(NamedTuple):
    """Ends of an axis and its ticks; on a logarithmic one all of them are logs."""

    low: float
    high: float
    ticks: tuple[Tick, ...]
    log: bool

    def place(self, value: float) -> float:
        """Return where a value lies, 0 at the left end and 1 at the right one; a value beyond an end lies outside."""
        at = _log(value) if self.log else value
        return (at - self.low) / (self.high - self.low)


def _log(ratio: float) -> float:
    return math.log(min(max(ratio, _SMALLEST), _LARGEST)) if not math.isnan(ratio) else ratio


def ratio_axis(changes: Sequence[Estimate], margin: float, most: int = 6) -> Axis:
    """Choose the axis of changes [%] with their intervals, around no change.

    Intervals may be NaN; the margin is the smallest relative change that matters.
    """
    finite = [change for change in changes if math.isfinite(change.value)]
    rows = [[_log(1 + (change.value if math.isnan(end) else end) / 100) for end in change[1:]] for change in finite]
    reach = sorted(max(map(abs, row)) for row in rows)
    limit = max(REACH * reach[(len(reach) + 1) // 2 - 1] if reach else 0.0, math.log1p(3 * margin))
    inside = [row for row in rows if max(map(abs, row)) <= limit]
    edge = math.log1p(2 * margin) or math.log1p(0.02)
    low, high = min([-edge, *(row[0] for row in inside)]), max([edge, *(row[1] for row in inside)])
    pad = 0.05 * (high - low)
    low, high = low - pad, high + pad
    return Axis(low, high, _ratio_ticks(low, high, most), log=True)


def _ratio_ticks(low: float, high: float, most: int) -> tuple[Tick, ...]:
    """Choose ticks in per cent where all lie between 0.4 and 2.2, else factors."""
    if low >= math.log(0.4) and high <= math.log(2.2):
        for step in PER_CENT_STEPS:
            first, last = math.ceil((math.exp(low) - 1) * 100 / step), math.floor((math.exp(high) - 1) * 100 / step)
            if last - first + 1 <= most:
                found = [k * step for k in range(first, last + 1) if k * step > -100]
                return _thinned([Tick(math.log1p(k / 100), _per_cent(k)) for k in found], low, high)
    return _thinned([Tick(math.log(f), f"{TIMES}{f:g}") for f in FACTORS if low <= math.log(f) <= high], low, high)


def _per_cent(k: int) -> str:
    return f"{k:+d} %".replace("-", MINUS) if k else "0"


def _thinned(ticks: Sequence[Tick], low: float, high: float) -> tuple[Tick, ...]:
    """Leave room for the labels of ticks."""
    return spaced(ticks, lambda tick, last: abs(tick.at - last.at) >= APART * (high - low))


def spaced(ticks: Sequence[Tick], are_apart: Callable[[Tick, Tick], bool]) -> tuple[Tick, ...]:
    """Keep the tick nearest to 0, which is no change, and going away from it those that are apart from the last one."""
    middle = min(range(len(ticks)), key=lambda k: abs(ticks[k].at), default=0)
    kept = list(ticks[middle : middle + 1])
    for side in (ticks[middle + 1 :], ticks[:middle][::-1]):
        last = ticks[middle] if side else None
        for tick in side:
            if last is not None and are_apart(tick, last):
                kept.append(tick)
                last = tick
    return tuple(sorted(kept))


def value_axis(values: Sequence[float], most: int = 5, *, wide: float = WIDE) -> Axis:
    """Choose the axis of the finite values: logarithmic if all are positive and the range exceeds the factor `wide`."""
    finite = [float(value) for value in values if math.isfinite(value)] or [0.0, 1.0]
    lowest, highest = min(finite), max(finite)
    log = lowest > 0 and highest / lowest > wide
    low, high = (math.log(lowest), math.log(highest)) if log else (lowest, highest)
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        half = 0.05 * abs(high) or 0.5
        low, high = low - half, high + half
    pad = 0.04 * (high - low)
    ticks = _log_ticks(low, high, most) if log else _linear_ticks(low, high, most)
    return Axis(low - pad, high + pad, ticks, log)


def difference_axis(changes: Sequence[Estimate], margin: float, most: int = 6) -> Axis:
    """Choose the axis of differences in the unit of a metric: linear, with no difference on it."""
    ends = [end for change in changes for end in change if math.isfinite(end)]
    reach = sorted(map(abs, ends)) or [margin or 1.0]
    limit = max(REACH * reach[(len(reach) + 1) // 2 - 1], 3 * margin) or 1.0
    inside = [end for end in ends if abs(end) <= limit]
    edge = 2 * margin or 0.05 * max([abs(end) for end in inside] or [1.0]) or 1.0
    low, high = min([*inside, -edge]), max([*inside, edge])
    pad = 0.05 * (high - low)
    ticks = [Tick(tick.at, tick.label if tick.at <= 0 else f"+{tick.label}") for tick in _linear_ticks(low, high, most)]
    return Axis(low - pad, high + pad, _thinned(ticks, low - pad, high + pad), log=False)


def share_axis() -> Axis:
    """Return the axis of the share of the runs in which a method is better."""
    labels = {0.0: "0 %", 0.25: "25 %", 0.5: "equal", 0.75: "75 %", 1.0: "100 %"}
    return Axis(-0.05, 1.05, tuple(Tick(at, label) for at, label in labels.items()), log=False)


def _log_ticks(low: float, high: float, most: int) -> tuple[Tick, ...]:
    decades = range(math.floor(low / math.log(10)), math.ceil(high / math.log(10)) + 1)
    found: list[float] = []
    for factors in ((1, 2, 5), (1, 3), (1,)):
        found = [f * 10.0**d for d in decades for f in factors if low <= math.log(f * 10.0**d) <= high]
        if len(found) <= most:
            break
    found = found[:: math.ceil(len(found) / most) or 1]
    return tuple(Tick(math.log(v), f"{v:g}".replace("-", MINUS)) for v in found)


def _linear_ticks(low: float, high: float, most: int) -> tuple[Tick, ...]:
    raw = (high - low) / most
    size = 10.0 ** math.floor(math.log10(raw))
    step = next(s * size for s in (1, 2, 5, 10) if s * size >= raw * (1 - 1e-12))
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    found = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    plain = all(abs(k * step) < 1e5 and decimals < 6 for k in found)
    return tuple(
        Tick(k * step, number(k * step, decimals) if plain else f"{k * step:g}".replace("-", MINUS)) for k in found
    )


FAR = 1e100  # largest magnitude that is drawn: matplotlib fails on the last values of a run that diverges
STEPS = (1, 2, 5, 10)  # ticks are multiples of these


def stacked_panels(figure: MplFigure, n: int, *, sharex: bool = True) -> list[Axes]:
    """Stack panels, on a common horizontal axis by default."""
    from matplotlib.ticker import MaxNLocator

    rows = list(figure.subplots(n, sharex=sharex, squeeze=False)[:, 0])
    for axes in rows:
        axes.grid(color=LINE, linewidth=0.4)
        axes.set_axisbelow(True)
        axes.xaxis.set_major_locator(MaxNLocator("auto", steps=STEPS))
    return rows


def dress_small(axes: Axes, **keys: Any) -> None:
    """Give one of many panels its grid and few round ticks."""
    from matplotlib.ticker import MaxNLocator

    axes.grid(color=LINE, linewidth=0.4, **keys)
    axes.set_axisbelow(True)
    axes.xaxis.set_major_locator(MaxNLocator(4, steps=STEPS))
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=STEPS))


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

    >>> _tick(0.02), _tick(5e-5), _tick(1e-5)
    ('0.02', '$5\\times 10^{-5}$', '$10^{-5}$')
    """
    if not value or 1e-3 <= abs(value) < 1e5:
        return f"{value:g}"
    mantissa, exponent = f"{value:.0e}".split("e")
    power = f"10^{{{int(exponent)}}}"
    return f"${power}$" if mantissa == "1" else rf"${mantissa}\times {power}$"


Log = bool | Literal["auto"]
NONE: dict[str, float] = {"ratio": 1.0, "share": 0.5}  # form of a change -> where there is none, else 0


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
