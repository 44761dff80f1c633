"""Ensemble variance of the estimation error and the reported covariance over time (souto2011, Fig. 4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.captions import joined, label_of, place, sentences, span_of
from rmpc_bench.figures.ensemble_panels import (
    EnsembleFigure,
    MomentLine,
    MomentPanel,
    count_states,
    draw_moments,
    last_sample,
    lines_of,
    source_of,
)
from rmpc_bench.figures.labels import symbol, unit_of, with_unit
from rmpc_bench.figures.samples import components, cut
from rmpc_bench.figures.sweep_points import point_at
from rmpc_bench.figures.window import TimeWindow, window_of
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

MOMENT, COVARIANCE = "cov(e)", "P"
ROUNDING = 1e-9
"""Relative distance above a reported variance up to which the variance counts as equal."""


@dataclass(frozen=True, kw_only=True)
class VarianceWithBound(EnsembleFigure):
    """Ensemble variance of every method's estimation error and its reported covariance, one panel per state.

    Solid is the exact variance of x - x_hat, thin and pale behind it the one from runs; if there is no exact one, the
    one from runs is the line.  Dashed in the same colour is the diagonal of the reported covariance P, the variance
    that the estimator claims or guarantees.  A solid line above its dashed one is a bound that does not hold: the
    estimator is overconfident.

    Parameters
    ----------
    log : logarithmic axis; linear, with a remark, if a value is not positive
    """

    log: bool = False

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: moments with this state, and a method that reports P."""
        yield from super().check(layout)
        yield from layout.require_series(MOMENT, COVARIANCE)
        yield from layout.require_series_of(self.order, MOMENT)
        yield from self.check_states(layout, MOMENT)

    def caption(self, results: Trials) -> str:
        """Define lines and bounds, and count the samples where a bound is exceeded; see `Figure.caption`."""
        point, title = point_at(results, self.at)
        methods = self.order or layout_of(point).methods_having(MOMENT)
        panels = variance_panels(point, methods, self.component)
        window = window_of(point, last_sample(panels), self.from_, self.to)
        lines = [line for panel in panels for line in panel.lines]
        return sentences(
            f"Variance of the estimation error (solid) and its reported value, the diagonal of $P$ (dashed), for "
            f"{joined(label_of(point, name) for name in methods)} over time, {span_of(window)}",
            place(point, title),
            source_of(lines),
            _exceeded(point, methods, panels, window),
            "The axis is logarithmic" if self.log else "",
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw variances and bounds of one point; see `Figure.draw`."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods = self.order or layout.methods_having(MOMENT)
        panels = variance_panels(point, methods, self.component)
        window = window_of(point, last_sample(panels), self.from_, self.to)
        size = self.size(0.8 + 1.2 * len(panels))
        return draw_moments(point, title, methods, panels, window, size, words=("variance", "variance"), log=self.log)


def variance_panels(point: Trials, methods: Sequence[str], component: int | None) -> list[MomentPanel]:
    """Read the variances of the estimation errors and the reported ones; all states if no component is given."""
    cov, P = (components(point.series, name, methods) for name in (MOMENT, COVARIANCE))
    n = count_states(cov[name] for name in methods)
    panels = []
    for i in range(n) if component is None else [component]:
        entry = f"{i},{i}"
        lines: list[MomentLine] = []
        for name in methods:
            if entry in P.get(name, {}):
                lines.append(MomentLine(name, "bound", P[name][entry].best))
            lines += lines_of(name, cov[name][entry]) if entry in cov[name] else []
        unit = unit_of(point, f"x.{i}")
        squared = f"{unit}^2" if unit.isalpha() else unit and f"({unit})^2"
        label = with_unit(f"var {symbol('e', str(i) if n > 1 else '')}", squared)
        panels.append(MomentPanel(label, tuple(lines)))
    return panels


def _exceeded(point: Trials, methods: Sequence[str], panels: Sequence[MomentPanel], window: TimeWindow) -> str:
    """Count for a caption the samples at which some variance lies above its reported value."""
    found = []
    for name in methods:
        above: set[int] = set()
        shown: set[int] = set()
        for panel in panels:
            lines = {line.kind: cut(line.curve, window) for line in panel.lines if line.method == name}
            main, bound = lines.get("main"), lines.get("bound")
            if main is None or bound is None:
                continue
            limits = {int(k): float(value) for k, value in zip(bound.k, bound.values, strict=True)}
            constant = float(bound.values[0]) if len(set(bound.values.tolist())) == 1 else float("nan")
            for k, value in zip(main.k.tolist(), main.values.tolist(), strict=True):
                limit = limits.get(k, constant)
                shown |= {k}
                above |= {k} if value > limit * (1 + ROUNDING) else set()
        if shown:
            found.append(f"{label_of(point, name)} at {len(above)} of {len(shown)}")
    return f"A variance exceeds its reported value for {joined(found)} samples" if found else ""
