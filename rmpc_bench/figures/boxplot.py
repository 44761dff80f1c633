"""Boxplot of a metric: one box per method (zenere2018, Fig. 7), the points of a sweep as panels (Fig. 8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import FAR, make_logarithmic
from rmpc_bench.figures.labels import (
    DID_NOT_OCCUR,
    POINTS_PER_INCH,
    literal,
    metric_of,
    typeset,
    width,
    with_unit,
    wrapped,
)
from rmpc_bench.figures.style import BLUE, FONT_SIZE, GREY, RED, style
from rmpc_bench.figures.sweep_points import MOST_PANELS, points_at, short_title
from rmpc_bench.types import Array, MetricInfo
from rmpc_bench.types.figure import SweepFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.text import Text

    from rmpc_bench.analysis.trials import Trials

WHISKER = 1.5
"""Longest whisker, in interquartile ranges."""


@dataclass(frozen=True, kw_only=True)
class Boxplot(SweepFigure):
    """One box per method: red median, blue quartiles, whiskers to 1.5 interquartile ranges, red outliers.

    Below each box are the number of runs, as n/total if some runs failed, and the number of runs without a finite
    value, such as runs that did not settle.  The latter are not part of the box.  The points of a sweep are panels with
    a common axis, one below the other.  If all panels have the same numbers, only the last panel shows them.

    Parameters
    ----------
    metric : name of the metric; the primary one if not given
    log : logarithmic axis; linear, with a remark, if a value is not positive
    height : height of the whole picture [in]; if not given 2.4 plus 1.4 for every further point of a sweep; labels
        wider than their box are rotated and need additional height
    order : methods to show, from left to right; all if not given
    at : points of the sweep to show, from top to bottom, each by values of its paths; all (6 at most) if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    metric: str | None = None
    log: bool = False

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: no more points than panels fit."""
        yield from super().check(layout)
        example = ", ".join(f"{path}: {value}" for path, value in (layout.points or ({},))[0].items())
        advice = f"choose with `at`, such as [{{{example}}}]"
        n = layout.n_points_at(self.at)
        yield from layout.require_at_most(MOST_PANELS, n, "points of the sweep", "at" if self.at else "", advice)

    def draw(self, results: Trials) -> MplFigure:
        """Draw the boxes of the points from top to bottom; see `Figure.draw`."""
        self.require(layout_of(results))
        points, info = points_at(results, self.at), metric_of(results, self.metric)
        size = self.size(1.0 + 1.4 * len(points))
        return _draw(points, info, self.order or results.methods, size, log=self.log)


def box_of(values: Array) -> dict[str, Any]:
    """Compute the numbers of a box.

    Parameters
    ----------
    values : (n,) finite values, at least one

    Returns
    -------
    quartiles `q1`, `med`, `q3`, ends of the whiskers `whislo`, `whishi`, and the outliers `fliers`
    """
    q1, median, q3 = np.percentile(values, [25, 50, 75])
    reach = WHISKER * (q3 - q1)
    # Of few values none may lie between a quartile, which is interpolated, and the end of the reach.
    low = values[values >= q1 - reach].min(initial=q1)
    high = values[values <= q3 + reach].max(initial=q3)
    outliers = np.concatenate([values[values < low], values[values > high]])
    return {"q1": q1, "med": median, "q3": q3, "whislo": low, "whishi": high, "fliers": outliers}


def _draw(
    points: Sequence[Trials], info: MetricInfo, methods: Sequence[str], size: tuple[float, float], *, log: bool
) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure

    panels = [[point.column(info.name, method) for method in methods] for point in points]
    drawn = np.concatenate([column[np.isfinite(column)] for column in chain(*panels)])
    positive = bool((drawn > 0).all())
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        rows = list(figure.subplots(len(panels), sharey=True, squeeze=False)[:, 0])
        for axes, columns, point in zip(rows, panels, points, strict=True):
            _draw_boxes(axes, columns)
            axes.set_title("\n".join(wrapped(literal(short_title(point)), 0.8 * size[0] * POINTS_PER_INCH)))
        if not len(drawn):
            rows[0].set_yticks([])
        elif log and positive:
            make_logarithmic(rows[0])
        note = " (linear: some values <= 0)" if log and not positive else ""
        name = _name_axis(figure, rows, with_unit(literal(info.name), info.unit) + note)
        # The first layout gives the width of a box.
        figure.draw_without_rendering()
        slot = rows[0].get_position().width * size[0] * POINTS_PER_INCH / len(methods) - FONT_SIZE / 2
        labels = [typeset(points[0].labels.get(method, method)) for method in methods]
        _label_panels(rows, labels, panels, slot)
        # The layout is made once, at one resolution, or a second save would move it.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        if len(rows) > 1:
            name.set_y((rows[0].get_position().y1 + rows[-1].get_position().y0) / 2)
    return figure


def _name_axis(figure: MplFigure, rows: Sequence[Axes], text: str) -> Text:
    """Label the axis of a single panel, or the one that panels share."""
    if len(rows) == 1:
        rows[0].set_ylabel(text)
        return rows[0].yaxis.label
    return figure.supylabel(text, fontsize=FONT_SIZE)


def _draw_boxes(axes: Axes, columns: Sequence[Array]) -> None:
    boxes, positions = [], []
    for position, column in enumerate(columns, start=1):
        values = column[np.isfinite(column)]
        if len(values):
            boxes.append(box_of(np.clip(values, -FAR, FAR)))
            positions.append(position)
    axes.bxp(
        boxes,
        positions=positions,
        widths=0.5,
        manage_ticks=False,
        boxprops={"color": BLUE, "linewidth": 1.0},
        medianprops={"color": RED, "linewidth": 1.4},
        whiskerprops={"color": "black", "linewidth": 0.7, "linestyle": (0, (4, 2))},
        capprops={"color": "black", "linewidth": 0.7},
        flierprops={"marker": "+", "markeredgecolor": RED, "markersize": 4, "markeredgewidth": 0.7},
    )
    axes.set_xlim(0.5, len(columns) + 0.5)
    axes.set_xticks([])
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y", color=GREY, linewidth=0.4)
    axes.set_axisbelow(True)


def _label_panels(rows: Sequence[Axes], labels: Sequence[str], panels: Sequence[Sequence[Array]], slot: float) -> None:
    """Write labels and counts below the last panel; counts below the others too if they differ."""
    counts = [[_counts(column) for column in columns] for columns in panels]
    for axes, lines in zip(rows[:-1], counts[:-1], strict=True):
        if any(other != lines for other in counts):
            _label_boxes(axes, None, lines, slot)
    _label_boxes(rows[-1], labels, counts[-1], slot)


def _label_boxes(axes: Axes, labels: Sequence[str] | None, counts: Sequence[list[str]], slot: float) -> None:
    """Write label and counts below each box, upright on one line if they do not fit into `slot` points."""
    heads = [wrapped(label, slot) for label in labels] if labels else [[] for _ in counts]
    feet = [[line for text in lines for line in wrapped(text, slot)] for lines in counts]
    blocks = [head + foot for head, foot in zip(heads, feet, strict=True)]
    upright = any(width(line) > slot for line in chain(*blocks))
    if upright:
        heads = [label.splitlines() for label in labels] if labels else heads
        blocks = [[", ".join(head + lines)] for head, lines in zip(heads, counts, strict=True)]
        figure = axes.get_figure(root=True)
        assert figure is not None
        figure.set_figheight(figure.get_figheight() + max(width(line) for (line,) in blocks) / POINTS_PER_INCH)
    texts = ["\n".join(block) for block in blocks]
    axes.set_xticks(range(1, len(texts) + 1), texts, rotation=90 if upright else 0)


def _counts(column: Array) -> list[str]:
    n, n_infinite = int((~np.isnan(column)).sum()), int(np.isinf(column).sum())
    lines = [f"n={n}" if n == len(column) else f"{n}/{len(column)}"]
    if n_infinite:
        lines.append(f"{n_infinite} {DID_NOT_OCCUR}")
    return lines if n else ["no value", *lines]
