"""Checks of figures: drawn from stored results alone, with reproducible bytes."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.conformance.results import FROZEN, Check, require
from rmpc_bench.types import Figure, Issue, ResultLayout

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials


@dataclass(frozen=True, eq=False)
class FigureExample:
    """Results that a figure is checked with.

    Parameters
    ----------
    results : a table of trials that the figure can draw
    """

    results: Trials
    checks: ClassVar[tuple[Check, ...]]

    def drawn(self, figure: Figure) -> Any:
        """Draw the figure; a metric that it does not name is the primary one, as in an experiment."""
        primary = self.results.primary or self.results.metrics[0].name
        keys: dict[str, Any] = {key: primary for key in figure.metric_keys if getattr(figure, key) is None}
        return replace(figure, **keys).draw(self.results)

    def svg(self, figure: Figure) -> bytes:
        """Draw the figure and write it without its date."""
        from rmpc_bench.figures.style import style

        buffer = io.BytesIO()
        with style():
            self.drawn(figure).savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        return buffer.getvalue()


def _base_class(figure: Any, _: FigureExample) -> None:
    require(isinstance(figure, Figure), f"{type(figure).__name__} is not a subclass of Figure")


def _accepted(figure: Figure, example: FigureExample) -> None:
    issues = list(figure.check(layout_of(example.results)))
    require(not issues, "; ".join(issue.message for issue in issues))


def _refused(figure: Figure, example: FigureExample) -> None:
    methods = example.results.methods
    issues = list(figure.check(ResultLayout(methods=methods, has_runs=False)))
    require(bool(issues), "an experiment without runs, series and recorded signals is not refused")
    require(all(isinstance(issue, Issue) and bool(issue.message) for issue in issues), "an issue has no message")


def _same_bytes(figure: Figure, example: FigureExample) -> None:
    frame, series = example.results.frame.copy(), example.results.series.copy()
    require(example.svg(figure) == example.svg(figure), "the second picture has other bytes than the first")
    same = example.results.frame.equals(frame) and example.results.series.equals(series)
    require(same, "drawing changes the results")


def _width(figure: Figure, example: FigureExample) -> None:
    width = example.drawn(figure).get_figwidth()
    require(abs(width - figure.width) < 1e-9, f"the picture is {width:g} in wide instead of {figure.width:g} in")


FigureExample.checks = (
    Check("base-class", "the figure is a subclass of Figure", _base_class, is_first=True),
    FROZEN,
    Check("accepted", "check accepts the layout of results that the figure can draw", _accepted),
    Check("refused", "check refuses, before any run, an experiment that has nothing to draw", _refused),
    Check("same-bytes", "drawing twice gives the same bytes and leaves the results unchanged", _same_bytes),
    Check("width", "the picture is as wide as its key `width` says", _width),
)
