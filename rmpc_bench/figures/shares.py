"""Shares of runs in which something happens, such as a runaway: one row per method, with Wilson intervals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import wilson
from rmpc_bench.figures.axes import stacked_panels
from rmpc_bench.figures.captions import joined, label_of, runs_sentence, sentences
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, metric_of, typeset, with_unit, wrapped
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import LineStyle, line_styles
from rmpc_bench.figures.shared_content import shared_content
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.figures.sweep_points import points_at, short_title
from rmpc_bench.types import Array, MetricInfo, ResultLayout
from rmpc_bench.types.figure import SweepFigure
from rmpc_bench.types.issue import Issue

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.lines import Line2D

    from rmpc_bench.analysis.trials import Trials

MOST_ROWS = 48
"""Rows that fit below each other."""
ROW, GAP, MARGINS = 0.17, 0.1, 0.75
"""Heights of a row, between the points of a sweep, and of everything else [in]."""
LABEL_SHARE = 0.35
"""Share of the width that the name of a row may take before it is broken."""
ROOM = 0.04
"""Space at the ends of the axis, as a share of it."""


@dataclass(frozen=True, kw_only=True)
class Shares(SweepFigure):
    """Share of the runs in which a metric is larger than a number, one row per method, with Wilson intervals.

    For a metric that is 0 or 1, such as `runaway`, it is the share of the runs in which it is 1.  For the share of
    samples beyond a limit it is the share of the runs that exceed the limit at all.  Every row shows the share as a
    mark, its interval as a bar, and the counts.  In a sweep the rows of a point lie together.  Failed runs are left out
    and named in the caption, since they have no value.

    Parameters
    ----------
    metric : name of the metric; the primary one if not given
    above : a run counts if its value is larger than this number
    label : text of the axis; made from the metric if not given
    height : height of the whole picture [in]; if not given it follows from the number of rows
    order : methods to show, from top to bottom; all if not given
    at : points of the sweep to show, each by values of its paths; all if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    metric: str | None = None
    above: float = 0.0
    label: str | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: no more rows than fit."""
        yield from super().check(layout)
        n_rows = max(1, layout.n_points_at(self.at)) * len(self.order or layout.methods)
        advice = "choose points with `at` or methods with `order`"
        yield from layout.require_at_most(MOST_ROWS, n_rows, "rows", "at" if layout.points else "order", advice)

    def draw(self, results: Trials) -> MplFigure:
        """Draw all rows; see `Figure.draw`."""
        return _draw(self, results, self._content(results))

    def caption(self, results: Trials) -> str:
        """Say what marks and bars are, and state the largest share; see `Figure.caption`."""
        content = self._content(results)
        known = [row for row in content.rows if row.n]
        largest = max(known, key=lambda row: row.share, default=None)
        none = [_name(results, row) for row in known if not row.n_above]
        of_none = max((row.high for row in known if not row.n_above), default=0.0)
        return sentences(
            f"Share of the runs: {content.words}. Marks are the shares, bars their "
            f"{100 * results.confidence:g} % Wilson intervals, and the numbers count runs",
            ""
            if largest is None or not largest.n_above
            else f"Largest share: {_name(results, largest)}, {largest.text}",
            f"In no run: {joined(none)} (upper end of the interval at most {100 * of_none:.2g} %)" if none else "",
            runs_sentence(content.points, content.methods),
        )

    def _content(self, results: Trials) -> SharesContent:
        return shared_content(results, self, lambda: self._compute(results))

    def _compute(self, results: Trials) -> SharesContent:
        """Count the runs."""
        layout = layout_checked(self, results)
        info, points = metric_of(results, self.metric), points_at(results, self.at)
        methods = [name for name in self.order or layout.methods if name in layout.methods]
        words = _words(info, self.above, [point.column(info.name, name) for point in points for name in point.methods])
        rows = [
            _row(point, name, info, self.above, short_title(point) if len(points) > 1 else "")
            for point in points
            for name in methods
            if name in point.methods
        ]
        return SharesContent(info, words, points, methods, rows)


class Row(NamedTuple):
    """The share of a method at a point of the sweep."""

    point: str
    """Title of the point; empty if there is only one."""
    method: str
    n_above: int
    n: int
    """Runs with a value."""
    low: float
    high: float

    @property
    def share(self) -> float:
        """The share of the runs that count; NaN without a run."""
        return self.n_above / self.n if self.n else math.nan

    @property
    def text(self) -> str:
        """The counts."""
        return f"{self.n_above} of {self.n}" if self.n else "no value"


class SharesContent(NamedTuple):
    """What the figure shows."""

    info: MetricInfo
    words: str
    """What happens in the runs that count."""
    points: Sequence[Trials]
    methods: Sequence[str]
    rows: Sequence[Row]


def layout_checked(keys: Shares, results: Trials) -> ResultLayout:
    """Return the layout of the results, which satisfy the figure."""
    from rmpc_bench.analysis.layout import layout_of

    layout = layout_of(results)
    keys.require(layout)
    return layout


def _words(info: MetricInfo, above: float, columns: Sequence[Array]) -> str:
    """Say what happens in the runs that count: the metric if it is 0 or 1, else the metric and the number."""
    values = np.concatenate(columns) if columns else np.zeros(0)
    if above == 0.0 and np.isin(values[~np.isnan(values)], (0.0, 1.0)).all():
        return info.words
    return f"{info.words} above {above:g} {info.unit}".rstrip()


def _row(point: Trials, method: str, info: MetricInfo, above: float, title: str) -> Row:
    values = point.column(info.name, method)
    known = values[~np.isnan(values)]
    count = int(np.count_nonzero(known > above))
    return Row(title, method, count, len(known), *wilson(count, len(known), point.confidence))


def _name(results: Trials, row: Row) -> str:
    label = label_of(results, row.method)
    return f"{label} at {row.point}" if row.point else label


def _draw(keys: Shares, results: Trials, content: SharesContent) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure

    titles = list(dict.fromkeys(row.point for row in content.rows))
    size = keys.size(MARGINS + ROW * len(content.rows) + GAP * (len(titles) - 1))
    styles = line_styles(results.all_methods, content.methods)
    y = _places(content.rows)
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        (axes,) = stacked_panels(figure, 1)
        for place, row in zip(y, content.rows, strict=True):
            look = styles[row.method]
            if row.n:
                axes.hlines(place, 100 * row.low, 100 * row.high, color=look.color, lw=1.0, zorder=2.4, gid=look.gid)
                axes.plot(100 * row.share, place, ls="", color=look.color, zorder=2.6, gid=look.gid, **_mark(look))
        _name_rows(axes, results, content, y, LABEL_SHARE * size[0] * POINTS_PER_INCH)
        _counts(axes, content.rows, y)
        high = 100 * max((row.high for row in content.rows if row.n), default=1.0)
        axes.set_xlim(-ROOM * high, (1.0 + ROOM) * high)
        label = typeset(keys.label) if keys.label is not None else f"share of runs: {typeset(content.words)}"
        axes.set_xlabel("\n".join(wrapped(with_unit(label, "%"), 0.6 * size[0] * POINTS_PER_INCH)))
        handles: list[Handle] = []
        if len(titles) > 1:
            handles = [(results.labels.get(name, name), _sample(styles[name])) for name in content.methods]
        n = sorted({row.n for row in content.rows})
        runs = f"{n[0]}" if len(n) == 1 else f"{n[0]} to {n[-1]}"
        finish(figure, handles, f"bars: {100 * results.confidence:g} % Wilson intervals, {runs} runs")
    return figure


def _places(rows: Sequence[Row]) -> list[float]:
    """Return the vertical positions of the rows, in rows from the top; the points of a sweep lie apart."""
    places: list[float] = []
    for number, row in enumerate(rows):
        apart = 1.0 + (GAP / ROW) * (number > 0 and row.point != rows[number - 1].point)
        places.append(places[-1] + apart if places else 0.0)
    return places


def _name_rows(axes: Axes, results: Trials, content: SharesContent, y: Sequence[float], limit: float) -> None:
    """Name every row by its method, or the rows of every point by its title."""
    groups: dict[str, list[float]] = {}
    for place, row in zip(y, content.rows, strict=True):
        groups.setdefault(row.point, []).append(place)
    if len(groups) > 1:
        names: Mapping[str, float] = {literal(title): float(np.mean(places)) for title, places in groups.items()}
        for before, after in zip(list(groups.values())[:-1], list(groups.values())[1:], strict=True):
            axes.axhline((before[-1] + after[0]) / 2, color=REFERENCE, lw=0.3, zorder=0.5)
        ticks, texts = list(names.values()), list(names)
    else:
        ticks, texts = list(y), [typeset(results.labels.get(row.method, row.method)) for row in content.rows]
    axes.set_yticks(ticks, ["\n".join(wrapped(text, limit)) for text in texts])
    axes.set_ylim(max(y, default=0.0) + 0.6, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")


def _counts(axes: Axes, rows: Sequence[Row], y: Sequence[float]) -> None:
    """Write the counts to the right of the axis."""
    for place, row in zip(y, rows, strict=True):
        axes.annotate(
            row.text, (1.02, place), xycoords=axes.get_yaxis_transform(), va="center", ha="left", annotation_clip=False
        )


def _mark(look: LineStyle) -> dict[str, Any]:
    return {"marker": look.marker, "ms": 3.5, "mew": 0.6}


def _sample(look: LineStyle) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=look.color, ls="-", lw=1.0, gid=look.gid, **_mark(look))
