"""Drawn cells of a table: boxes and bars that CSS places in per cent of the cell, on an axis that all rows share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from rmpc_bench.analysis.result_rows import ResultRow, ResultTable
from rmpc_bench.analysis.shown_numbers import Estimate
from rmpc_bench.figures.axes import Axis, difference_axis, ratio_axis, share_axis, value_axis


class Line(NamedTuple):
    """A line of the grid."""

    left: str
    css: str
    """``zero`` where nothing changes."""
    label: str
    """Of the tick, with `odd` for one of those that are left out where the cell is narrow."""
    odd: bool


class Bar(NamedTuple):
    """A bar or a box from left to right."""

    css: str
    left: str
    width: str


class Strip(NamedTuple):
    """What is drawn in a cell."""

    grid: Sequence[Line]
    band: Bar | None = None
    bars: Sequence[Bar] = ()
    dot: str = ""
    """Place of the estimate."""
    middle: str = ""
    """Place of the median."""
    arrow: str = ""
    """Side on which the estimate, or a quantile, lies beyond the axis."""


def per_cent(share: float) -> str:
    """Write a place as CSS does."""
    return f"{100 * share:.2f}".rstrip("0").rstrip(".") + "%"


def grid_of(axis: Axis, nothing: float | None = None) -> list[Line]:
    """Return the lines of an axis, of which one may stand for no change."""
    ticks = axis.ticks
    middle = min(range(len(ticks)), key=lambda k: abs(ticks[k].at - (nothing or 0.0)), default=0)
    places = [(tick.at - axis.low) / (axis.high - axis.low) for tick in ticks]
    return [
        Line(
            per_cent(place),
            "zero" if nothing is not None and abs(tick.at - nothing) < 1e-12 else "",
            tick.label,
            (k - middle) % 2 == 1,
        )
        for k, (place, tick) in enumerate(zip(places, ticks, strict=True))
    ]


def _bar(css: str, low: float, high: float) -> Bar:
    low, high = min(max(low, 0.0), 1.0), min(max(high, 0.0), 1.0)
    return Bar(css, per_cent(low), per_cent(high - low))


class Changes(NamedTuple):
    """Cells of changes, on one axis."""

    axis: Axis
    grid: Sequence[Line]
    band: Bar | None

    @classmethod
    def on(cls, axis: Axis, nothing: float, edge: float) -> Changes:
        """Draw on an axis on which `nothing` is no change; a band around it reaches to `edge` on both sides."""
        size = axis.high - axis.low
        ends = [(nothing + end - axis.low) / size for end in (-edge, edge)]
        return cls(axis, grid_of(axis, nothing), _bar("", *ends) if edge else None)

    @classmethod
    def of(cls, table: ResultTable) -> Changes:
        """Choose the axis of the rows of a table."""
        changes = [row.change for row in table.rows]
        if table.form == "share":
            return cls.on(share_axis(), 0.5, 0.0)
        if table.form == "difference":
            return cls.on(difference_axis(changes, table.margin), 0.0, table.margin)
        return cls.on(ratio_axis(changes, table.margin), 0.0, math.log1p(table.margin))

    def strip(self, change: Estimate) -> Strip:
        """Draw a ratio, a difference or a share with its interval; the grid alone where there is none."""
        strip = Strip(self.grid, self.band)
        if math.isnan(change.value):
            return strip
        value, low, high = map(self.axis.place, change)
        if not 0 <= value <= 1:
            return strip._replace(arrow="right" if value > 1 else "left")
        bars = [] if math.isnan(change.half) else [_bar("", low, high)]
        return strip._replace(bars=bars, dot=per_cent(value))


def drawn_change(row: ResultRow, table: ResultTable) -> Estimate:
    """Return the ratio, the difference or the share that a row shows."""
    if table.form == "share":
        return Estimate(*(each / 100 for each in row.superiority))
    return row.change if table.form == "difference" else Estimate(*(1 + each / 100 for each in row.change))


class Runs:
    """Cells of the runs of a table.

    Parameters
    ----------
    rows : methods with their quantiles
    """

    def __init__(self, rows: Sequence[ResultRow]) -> None:
        self.axis = value_axis([each for row in rows for each in row.quantiles])
        self.grid = grid_of(self.axis)

    def strip(self, row: ResultRow) -> Strip | None:
        """Draw the quantiles of a row; None without a finished run."""
        if not row.quantiles:
            return None
        first, low, middle, high, last = map(self.axis.place, row.quantiles)
        bars = [_bar("thin", first, low), _bar("thin", high, last), _bar("box", low, high)]
        median = per_cent(middle) if math.isfinite(row.quantiles[2]) else ""
        return Strip(self.grid, None, bars, "", median, "" if math.isfinite(row.quantiles[4]) else "right")
