"""Boxplot of a metric: one box per method (zenere2018, Fig. 7), the points of a sweep as panels (Fig. 8)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import FAR, make_logarithmic
from rmpc_bench.figures.box_labels import counts_of, label_panels
from rmpc_bench.figures.boxes import FILL, WHISKER, add_strip, crosses_sentence, draw_boxes, drawn_columns
from rmpc_bench.figures.captions import (
    changes_sentence,
    infinite_sentence,
    joined,
    label_of,
    medians_sentence,
    quantity,
    runs_sentence,
    sentences,
)
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, metric_label, metric_of, wrapped
from rmpc_bench.figures.line_styles import LineStyle, line_styles, paler
from rmpc_bench.figures.style import FONT_SIZE, fix_layout, lay_out, style
from rmpc_bench.figures.sweep_points import MOST_PANELS, points_at, short_title
from rmpc_bench.types import Array, MetricInfo
from rmpc_bench.types.figure import SweepFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.text import Text

    from rmpc_bench.analysis.trials import Trials

FLAT = 0.02
"""Height of a box, as a share of a linear axis, below which its quartiles cannot be distinguished."""
WIDE = 10.0
"""Ratio of the largest to the smallest value from which on a logarithmic axis makes flat boxes higher."""


@dataclass(frozen=True, kw_only=True)
class Boxplot(SweepFigure):
    """One box per method in its colour: black median, quartiles, whiskers to 1.5 interquartile ranges, outliers.

    One line below the boxes gives the number of runs if it is the same for all; else it stands below each box, as
    n/total if some runs failed.  Also below a box is the number of runs without a finite value, such as runs that did
    not settle.  They count as larger than every other value and lie in a grey strip at the top.  The points of a sweep
    are panels with a common axis, one below the other.  If all panels have the same numbers, only the last panel shows
    them.  A label that is wider than its box is broken into lines.  If it then has more than 5 lines, or is taller than
    the panel, all labels are rotated by 45 degrees, or numbers with a key below replace them.

    Parameters
    ----------
    metric : name of the metric; the primary one if not given
    log : logarithmic axis; linear, with a remark, if a value is not positive; `auto` is logarithmic if all values are
        positive, the largest is at least 10 times the smallest, and some box with different quartiles would be lower
        than 2 % of a linear axis
    height : height of the whole picture [in]; if not given 2.4 plus 1.4 for every further point of a sweep; labels of
        more than two lines, rotated labels and a key need additional height
    order : methods to show, from left to right; all if not given
    at : points of the sweep to show, from top to bottom, each by values of its paths; all (6 at most) if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    metric: str | None = None
    log: bool | Literal["auto"] = "auto"

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: no more points than panels fit."""
        yield from super().check(layout)
        example = ", ".join(f"{path}: {value}" for path, value in (layout.points or ({},))[0].items())
        advice = f"choose with `at`, such as [{{{example}}}]"
        n = layout.n_points_at(self.at)
        yield from layout.require_at_most(MOST_PANELS, n, "points of the sweep", "at" if self.at else "", advice)

    def caption(self, results: Trials) -> str:
        """Define the boxes, count the runs, and state medians and changes; see `Figure.caption`."""
        from rmpc_bench.analysis.comparison import levels

        points, info = points_at(results, self.at), metric_of(results, self.metric)
        methods = self.order or list(results.methods)
        panels = _panels(points, info, methods)
        is_log, remark = axis_of(self.log, panels)
        scale = (
            ", on a logarithmic axis" if is_log else ", on a linear axis as some values are not positive" * bool(remark)
        )
        where = f" at {'; '.join(map(short_title, points))}" if points[0].point else ""
        changes = changes_sentence(points[0], methods, info, levels(results)) if len(points) == 1 else ""
        return sentences(
            f"Distribution of {quantity(info)} over the runs for {joined(label_of(results, name) for name in methods)}"
            f"{where}{scale}",
            "A box extends from the lower to the upper quartile, the line in it is the median, the whiskers reach to "
            f"the last values within {WHISKER:g} interquartile ranges of the box, and crosses are values beyond them",
            crosses_sentence(drawn_columns(panels, is_log=is_log)[0]),
            runs_sentence(points, methods),
            infinite_sentence(points, methods, info),
            medians_sentence(points, methods, info),
            changes,
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw the boxes of the points from top to bottom; see `Figure.draw`."""
        self.require(layout_of(results))
        points, info = points_at(results, self.at), metric_of(results, self.metric)
        methods = self.order or list(results.methods)
        styles = line_styles(results.all_methods, methods)
        return _draw(self, points, info, styles, self.size(1.0 + 1.4 * len(points)))


