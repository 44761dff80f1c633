"""Boxes of a boxplot: their numbers, and the place of runs in which the event of a metric did not occur."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.analysis.intervals import quantiles
from rmpc_bench.figures.axes import FAR
from rmpc_bench.figures.line_styles import LineStyle, paler
from rmpc_bench.figures.style import BLACK, GREY
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WHISKER = 1.5
"""Longest whisker, in interquartile ranges."""
FILL = 0.75
"""Share of white in the inside of a box."""
MOST_CROSSES = 500
"""Most values beyond the whiskers of a box that are drawn; a page with a million runs would have 10 MB of them."""
STRIP = 0.16
"""Height of the strip for runs without the event, as a share of the range of the finite values."""
ABSENT = "did not\noccur"
"""Tick of the strip."""


def box_of(values: Array) -> dict[str, Any]:
    """Compute the numbers of a box in the words of matplotlib: the quartiles, `whislo`, `whishi` and `fliers`.

    There must be a value; it is infinite where an event did not occur.
    """
    q1, median, q3 = map(float, quantiles(values, [0.25, 0.5, 0.75]))
    reach = WHISKER * (q3 - q1) if math.isfinite(q3) else math.inf
    # Of few values none may lie between a quartile, which is interpolated, and the end of the reach.
    low = values[values >= q1 - reach].min(initial=q1) if math.isfinite(reach) else values.min()
    high = values[values <= q3 + reach].max(initial=q3)
    outliers = np.concatenate([values[values < low], values[values > high]])
    return {"q1": q1, "med": median, "q3": q3, "whislo": low, "whishi": high, "fliers": outliers}


def thinned(values: Array) -> Array:
    """Return values beyond the whiskers, the lowest and the highest among them: at most `MOST_CROSSES`, by rank."""
    if len(values) <= MOST_CROSSES:
        return values
    return np.asarray(np.sort(values)[np.linspace(0, len(values) - 1, MOST_CROSSES).round().astype(np.int64)])


def crosses_sentence(panels: Sequence[Sequence[Array]]) -> str:
    """Say that not all values of `drawn_columns` beyond the whiskers are drawn; empty where all are."""
    large = [column for panel in panels for column in panel if len(column) > MOST_CROSSES]
    if not any(len(box_of(column)["fliers"]) > MOST_CROSSES for column in large):
        return ""
    return f"Of more than {MOST_CROSSES} values beyond the whiskers of a box {MOST_CROSSES} are drawn, at equal ranks"


def drawn_columns(panels: Sequence[Sequence[Array]], *, is_log: bool) -> tuple[list[list[Array]], float | None]:
    """Leave out the values of failed runs, and limit the others to what can be drawn.

    They are infinite where the event did not occur.  Also return the height that stands for infinity; it is None if the
    event occurs in all runs or in none.
    """
    columns = [[_limited(column) for column in panel] for panel in panels]
    every = np.concatenate([np.zeros(0), *chain(*columns)])
    finite = every[np.isfinite(every)]
    if not len(finite):
        return [[column[:0] for column in panel] for panel in columns], None
    if len(finite) == len(every):
        return columns, None
    low, high = float(finite.min()), float(finite.max())
    if is_log:
        return columns, high * max(high / low, 2.0) ** STRIP
    return columns, high + STRIP * ((high - low) or abs(high) or 1.0)


def _limited(column: Array) -> Array:
    there = column[np.isfinite(column) | (column == math.inf)]
    limited: Array = np.where(np.isinf(there), there, np.clip(there, -FAR, FAR))
    return limited


def draw_boxes(axes: Axes, columns: Sequence[Array], looks: Sequence[LineStyle], ceiling: float | None) -> None:
    """Draw the boxes of `drawn_columns` from left to right; a method without a value leaves its place empty.

    The ceiling stands for infinity; it is None if all values are finite.
    """
    for position, (values, look) in enumerate(zip(columns, looks, strict=True), start=1):
        if not len(values):
            continue
        box = box_of(values)
        box["fliers"] = thinned(box["fliers"])
        if ceiling is not None:
            box = {name: np.where(np.isinf(each), ceiling, each) for name, each in box.items()}
        drawn = axes.bxp(
            [box],
            positions=[position],
            widths=0.5,
            manage_ticks=False,
            patch_artist=True,
            boxprops={"edgecolor": look.color, "facecolor": paler(look.color, FILL), "linewidth": 1.0},
            medianprops={"color": BLACK, "linewidth": 1.4},
            whiskerprops={"color": look.color, "linewidth": 0.9},
            capprops={"color": look.color, "linewidth": 0.9},
            flierprops={"marker": "+", "markeredgecolor": look.color, "markersize": 4, "markeredgewidth": 0.7},
        )
        for artist in chain(*drawn.values()):
            artist.set_gid(look.gid)
    axes.set_xlim(0.5, len(columns) + 0.5)
    axes.set_xticks([])
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y", color=GREY, linewidth=0.4)
    axes.set_axisbelow(True)


def add_strip(rows: Sequence[Axes], panels: Sequence[Sequence[Array]], ceiling: float, *, is_log: bool) -> None:
    """Shade the strip of runs without the event above `ceiling`, and name it in place of the ticks that lie in it."""
    every = np.concatenate([np.zeros(0), *chain(*panels)])
    high = float(every[np.isfinite(every)].max())
    # The strip is as high above its middle as below it, and leaves the largest finite value outside.
    if is_log:
        ratio = (ceiling / high) ** 0.6
        bottom, top = ceiling / ratio, ceiling * ratio
    else:
        half = 0.6 * (ceiling - high)
        bottom, top = ceiling - half, ceiling + half
    lowest = rows[0].get_ylim()[0]
    ticks = [tick for tick in rows[0].get_yticks() if lowest <= tick < bottom]
    for axes in rows:
        axes.axhspan(bottom, top, color=GREY, alpha=0.35, linewidth=0, zorder=0)
    words = rows[0].yaxis.get_major_formatter().format_ticks(ticks)
    rows[0].set_yticks([*ticks, ceiling], [*words, ABSENT])
    rows[0].set_ylim(lowest, top)
