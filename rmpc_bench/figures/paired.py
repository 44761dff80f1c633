"""Paired change of a metric for every method against the baseline, with interval and margin of relevance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from rmpc_bench.analysis.comparison_text import AVERAGE_WORDS
from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import FAR, drawable, scale_by_ratio, stacked_panels
from rmpc_bench.figures.captions import changes_sentence, joined, label_of, quantity, sentences
from rmpc_bench.figures.compared_rows import compared_rows
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, metric_of, typeset, with_unit, wrapped
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import line_styles
from rmpc_bench.figures.method_groups import name_ticks
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
ROW, PANEL, LINE = 0.24, 0.42, 0.14
"""Height of a row, of a panel without its rows, and of a line of the label below that has more than two [in]."""
LABEL_SHARE = 0.3
"""Share of the width that the name of a method may take before it is broken."""
WIDE = 10.0
"""Factor between the smallest and the largest ratio from which on equal ratios have equal lengths."""
MARKER: dict[str, Any] = {"ms": 4.0, "ls": ""}
MARKERS = {"geometric": "o", "mean": "s", "difference": "o"}
OFFSETS = {0: (), 1: (0.0,), 2: (-0.16, 0.16)}
"""Vertical positions of the averages within a row, in rows."""
COUNTS_BOX: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
"""Box of the runs won, lost and tied, in front of band and grid."""


@dataclass(frozen=True, kw_only=True)
class Paired(SweepFigure):
    """Change of a metric against the baseline, one row per method, with its confidence interval.

    A run is compared with the baseline's run of the same index.  Change and interval are those of the summary table, so
    they are those of the verdict.  A circle is the geometric mean of the paired ratios in per cent, a square the ratio
    of the means.  The square is added where its sign contradicts the circle.  A signed metric has its mean difference
    in its own unit.  The grey band is the margin of the verdict: for a relative change d it extends from -d/(1+d) to d,
    so that it is the same for exchanged methods.  If no average is defined, for example if some run did not settle, the
    row gives the runs won, lost and tied.  The points of a sweep are panels with a common axis, one below the other.
    Where changes differ by more than a factor of ten, equal ratios have equal lengths on this axis.

    Parameters
    ----------
    metric : name of the metric; the primary one if not given
    height : height of the whole picture [in]; if not given 0.5 plus 0.42 for every panel plus 0.24 for every row, and
        more for long labels
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

    def caption(self, results: Trials) -> str:
        """Define markers, intervals and band, and state the changes with their verdicts; see `Figure.caption`."""
        from rmpc_bench.analysis.comparison import levels

        points, info = points_at(results, self.at), metric_of(results, self.metric)
        methods = [name for name in self.order or results.methods if name != results.baseline]
        of = levels(results)
        changes = [changes_of(point, info, methods, of) for point in points]
        kinds = _kinds(changes)
        marks = {"geometric": "circles", "mean": "squares", "difference": "circles"}
        averages = joined(f"{AVERAGE_WORDS[kind]} ({marks[kind]})" for kind in kinds)
        interval = _level(points[0], changes)
        margin = _margin_text(points[0], info, kinds)
        texts = []
        for point in points:
            title = short_title(point) if len(points) > 1 else ""
            texts.append(changes_sentence(point, methods, info, of, title=title))
        return sentences(
            f"Paired change of {quantity(info)} against {label_of(results, results.baseline)}: a run of a method is "
            "compared with the run of the baseline that has the same index",
            f"Markers are the {averages}, lines the {interval}s" if kinds else "",
            f"The grey band is the margin of relevance, {margin}" if margin else "",
            joined(_runs(point, rows) for point, rows in zip(points, changes, strict=True)) if len(points) == 1 else "",
            *texts,
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw the changes at the points from top to bottom; see `Figure.draw`."""
        from rmpc_bench.analysis.comparison import levels

        self.require(layout_of(results))
        points, info = points_at(results, self.at), metric_of(results, self.metric)
        methods = [name for name in self.order or results.methods if name != results.baseline]
        if not methods:
            raise DesignError(f"must name a method besides the baseline '{results.baseline}'", "order")
        of = levels(results)
        changes = [changes_of(point, info, methods, of) for point in points]
        kinds = _kinds(changes)
        label = _axis_label(points[0], info, kinds, 0.6 * self.width * POINTS_PER_INCH)
        row = max(ROW, LINE * (0.3 + _most_lines(points[0], methods, LABEL_SHARE * self.width * POINTS_PER_INCH)))
        size = self.size(0.5 + LINE * max(0, len(label) - 2) + len(points) * (PANEL + row * len(methods)))
        return _draw(points, info, changes, kinds, label, size)


class Average(NamedTuple):
    """An average change with the ends of its interval, in per cent or in the unit of a signed metric."""

    kind: str
    """``geometric``, ``mean`` or ``difference``."""
    value: float
    low: float
    high: float


class Change(NamedTuple):
    """Comparison of a method with the baseline."""

    method: str
    averages: Sequence[Average]
    """The one that the verdict rests on, and a second one of the opposite sign; empty where none is defined."""
    counts: str
    """Runs won, lost and tied."""
    n_pairs: int
    simultaneous: bool
    """Whether the interval holds together with those of other comparisons."""


def changes_of(point: Trials, info: MetricInfo, methods: Sequence[str], of: Levels | None = None) -> list[Change]:
    """Compare methods with the baseline; levels of intervals are those of this table alone unless `of` is given."""
    compared = compared_rows(point, info, of)
    found = []
    for method in methods:
        row = compared.get(method)
        if row is None:
            # An interrupted sweep has no run of some methods at some points.
            found.append(Change(method, (), "no runs", 0, False))
            continue
        counts = f"{row['won']} won, {row['lost']} lost, {row['tied']} tied"
        together = float(row["ci_level"]) > point.confidence
        found.append(Change(row["method"], _averages(row), counts, int(row["n_pairs"]), together))
    return found


def _averages(row: Mapping[str, Any]) -> list[Average]:
    """Return the average of the verdict, and the other one where its sign contradicts it."""
    if row["average"] == "difference":
        return [Average("difference", *(float(row[f"difference{end}"]) for end in ("", "_low", "_high")))]
    kinds = sorted(("geometric", "mean"), key=lambda kind: kind != row["average"])
    found = [Average(kind, *(float(row[f"{kind}_{end}"]) for end in ("pct", "low", "high"))) for kind in kinds]
    found = [average for average in found if np.isfinite(average.value)]
    return found if len(found) == 2 and found[0].value * found[1].value < 0 else found[:1]


def band_of(point: Trials, info: MetricInfo, kind: str) -> tuple[float, float]:
    """Return lower and upper end of the margin of a verdict for a kind of `Average`.

    They are in per cent or in the unit of a signed metric, which has 0 without a margin of its own.
    """
    if kind == "difference":
        d = point.relevant_of(info.name, default=0.0)
        return -d, d
    d = point.relevant_of(info.name)
    return -100 * d / (1 + d), 100 * d


def _kinds(changes: Sequence[Sequence[Change]]) -> list[str]:
    """Return the averages that the common axis shows.

    Per cent and the unit of a signed metric have no common axis: of a metric with negative values at one point only the
    other points show the runs won, lost and tied.
    """
    found = {average.kind for rows in changes for each in rows for average in each.averages}
    return ["difference"] if "difference" in found else [kind for kind in AVERAGE_WORDS if kind in found]


def _draw(
    points: Sequence[Trials],
    info: MetricInfo,
    changes: Sequence[Sequence[Change]],
    kinds: Sequence[str],
    label: Sequence[str],
    size: tuple[float, float],
) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.patches import Patch

    limit = size[0] * POINTS_PER_INCH
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels = stacked_panels(figure, len(points))
        for axes, point, rows in zip(panels, points, changes, strict=True):
            band = band_of(point, info, kinds[0] if kinds else "geometric")
            axes.axvspan(*band, color=BAND, lw=0, zorder=0.2)
            axes.axvline(0.0, color=REFERENCE, lw=0.9, zorder=2.0)
            _draw_rows(axes, point, rows, kinds)
            axes.set_yticks(range(len(rows)), [_label(point, each.method, LABEL_SHARE * limit) for each in rows])
            styles = line_styles(point.all_methods, [each.method for each in rows])
            name_ticks(axes, [styles[each.method].gid for each in rows])
            axes.set_ylim(len(rows) - 0.5, -0.5)
            title = ", ".join(filter(None, [short_title(point), _runs(point, rows)]))
            axes.set_title("\n".join(wrapped(literal(title), 0.7 * limit)))
        if limits := _wide_limits(changes, kinds):
            scale_by_ratio(panels[-1], *limits)
        panels[-1].set_xlabel("\n".join(label))
        band_key: Handle = (_margin_text(points[0], info, kinds), Patch(facecolor=BAND, edgecolor="none"))
        finish(figure, [*_keys(points[0], changes, kinds), *([band_key] if band_key[0] else [])])
    return figure


def _wide_limits(changes: Sequence[Sequence[Change]], kinds: Sequence[str]) -> tuple[float, float] | None:
    """Return the ends of all intervals and 0 where their ratios are so far apart that most of them would coincide."""
    if "difference" in kinds:
        return None
    averages = [average for rows in changes for each in rows for average in each.averages]
    ends = np.array([[each.value, each.low, each.high] for each in averages]).ravel()
    ratios = np.append(drawable(1 + ends[~np.isnan(ends)] / 100), 1.0)
    low, high = max(float(ratios.min()), 1 / FAR), float(ratios.max())
    return (100 * (low - 1), 100 * (high - 1)) if high > WIDE * low else None


def _keys(point: Trials, changes: Sequence[Sequence[Change]], kinds: Sequence[str]) -> list[Handle]:
    """Explain the markers; with two averages each has its name here, else the label of the axis names it."""
    from matplotlib.lines import Line2D

    level = _level(point, changes)
    line: dict[str, Any] = {"color": REFERENCE, "lw": 1.3, "ms": MARKER["ms"]}
    if len(kinds) < 2:
        return [(level, Line2D([], [], marker=MARKERS[kinds[0] if kinds else "geometric"], **line))]
    markers: list[Handle] = [
        (AVERAGE_WORDS[kind], Line2D([], [], marker=MARKERS[kind], **line, ls="")) for kind in kinds
    ]
    return [*markers, (level, Line2D([], [], **line))]


def _level(point: Trials, changes: Sequence[Sequence[Change]]) -> str:
    """Name the intervals."""
    together = "simultaneous " if any(each.simultaneous for rows in changes for each in rows) else ""
    return f"{together}{100 * point.confidence:g} % interval"


def _axis_label(point: Trials, info: MetricInfo, kinds: Sequence[str], limit: float) -> list[str]:
    """Name what is compared, the average if there is only one, and the better side, in lines of `limit` points."""
    from rmpc_bench.analysis.pairs import name_of_distance

    better = "higher" if info.direction == "higher" else "lower"
    name, baseline = typeset(name_of_distance(info, info.words)), literal(point.baseline)
    signed = "difference" in kinds
    quantity = with_unit(f"difference of {name} from {baseline}", info.unit) if signed else ""
    lines = wrapped(quantity or f"change of {name} against {baseline} [%]", limit)
    average = f"{AVERAGE_WORDS[kinds[0]]}; " if len(kinds) == 1 and not signed else ""
    return [*lines, *wrapped(f"({average}{better} is better)", limit)]


def _margin_text(point: Trials, info: MetricInfo, kinds: Sequence[str]) -> str:
    """Explain the band; empty where it has no width."""
    signed = "difference" in kinds
    d = point.relevant_of(info.name, default=0.0 if signed else None)
    text = f"within {d:g} {info.unit}".rstrip() if signed else f"within {100 * d:g} %"
    return text if d else ""


def _draw_rows(axes: Axes, point: Trials, changes: Sequence[Change], kinds: Sequence[str]) -> None:
    """Draw averages and intervals of every method, or the runs won, lost and tied if there is no average."""
    styles = line_styles(point.all_methods, [each.method for each in changes])
    for row, each in enumerate(changes):
        color, gid = styles[each.method].color, styles[each.method].gid
        averages = [average for average in each.averages if average.kind in kinds]
        if not averages:
            # They have no place on the axis of per cent, and need all of its width.
            place = axes.get_yaxis_transform()
            middle: dict[str, Any] = {"ha": "center", "va": "center", "transform": place}
            axes.text(0.5, row, each.counts, color=color, bbox=COUNTS_BOX, gid=gid, **middle)
        for average, offset in zip(averages, OFFSETS[len(averages)], strict=True):
            ends, y = drawable(np.array([average.low, average.high])), row + offset
            axes.plot(ends, [y, y], color=color, lw=1.3, zorder=2.5, gid=gid)
            marker = {**MARKER, "marker": MARKERS[average.kind]}
            axes.plot(drawable(np.array([average.value])), [y], color=color, zorder=2.6, gid=gid, **marker)


def _label(point: Trials, name: str, limit: float) -> str:
    return "\n".join(wrapped(typeset(point.labels.get(name, name)), limit))


def _most_lines(point: Trials, methods: Sequence[str], limit: float) -> int:
    """Count the lines of the longest label."""
    return max(_label(point, name, limit).count("\n") + 1 for name in methods)


def _runs(point: Trials, changes: Sequence[Change]) -> str:
    """Count the paired runs, as a range where methods have different numbers of them, and the failed ones."""
    counts = [each.n_pairs for each in changes]
    least, most = min(counts), max(counts)
    text = f"{least} to {most} paired runs" if least < most else f"{most} paired run{'s' * (most != 1)}"
    failed = {name: point.n_failed(name) for name in (point.baseline, *(each.method for each in changes))}
    names = [f"{name} {n}" for name, n in failed.items() if n]
    return f"{text}, failed: {', '.join(names)}" if names else text
