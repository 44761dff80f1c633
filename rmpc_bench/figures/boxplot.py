"""Boxplot of a metric: an upright box per method (zenere2018, Fig. 7), the points of a sweep as panels (Fig. 8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rmpc_bench.figures.axes import FAR, Log, scaled_axis, set_axis
from rmpc_bench.figures.labels import (
    LINEAR,
    literal,
    metric_label,
    name_of,
    names_of_columns,
    quantity,
    runs_sentence,
    sentence,
    short_title,
    wrapped,
)
from rmpc_bench.figures.palette import DIM
from rmpc_bench.figures.points import first_tables, shown_rows
from rmpc_bench.figures.style import FONT_SIZE, POINTS_PER_INCH, fix_layout, new_figure, style
from rmpc_bench.types import Array
from rmpc_bench.types.figure import SweepFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.result_rows import ResultTable
    from rmpc_bench.analysis.trials import Trials

FIRST, PANEL = 2.4, 1.4  # heights of one panel with its labels, and of a further one [in]
MOST_DOTS = 500
"""Runs beyond the whiskers of all boxes of a panel that are drawn; a file with a million runs would have 10 MB."""
MARGIN = 42.0  # width of the numbers of the axis and its label [pt]


@dataclass(frozen=True, kw_only=True)
class Boxplot(SweepFigure):
    """An upright box per method: median, quartiles, whiskers from 5 to 95 % of the runs, and points beyond them.

    Of more than 500 runs beyond the whiskers in a panel those at equal ranks are drawn.  A box has the colour of the
    verdict, and an arrow where the event of the metric did not occur.  The first 6 points of a sweep are panels on a
    common axis.

    Parameters
    ----------
    metric : name of the metric; the primary one if not given
    log : logarithmic axis, linear with a remark if a value is not positive; `auto` where the largest value exceeds 20
        times the smallest
    height : height of the whole picture [in]; if not given 2.4, 1.4 per further point of a sweep, more for long names
    order : methods to show, from left to right; all if not given
    at : points of the sweep, from top to bottom, each by values of its paths (default: the first 6)
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    metric: str | None = None
    log: Log = "auto"

    def caption(self, results: Trials) -> str:
        """Define the boxes and count the runs; see `Figure.caption`."""
        tables, words = first_tables(self, self.metric, results)
        runs = runs_sentence([table.trials for table in tables], self.order or results.methods)
        boxes = "median, quartiles, whiskers from 5 to 95 % of the runs, and the runs beyond them"
        return sentence(f"Boxes of {quantity(tables[0].info)}{words}: {boxes}", runs)

    def draw(self, results: Trials) -> MplFigure:
        """Draw the boxes of the points from top to bottom; see `Figure.draw`."""
        from rmpc_bench.figures.row_columns import draw_box

        tables, _ = first_tables(self, self.metric, results)
        first = tables[0]
        rows = [shown_rows(table, first, self.order) for table in tables]
        values = [[_values(table, row.method) for row in shown] for table, shown in zip(tables, rows, strict=True)]
        filled = [column for panel in values for column in panel if len(column)]
        axis = scaled_axis([float(end) for column in filled for end in (column.min(), column.max())], self.log)
        with style():
            slot = (self.size(1.0)[0] * POINTS_PER_INCH - MARGIN) / len(rows[0])
            names, how, tall = names_of_columns([name_of(first.trials, row.method) for row in rows[0]], slot)
            size = self.size(FIRST + PANEL * (len(tables) - 1) + max(0.0, tall / POINTS_PER_INCH - 0.3))
            figure = new_figure(size)
            panels = list(figure.subplots(len(tables), sharex=True, sharey=True, squeeze=False)[:, 0])
            for axes, table, shown, columns in zip(panels, tables, rows, values, strict=True):
                set_axis(axes, axis, upright=True)
                for place, (row, column) in enumerate(zip(shown, columns, strict=True)):
                    draw_box(axes, row, place, axis, upright=True)
                    _draw_beyond(axes, column, row.quantiles, place, f"method-{row.method}", len(shown))
                if len(tables) > 1 or table.trials.point:
                    title = wrapped(literal(short_title(table.trials)), 0.8 * size[0] * POINTS_PER_INCH)
                    axes.set_title("\n".join(title))
            panels[-1].set_xlim(-0.6, len(names) - 0.4)
            panels[-1].set_xticks(range(len(names)), names, **how)
            for axes in panels:
                axes.tick_params(axis="x", length=0)
            for label, row in zip(panels[-1].get_xticklabels(), rows[0], strict=True):
                label.set_gid(f"method-{row.method}")
            remark = LINEAR if self.log is True and not axis.log else ""
            text = "\n".join(wrapped(metric_label(first.info) + remark, 0.8 * size[1] * POINTS_PER_INCH))
            (panels[0].set_ylabel if len(panels) == 1 else figure.supylabel)(text, fontsize=FONT_SIZE)
            fix_layout(figure)
        return figure


def _values(table: ResultTable, method: str) -> Array:
    values = table.trials.column(table.info.name, method)
    return np.clip(values[np.isfinite(values)], -FAR, FAR)


def _draw_beyond(axes: Axes, values: Array, quantiles: Sequence[float], place: float, gid: str, n_boxes: int) -> None:
    """Draw the runs beyond the whiskers, of too many those at equal ranks."""
    if not quantiles:
        return
    beyond = np.sort(np.concatenate([values[values < quantiles[0]], values[values > quantiles[-1]]]))
    most = max(2, MOST_DOTS // n_boxes)
    if len(beyond) > most:
        beyond = beyond[np.linspace(0, len(beyond) - 1, most).round().astype(np.int64)]
    if len(beyond):
        look: dict[str, Any] = {"ls": "", "marker": "o", "ms": 1.8, "mew": 0, "color": DIM, "gid": gid}
        axes.plot(np.full(len(beyond), place), beyond, **look)
