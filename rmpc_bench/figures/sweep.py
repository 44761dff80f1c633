"""Changes against the baseline, or values of a metric, over a sweep: lines over numbers, cells over names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.axes import Log
from rmpc_bench.figures.labels import metric_of, sentence
from rmpc_bench.figures.points import points_at, tables_of
from rmpc_bench.figures.sweep_content import POINTS, Show, SweepContent, content_of
from rmpc_bench.types import DesignError
from rmpc_bench.types.errors import Issue, unknown
from rmpc_bench.types.figure import SweepFigure
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.result_rows import ResultTable
    from rmpc_bench.analysis.trials import Trials

PANEL, FIRST = 1.7, 2.6  # heights of a figure of lines: of every further panel, and of the first one with labels [in]
PAGE = {"wide": (4.65, 3.2), "narrow": (2.7, 2.6)}
"""Class of a drawing on the page -> its size [in]: the page shows it 1.4 times as large, with texts of 11 pt."""


@dataclass(frozen=True, kw_only=True)
class Sweep(SweepFigure):
    """Change of a metric against the baseline, or its values, at the points of a sweep.

    Over one swept number it has a line per method with its intervals as bands; positive numbers whose largest exceeds
    20 times the smallest have a logarithmic axis.  A change is a ratio on a logarithmic axis; a line that leaves it has
    an arrow at its name.  Over names it is a matrix of points and methods, and over two paths a table per method: cells
    have the number, and of a change the colour of the verdict.  In a cell ? is inconclusive and ≈ equivalent.  Other
    paths give panels of lines, or lines of the matrix.

    Parameters
    ----------
    path : swept path of the axis, two paths for tables, or `points` for a matrix; those that differ if not given
    metric : name of the metric; the primary one if not given
    show : `change` against the baseline with its interval, or `value`; if not given, the change where there is another
        method
    spread : of values: means with `interval` or medians with `quartiles`
    log : whether axis or colours are logarithmic; `auto` where the largest value exceeds 20 times the smallest
    label : text of the axis of the swept value; made from the path if not given
    height : height of the whole picture [in]; by the number of panels and cells if not given
    order : methods to show; all if not given
    at : points of the sweep, each by values of its paths (default: all)
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    path: str | list[str] | None = None
    metric: str | None = None
    show: Literal["change", "value"] | None = None
    spread: Literal["interval", "quartiles"] = "interval"
    log: Log = "auto"
    label: str | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: swept paths, and another method for changes."""
        yield from super().check(layout)
        changes = (self.show or ("change" if len(layout.methods) > 1 else "value")) == "change"
        if changes and len(layout.methods) < 2:
            yield Issue("show", "compares methods with the baseline: needs at least two methods, or `show: value`")
        if changes and self.log != "auto":
            yield Issue("log", "is for values: leave log out, or show the value")
        if not layout.points:
            return
        paths = list(layout.points[0])
        if not paths:
            yield Issue("path", "nothing is swept in this configuration")
            return
        wanted = [self.path] if isinstance(self.path, str) else self.path or []
        if len(wanted) > 2 or len(set(wanted)) < len(wanted) or (isinstance(self.path, list) and not wanted):
            yield Issue("path", "must be one path, two different ones, or `points`")
        for path in wanted:
            if path not in ([*paths, POINTS] if len(wanted) == 1 else paths):
                yield Issue("path", unknown(path, [*paths, POINTS], "path of the sweep"))

    def draw(self, results: Trials) -> MplFigure:
        """Draw lines or cells; see `Figure.draw`."""
        from rmpc_bench.figures.sweep_panels import draw_cells, draw_lines

        content = self._content(results)
        if content.is_lines:
            return draw_lines(content, self.size(FIRST + PANEL * (len(content.panels) - 1)))
        return draw_cells(content, self)

    def caption(self, results: Trials) -> str:
        """Say what lines or cells are; see `Figure.caption`."""
        return sentence(self._content(results).sentence())

    def _content(self, results: Trials) -> SweepContent:
        self.require(layout_of(results))
        points, info = points_at(results, self.at), metric_of(results, self.metric)
        found = content_of(tables_of(results, points, info), self.path)
        methods = self.order or results.methods
        show: Show = self.show or ("change" if len(results.methods) > 1 else "value")
        if show == "change":
            methods = [name for name in methods if name != results.baseline]
            if not methods:
                raise DesignError(f"must name a method besides the baseline '{results.baseline}'", "order")
        axis = found.axis if self.label is None else found.axis._replace(words=self.label)
        return found._replace(axis=axis, methods=tuple(methods), show=show, spread=self.spread, log=self.log)


def page_drawings(tables: Sequence[ResultTable]) -> dict[str, str]:
    """Draw the changes of a sweep of one number for the page, class of the drawing -> SVG; empty for other sweeps."""
    from rmpc_bench.figures.files import page_svg
    from rmpc_bench.figures.sweep_panels import draw_lines

    content = content_of(tables)
    if not content.is_lines or not content.methods:
        return {}
    return {name: page_svg(draw_lines(content, size), name) for name, size in PAGE.items()}
