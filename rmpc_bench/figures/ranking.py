"""Where the ranking turns along a swept number: change of every method from the baseline, and share of failed runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from rmpc_bench.analysis.comparison_text import AVERAGE_WORDS
from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import drawable, few_ticks, stacked_panels
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, metric_of, with_unit, wrapped
from rmpc_bench.figures.legend import Handle, finish
from rmpc_bench.figures.line_styles import LineStyle, line_styles
from rmpc_bench.figures.paired import BAND, band_of
from rmpc_bench.figures.shared_content import shared_content
from rmpc_bench.figures.style import REFERENCE, style
from rmpc_bench.types import Array, DesignError, MetricInfo, ResultLayout
from rmpc_bench.types.figure import SweepFigure
from rmpc_bench.types.issue import Issue, unknown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MplFigure
    from matplotlib.lines import Line2D

    from rmpc_bench.analysis.trials import Trials

APART = 0.012
"""Distance of the intervals of two methods at one place, as a share of the axis."""
PANEL = 1.45


@dataclass(frozen=True, kw_only=True)
class Ranking(SweepFigure):
    """Change of a metric against the baseline, and share of failed runs, along a swept number.

    The upper panel shows the paired change of every method with its confidence interval, as in comparisons.csv; the
    grey band is the margin of relevance.  Where a line crosses 0 the ranking of the method and the baseline turns.  The
    lower panel shows the share of failed runs of every method, the baseline included, with Wilson intervals; it is left
    out where no run failed.  With
    ``uncertainty.scale`` as the swept path the figure shows how much uncertainty the ranking stands.

    Parameters
    ----------
    path : swept path of the horizontal axis, a number at all points; the only one with numbers if not given
    metric : name of the metric; the primary one if not given
    height : height of the whole picture [in]; if not given 3.5, and more for a legend of several lines
    order : methods to show; all if not given
    at : points of the sweep to show, each by values of its paths; all other paths must have one value in them
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    path: str | None = None
    metric: str | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: two methods, and a swept path of numbers."""
        yield from super().check(layout)
        if len(layout.methods) < 2:
            yield Issue("", "compares methods with the baseline: needs at least two methods")
        if not layout.points:
            return
        paths = [path for path in layout.points[0] if _is_number([point.get(path, "") for point in layout.points])]
        if self.path is not None and self.path not in paths:
            yield Issue("path", unknown(self.path, paths, "swept path of numbers"))
        elif self.path is None and len(paths) != 1:
            choice = f"one of {', '.join(paths)}" if paths else "there is none in this configuration"
            yield Issue("path", f"must name a swept path of numbers: {choice}")

    def draw(self, results: Trials) -> MplFigure:
        """Draw both panels; see `Figure.draw`."""
        return _draw(self, results, self._content(results))

    def caption(self, results: Trials) -> str:
        """Say what lines, bands and bars are, and between which places a sign turns; see `Figure.caption`."""
        content = self._content(results)
        n = len(content.points[0].runs)
        is_primary = results.with_verdicts and content.info == content.points[0].primary_info
        average = AVERAGE_WORDS[content.kind]
        parts = [
            f"Change of {content.info.name} against {results.baseline} along {content.path} ({average}), {n} runs at "
            f"each of {len(content.places)} points, paired where both methods finished, with "
            f"{'simultaneous ' if is_primary else ''}{100 * results.confidence:g} % intervals"
            f"{'' if is_primary else ' for each point alone'}; grey band: margin of relevance."
        ]
        some_failed = any(point.n_failed(name) for point in content.points for name in content.methods)
        below = "Below: share of failed runs with Wilson intervals." if some_failed else "No run failed."
        parts.append(below)
        for line in content.lines:
            parts.append(f"{line.method}: {_turn_text(line)}.")
        return " ".join(parts)

    def _content(self, results: Trials) -> RankingContent:
        return shared_content(results, self, lambda: self._compute(results))

    def _compute(self, results: Trials) -> RankingContent:
        """Compute what the figure shows."""
        from rmpc_bench.analysis.comparison import levels
        from rmpc_bench.analysis.turning_points import numeric_paths, tracks
        from rmpc_bench.figures.sweep_points import points_at

        layout = layout_of(results)
        self.require(layout)
        info, points = metric_of(results, self.metric), points_at(results, self.at)
        path = self.path or next(iter(numeric_paths(results)))
        others = [{name: value for name, value in point.point.items() if name != path} for point in points]
        if any(each != others[0] for each in others):
            raise DesignError(f"points differ in more than {path}; choose those with one value of the others", "at")
        methods = [name for name in self.order or results.methods if name in results.methods]
        chosen = _Points(results, tuple(points))
        found = [track for track in tracks(chosen.table, path, info, levels(results)) if track.method in methods]
        kind = str(next((row["average"] for track in found for row in track.rows if row["average"]), "geometric"))
        lines = [_line(track.method, track.places, track.rows, kind) for track in found]
        ordered = sorted(points, key=lambda point: float(point.point[path]))
        places = [float(point.point[path]) for point in ordered]
        return RankingContent(path, info, kind, ordered, places, methods, lines)


class _Points(NamedTuple):
    """Some points of a sweep."""

    results: Trials
    points: tuple[Trials, ...]

    @property
    def table(self) -> Trials:
        """The table of the sweep with these points only."""
        from dataclasses import replace

        return replace(self.results, points=self.points)


class Line(NamedTuple):
    """The changes of a method."""

    method: str
    places: Sequence[float]
    values: Sequence[float]
    low: Sequence[float]
    high: Sequence[float]


class RankingContent(NamedTuple):
    """What the figure shows."""

    path: str
    info: MetricInfo
    kind: str
    """Of the average, see `Comparison`."""
    points: Sequence[Trials]
    places: Sequence[float]
    methods: Sequence[str]
    lines: Sequence[Line]


def _turn_text(line: Line) -> str:
    """Say between which places the sign of a change turns, and where it has none."""
    from rmpc_bench.analysis.turning_points import signs, turns

    found = signs(line.low, line.high)
    known = [n for n, value in enumerate(line.values) if value == value]
    if pairs := turns(found):
        words = " and ".join(f"between {line.places[a]:g} and {line.places[b]:g}" for a, b in pairs)
        return f"the sign of the change turns {words}"
    without = [f"{line.places[n]:g}" for n in known if not found[n]]
    if not without:
        return "the change keeps its sign"
    return f"no turn is resolved; the interval of the change contains 0 at {', '.join(without)}"


def _line(method: str, places: Sequence[float], rows: Sequence[object], kind: str) -> Line:
    names = ("difference", "difference_low", "difference_high")
    names = names if kind == "difference" else ("change_pct", "ci_low", "ci_high")
    columns = [[float(row[name]) for row in rows] for name in names]  # type: ignore[index]
    return Line(method, places, *columns)


def _is_number(texts: Sequence[str]) -> bool:
    try:
        values = {float(text) for text in texts}
    except ValueError:
        return False
    return len(values) > 1 and all(np.isfinite(value) for value in values)


def _draw(keys: Ranking, results: Trials, content: RankingContent) -> MplFigure:
    from matplotlib.figure import Figure as MplFigure

    some_failed = any(point.n_failed(name) for point in content.points for name in content.methods)
    size = keys.size(0.6 + (1 + some_failed) * PANEL)
    styles = line_styles(results.all_methods, list(content.methods))
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels = stacked_panels(figure, 1 + some_failed)
        _changes(panels[0], content, styles)
        if some_failed:
            _failures(panels[1], content, styles)
        panels[-1].set_xlabel("\n".join(wrapped(literal(content.path), 0.7 * size[0] * POINTS_PER_INCH)))
        n = len(content.points[0].runs)
        shown = [name for name in content.methods if some_failed or name != results.baseline]
        handles: list[Handle] = [(results.labels.get(name, name), _sample(styles[name])) for name in shown]
        finish(figure, handles, f"{n} paired runs at each point" + ("" if some_failed else ", none failed"))
    return figure


def _sample(look: LineStyle) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], marker=look.marker, ms=3.0, **look.line())


def _changes(axes: Axes, content: RankingContent, styles: dict[str, LineStyle]) -> None:
    """Draw the change of every method with its interval, and the margin of relevance."""
    point = content.points[0]
    band = band_of(point, content.info, content.kind)
    if band[1] > 0:
        axes.axhspan(*band, color=BAND, lw=0, zorder=0.2)
    axes.axhline(0.0, color=REFERENCE, lw=0.9, zorder=2.0)
    for place, line in enumerate(content.lines):
        look = styles[line.method]
        x = _moved(content, line.places, place, len(content.lines))
        bar: dict[str, Any] = {"color": look.color, "lw": 0.9, "gid": look.gid}
        axes.plot(x, drawable(np.array(line.values)), marker=look.marker, ms=3.0, **look.line())
        axes.vlines(x, drawable(np.array(line.low)), drawable(np.array(line.high)), **bar)
    unit = content.info.unit if content.kind == "difference" else "%"
    label = with_unit(literal(f"change of {content.info.name} against {point.baseline}"), unit)
    axes.set_ylabel("\n".join(wrapped(label, 1.2 * POINTS_PER_INCH)))
    few_ticks(axes)


def _failures(axes: Axes, content: RankingContent, styles: dict[str, LineStyle]) -> None:
    """Draw the share of failed runs of every method with Wilson intervals."""
    from rmpc_bench.analysis.intervals import wilson
    from rmpc_bench.analysis.turning_points import failed_shares

    largest = 0.0
    for place, method in enumerate(content.methods):
        counts = failed_shares(content.points, method)
        ends = 100 * np.array([wilson(failed, n, content.points[0].confidence) for failed, n in counts])
        shares = 100 * np.array([failed / n if n else np.nan for failed, n in counts])
        look, x = styles[method], _moved(content, content.places, place, len(content.methods))
        axes.plot(x, shares, marker=look.marker, ms=3.0, **look.line())
        axes.vlines(x, ends[:, 0], ends[:, 1], color=look.color, lw=0.9, gid=look.gid)
        largest = max(largest, float(np.nanmax(ends, initial=0.0)))
    axes.set_ylim(-0.03 * max(largest, 1.0), 1.05 * max(largest, 1.0))
    axes.set_ylabel("failed runs [%]")
    few_ticks(axes)


def _moved(content: RankingContent, places: Sequence[float], number: int, n: int) -> Array:
    """Move the marks of a method aside, so that intervals at one place do not coincide."""
    reach = APART * (max(content.places) - min(content.places))
    return np.array(places) + (number - (n - 1) / 2) * reach
