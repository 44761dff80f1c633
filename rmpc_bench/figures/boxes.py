"""Boxes of runs, upright or lying, on a common axis: quartiles, median, and whiskers from 5 to 95 % of the runs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.analysis.result_rows import BETTER, FAILS_MORE, WORSE, ResultRow
from rmpc_bench.figures.palette import BAND, INK, PRINT
from rmpc_bench.figures.scales import Axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VERDICT_COLOURS = {BETTER: PRINT["better"], WORSE: PRINT["worse"], FAILS_MORE: PRINT["fail"]}
"""Word of a verdict -> colour; that of any other is the ink."""
WIDTH, CAP = 0.56, 0.28
"""Widths of a box and of the end of a whisker, as shares of the distance of two boxes."""
TINT = 0.18
"""Opacity of the colour of a verdict in a box."""
THIN, MEDIAN = 0.8, 1.8
"""Widths of the lines of a box and of its median [pt]."""


def draw_box(axes: Axes, row: ResultRow, place: float, axis: Axis, *, upright: bool = False) -> None:
    """Draw the box of a method; a box or whisker without end has an arrow at the end of the axis."""
    from matplotlib.patches import Rectangle

    if not row.quantiles:
        return
    back = math.exp if axis.log else float
    first, last = back(axis.low), back(axis.high)
    low, q1, median, q3, high = (min(max(each, first), last) for each in row.quantiles)
    gid = f"method-{row.method}"
    colour = VERDICT_COLOURS.get(row.word)
    face: Any = (colour, TINT) if colour else BAND
    corner, size = (q1, place - WIDTH / 2), (q3 - q1, WIDTH)
    corner, size = (corner[::-1], size[::-1]) if upright else (corner, size)
    axes.add_patch(Rectangle(corner, *size, facecolor=face, edgecolor=INK, lw=THIN, gid=gid, zorder=2.2))
    whiskers = [(low, q1, 0.0), (q3, high, 0.0)]
    whiskers += [(end, end, CAP) for end, known in ((low, low), (high, row.quantiles[-1])) if math.isfinite(known)]
    for parts, thick in ((whiskers, THIN), ([(median, median, WIDTH)], MEDIAN)):
        # One line with gaps takes less of a file than several.
        values = np.array([[start, end, math.nan] for start, end, _ in parts]).ravel()
        places = np.array([[place - across / 2, place + across / 2, math.nan] for *_, across in parts]).ravel()
        x, y = (places, values) if upright else (values, places)
        axes.plot(x, y, color=INK, lw=thick, solid_capstyle="butt", gid=gid, zorder=2.3)
    if not math.isfinite(row.quantiles[-1]):
        point, marker = ((place, last), "^") if upright else ((last, place), ">")
        axes.plot(*point, ls="", marker=marker, ms=4, color=INK, clip_on=False, gid=gid, zorder=2.4)
