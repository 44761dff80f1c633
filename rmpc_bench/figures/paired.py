"""Paired change of a metric for every method against the baseline, with interval and margin of relevance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import drawable, stacked_panels
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, metric_of, typeset, wrapped
from rmpc_bench.figures.legend import finish
from rmpc_bench.figures.line_styles import line_styles
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.figures.sweep_points import MOST_PANELS, points_at, short_title
from rmpc_bench.types import DesignError, MetricInfo, ResultLayout
from rmpc_bench.types.figure import SweepFigure
from rmpc_bench.types.issue import Issue

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.comparison import Levels
    from rmpc_bench.analysis.trials import Trials

BAND = "#ebebeb"
"""Colour of the margin of relevance, paler than the grid."""
ROW, PANEL = 0.24, 0.42
"""Height of a row, and of a panel without its rows [in]."""
LABEL_SHARE = 0.3
"""Share of the width that the name of a method may take before it is broken."""
MARKER: dict[str, Any] = {"marker": "o", "ms": 4.0, "ls": ""}
COUNTS_BOX: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
"""Box of the runs won, lost and tied, in front of band and grid."""


@dataclass(frozen=True, kw_only=True)
class Paired(SweepFigure):
    """Change of a metric against the baseline in per cent, one row per method, with its confidence interval.

    A run is compared with the baseline's run of the same index.  The change is that of the summary table, with the
    experiment's level of confidence.  The grey band is the margin of relevance: changes inside it count as tied.  If
    the change in per cent is not defined, for example if some run did not settle, the row gives the runs won, lost and
    tied.  The points of a sweep are panels with a common axis, one below the other.

    Parameters
    ----------
    metric : name of the metric; the primary one if not given
    height : height of the whole picture [in]; if not given 0.5 plus 0.42 for every panel plus 0.24 for every row
    order : methods to show, from top to bottom, the baseline left out; all if not given
    at : points of the sweep to show, from top to bottom, each by values of its paths; all (6 at most) if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    metric: str | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: a method besides the baseline, and no more points than panels fit."""
        yield from super().check(layout)
        if len(layout.methods) < 2:
            yield Issue("", "compares methods with the baseline: needs at least two methods")
        n = layout.n_points_at(self.at)
        yield from layout.require_at_most(MOST_PANELS, n, "points of the sweep", "at", "choose some with `at`")

    def draw(self, results: Trials) -> MplFigure:
        """Draw the changes at the points from top to bottom; see `Figure.draw`."""
        self.require(layout_of(results))
        points, info = points_at(results, self.at), metric_of(results, self.metric)
        methods = [name for name in self.order or results.methods if name != results.baseline]
        if not methods:
            raise DesignError(f"must name a method besides the baseline '{results.baseline}'", "order")
        size = self.size(0.5 + len(points) * (PANEL + ROW * len(methods)))
        return _draw(results, points, info, methods, size)


class Change(NamedTuple):
    """Change of a method against the baseline [%], NaN if it is not defined, and its runs."""

    method: str
    change: float
    low: float
    high: float
    """Ends of the interval."""
    counts: str
    """Runs won, lost and tied."""
    n_pairs: int


def changes_of(point: Trials, info: MetricInfo, methods: Sequence[str], of: Levels | None = None) -> list[Change]:
    """Compare methods with the baseline.

    Parameters
    ----------
    point : the table that is shown
    info : the metric
    methods : methods to show, without the baseline
    of : levels of the intervals of the experiment; of this table alone unless given
    """
    from rmpc_bench.analysis.comparison import comparisons

    rows = comparisons(replace(point, metrics=(info,), primary=point.primary or point.metrics[0].name), of)
    rows = rows.set_index("method")
    found = []
    for name in methods:
        row = rows.loc[name]
        change, low, high = (float(row[key]) for key in ("change_pct", "ci_low", "ci_high"))
        counts = f"{row['won']} won, {row['lost']} lost, {row['tied']} tied"
        found.append(Change(name, change, low, high, counts, int(row["n_pairs"])))
    return found


def _draw(
    results: Trials, points: Sequence[Trials], info: MetricInfo, methods: Sequence[str], size: tuple[float, float]
) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from rmpc_bench.analysis.comparison import levels
    from rmpc_bench.analysis.pairs import name_of_distance

    first, of = points[0], levels(results)
    margin, level = 100 * first.relevant, 100 * first.confidence
    limit = size[0] * POINTS_PER_INCH
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels = stacked_panels(figure, len(points))
        for axes, point in zip(panels, points, strict=True):
            changes = changes_of(point, info, methods, of)
            axes.axvspan(-margin, margin, color=BAND, lw=0, zorder=0.2)
            axes.axvline(0.0, color=REFERENCE, lw=0.9, zorder=2.0)
            _draw_rows(axes, point, changes)
            axes.set_yticks(range(len(methods)), [_label(point, name, LABEL_SHARE * limit) for name in methods])
            axes.set_ylim(len(methods) - 0.5, -0.5)
            title = ", ".join(filter(None, [short_title(point), _runs(changes)]))
            axes.set_title("\n".join(wrapped(literal(title), 0.7 * limit)))
        better = "higher" if info.direction == "higher" else "lower"
        name = literal(name_of_distance(info))
        text = wrapped(f"change of {name} against {literal(first.baseline)} [%]", 0.7 * limit)
        panels[-1].set_xlabel("\n".join([*text, f"({better} is better)"]))
        interval = Line2D([], [], color=REFERENCE, lw=1.3, **{**MARKER, "ls": "-"})
        band = Patch(facecolor=BAND, edgecolor="none")
        finish(figure, [(f"{level:g} % interval", interval), (f"within {margin:g} %", band)])
    return figure


def _draw_rows(axes: Axes, point: Trials, changes: Sequence[Change]) -> None:
    """Draw change and interval of every method, or the runs won, lost and tied if there is no change in per cent."""
    styles = line_styles(point.methods, [each.method for each in changes])
    for row, each in enumerate(changes):
        color = styles[each.method].color
        if not np.isfinite(each.change):
            # They have no place on the axis of per cent, and need all of its width.
            place = axes.get_yaxis_transform()
            axes.text(0.5, row, each.counts, transform=place, ha="center", va="center", color=color, bbox=COUNTS_BOX)
            continue
        ends = drawable(np.array([each.low, each.high]))
        axes.plot(ends, [row, row], color=color, lw=1.3, zorder=2.5)
        axes.plot(drawable(np.array([each.change])), [row], color=color, zorder=2.6, **MARKER)


def _label(point: Trials, name: str, limit: float) -> str:
    return "\n".join(wrapped(typeset(point.labels.get(name, name)), limit))


def _runs(changes: Sequence[Change]) -> str:
    """Count the paired runs; as a range where methods have different numbers of them."""
    counts = [each.n_pairs for each in changes]
    least, most = min(counts), max(counts)
    if least < most:
        return f"{least} to {most} paired runs"
    return "1 paired run" if most == 1 else f"{most} paired runs"