def axis_of(log: bool | Literal["auto"], panels: Sequence[Sequence[Array]]) -> tuple[bool, str]:
    """Return whether the axis is logarithmic, and the remark if it was asked to be and cannot."""
    boxes = [column[np.isfinite(column)] for column in chain(*panels)]
    drawn = np.concatenate([np.zeros(0), *boxes])
    if not len(drawn) or log is False:
        return False, ""
    positive = bool((drawn > 0).all())
    if log is True:
        return positive, "" if positive else " (linear: some values <= 0)"
    if not positive or drawn.max() < WIDE * drawn.min():
        return False, ""
    reach = float(min(drawn.max(), FAR) - drawn.min())
    heights = [float(np.subtract(*np.percentile(np.minimum(values, FAR), [75, 25]))) for values in boxes if len(values)]
    return any(0 < height < FLAT * reach for height in heights), ""


def _panels(points: Sequence[Trials], info: MetricInfo, methods: Sequence[str]) -> list[list[Array]]:
    return [[point.column(info.name, method) for method in methods] for point in points]


def _draw(
    keys: Boxplot, points: Sequence[Trials], info: MetricInfo, styles: dict[str, LineStyle], size: tuple[float, float]
) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure

    panels = _panels(points, info, list(styles))
    is_log, remark = axis_of(keys.log, panels)
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        rows = list(figure.subplots(len(panels), sharey=True, squeeze=False)[:, 0])
        drawn, ceiling = drawn_columns(panels, is_log=is_log)
        for axes, columns, point in zip(rows, drawn, points, strict=True):
            draw_boxes(axes, columns, list(styles.values()), ceiling)
            axes.set_title("\n".join(wrapped(literal(short_title(point)), 0.8 * size[0] * POINTS_PER_INCH)))
        if not any(np.isfinite(column).any() for column in chain(*panels)):
            rows[0].set_yticks([])
        elif is_log:
            make_logarithmic(rows[0])
        if ceiling is not None:
            add_strip(rows, drawn, ceiling, is_log=is_log)
        name = _name_axis(figure, rows, metric_label(info) + remark)
        # The first layout gives the width of a box.
        lay_out(figure)
        slot = rows[0].get_position().width * size[0] * POINTS_PER_INCH / len(styles) - FONT_SIZE / 2
        labels = [label_of(points[0], method) for method in styles]
        counts = [
            [counts_of(column, int(point.computed(name).sum())) for name, column in zip(styles, columns, strict=True)]
            for point, columns in zip(points, panels, strict=True)
        ]
        label_panels(rows, labels, counts, slot, [_sample(look) for look in styles.values()])
        # The layout is made once, at one resolution, or a second save would move it.
        fix_layout(figure)
        if len(rows) > 1:
            name.set_y((rows[0].get_position().y1 + rows[-1].get_position().y0) / 2)
    return figure


def _name_axis(figure: MplFigure, rows: Sequence[Axes], text: str) -> Text:
    """Label the axis of a single panel, or the one that panels share."""
    if len(rows) == 1:
        rows[0].set_ylabel("\n".join(wrapped(text, 0.8 * figure.get_figheight() * POINTS_PER_INCH)))
        return rows[0].yaxis.label
    return figure.supylabel(text, fontsize=FONT_SIZE)


def _sample(look: LineStyle) -> Artist:
    """Make a small box for the key."""
    from matplotlib.patches import Patch

    return Patch(facecolor=paler(look.color, FILL), edgecolor=look.color, linewidth=1.0, gid=look.gid)
