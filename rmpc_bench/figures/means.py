"""Ensemble means of the true state and of the estimates over time, one panel per state (souto2011, Fig. 2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.figures.captions import joined, label_of, place, sentences, span_of
from rmpc_bench.figures.ensemble_panels import (
    COMMON,
    EnsembleFigure,
    MomentLine,
    MomentPanel,
    count_states,
    draw_moments,
    interval_words,
    last_sample,
    lines_of,
    source_of,
)
from rmpc_bench.figures.labels import component_label
from rmpc_bench.figures.samples import Curve, SeriesComponent, components
from rmpc_bench.figures.sweep_points import point_at
from rmpc_bench.figures.window import window_of
from rmpc_bench.types import Array
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import ResultLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

MOMENTS = ("mean(x)", "mean(x_hat)")
COVARIANCES = ("cov(x)", "cov(x_hat)")
SAME = 1e-9
"""Relative difference up to which the true states of two methods differ by rounding only."""


@dataclass(frozen=True, kw_only=True)
class Means(EnsembleFigure):
    """Ensemble mean of the true state (black) and of every method's estimate, one panel per state.

    The lines are the exact means; those from runs lie behind them, thin and pale, with the confidence interval of the
    mean as an area, from the standard deviation over the runs.  If there are no exact ones, those from runs are the
    lines.  If the true state depends on the method, as under feedback, it is dotted in the method's
    colour.
    """

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: moments with this state."""
        yield from super().check(layout)
        yield from layout.require_series(*MOMENTS)
        yield from layout.require_series_of(self.order, *MOMENTS)
        yield from self.check_states(layout, MOMENTS[0])

    def caption(self, results: Trials) -> str:
        """Define lines and areas; see `Figure.caption`."""
        point, title = point_at(results, self.at)
        methods = self.order or layout_of(point).methods_having(*MOMENTS)
        panels = mean_panels(point, methods, self.component)
        window = window_of(point, last_sample(panels), self.from_, self.to)
        lines = [line for panel in panels for line in panel.lines]
        has_areas = any(line.half is not None for line in lines)
        common = any(line.method == COMMON for line in lines)
        return sentences(
            f"Ensemble means of the true state and of the estimates of "
            f"{joined(label_of(point, name) for name in methods)} over time, {span_of(window)}",
            place(point, title),
            "The black line is the true state, which is the same for all methods"
            if common
            else "Dotted lines are the true states, which depend on the method",
            source_of(lines),
            f"Areas are the {interval_words(point)}, t times the standard error" if has_areas else "",
        )

    def draw(self, results: Trials) -> MplFigure:
        """Draw the means of one point; see `Figure.draw`."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods = self.order or layout.methods_having(*MOMENTS)
        panels = mean_panels(point, methods, self.component)
        window = window_of(point, last_sample(panels), self.from_, self.to)
        size = self.size(0.8 + 1.2 * len(panels))
        return draw_moments(point, title, methods, panels, window, size, words=("exact", "mean"), log=False)


def mean_panels(point: Trials, methods: Sequence[str], component: int | None) -> list[MomentPanel]:
    """Read the means of the true state and of the estimates; all states if no component is given."""
    x, x_hat = (components(point.series, name, methods) for name in MOMENTS)
    spread = [components(point.series, name, methods) for name in COVARIANCES]
    n = count_states([*x.values(), *x_hat.values()])
    panels = []
    for i in range(n) if component is None else [component]:
        states = {name: found[str(i)] for name, found in x.items() if str(i) in found}
        lines = _true_states(states, {name: _half(point, states[name], spread[0].get(name, {}), i) for name in states})
        for name in methods:
            if str(i) in x_hat[name]:
                values = x_hat[name][str(i)]
                lines += lines_of(name, values, _half(point, values, spread[1].get(name, {}), i))
        label = component_label(point, "x", i, str(i) if n > 1 else "", prefix="mean")
        panels.append(MomentPanel(label, tuple(lines)))
    return panels


def _half(point: Trials, values: SeriesComponent, spread: Mapping[str, SeriesComponent], i: int) -> Array | None:
    """Compute half the width of the interval of a mean over runs: t s / sqrt(n), sample by sample."""
    from scipy.special import stdtrit

    variance = spread[f"{i},{i}"].runs if f"{i},{i}" in spread else None
    if values.runs is None or values.counts is None or variance is None:
        return None
    if not np.array_equal(variance.k, values.runs.k) or (values.counts < 2).any():
        return None
    t = stdtrit(values.counts - 1.0, (1 + point.confidence) / 2)
    return np.asarray(t * np.sqrt(np.maximum(variance.values, 0.0) / values.counts))


def _true_states(found: dict[str, SeriesComponent], half: Mapping[str, Array | None]) -> list[MomentLine]:
    """Make one line for the true state if all methods have the same, as without feedback; else one for each of them."""
    exact = [values for values in found.values() if values.exact is not None]
    compared = exact or list(found.values())
    if all(_same(compared[0].best, other.best) for other in compared[1:]):
        first = next(name for name, values in found.items() if values is compared[0])
        return lines_of(COMMON, compared[0], half[first])
    return [MomentLine(name, "true state", values.best) for name, values in found.items()]


def _same(one: Curve, other: Curve) -> bool:
    if not np.array_equal(one.k, other.k):
        return False
    finite = one.values[np.isfinite(one.values)]
    reach = np.abs(finite).max() if len(finite) else 0.0
    return bool(np.allclose(one.values, other.values, rtol=0.0, atol=SAME * reach, equal_nan=True))
