"""Estimation error over time with the three-sigma band that the estimator reports."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

import numpy as np
from annotated_types import Ge, Le

from rmpc_bench.analysis.estimation_errors import (
    GAUSSIAN_SHARE,
    MEAN,
    SCATTER,
    ErrorMoments,
    ErrorRuns,
    ensemble_errors,
    recorded_errors,
    reported_covariance,
)
from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.analysis.traces import COVARIANCE
from rmpc_bench.figures.error_panels import ErrorLines, draw_errors
from rmpc_bench.figures.shared_content import shared_content
from rmpc_bench.figures.sweep_points import MOST_PANELS, point_at
from rmpc_bench.figures.window import TimeWindow, window_of
from rmpc_bench.types import Array, DesignError, NonNegative
from rmpc_bench.types.figure import Index, OnePointFigure
from rmpc_bench.types.issue import Issue
from rmpc_bench.types.result_layout import NO_P, ResultLayout

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

SingleRuns = Annotated[int, Ge(0), Le(20)]
COLUMN = 1.5
"""Width from which on methods stand side by side [in]."""
MOST = 12
"""Panels of methods that stand side by side."""
FEW = 10
"""Recorded runs below which no mean and standard deviation over them is shown."""
NO_ERRORS = (
    "needs recorded x and x_hat, record: {runs: 20, signals: [x, x_hat]}, or moments, evaluate: [runs, ensemble]"
)
NO_BAND = "reports no covariance P"


@dataclass(frozen=True, kw_only=True)
class EstimationError(OnePointFigure):
    """Estimation error x_hat - x of every state over time, with the band +-3 sqrt(P_ii) that the estimator reports.

    The error is that of the bench's metrics; claims and the series `mean(e)` and `cov(e)` have the sign of x - x_hat.
    Thin lines are single recorded runs.  The thick line and the thin solid ones are mean and mean +-3 standard
    deviations over the ensemble: the exact ones if they exist, else those over its runs, else those over the recorded
    runs if they are at least 10.  The dashed lines are the reported band: P of the design, or the recorded signal `P`
    of every run, of which the median over the runs is drawn.  Solid lines outside of the dashed ones show an
    overconfident estimator, those far inside a conservative one.  The caption states the share of the samples of all
    recorded runs outside of the band of their own run; a Gaussian error with the covariance P has 0.27 %.  Failed runs
    are left out.  A method that reports no covariance cannot be shown.

    Parameters
    ----------
    component : index of the state (counted from 0); all if not given
    runs : number of single runs to show, from the first one on
    from_ : first time to show and to count [s]
    to : last time to show and to count [s]
    height : height of the whole picture [in]; if not given 0.8 and 1.1 for every row of panels; legend and title add to
        it if they need more than a line
    order : methods to show, from left to right or from top to bottom; all that have errors and report P if not given
    """

    needs_runs: ClassVar[bool] = False

    component: Index | None = None
    runs: SingleRuns = 5
    from_: NonNegative | None = None
    to: NonNegative | None = None

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add to the common checks: errors and a reported covariance of some method, a state, panels that fit."""
        yield from super().check(layout)
        if not layout.is_complete:
            return
        yield from require_errors(layout, self.order)
        shown = [name for name in self.order or methods_with_errors(layout) if name in layout.methods]
        n = state_count(layout, shown)
        yield from layout.require_component("state", [] if self.component is None else [self.component], n, "component")
        rows, columns = self._grid(len(shown), 1 if self.component is not None else n or 1)
        most = MOST if columns > 1 else MOST_PANELS
        advice = "choose a state with `component` or methods with `order`"
        yield from layout.require_at_most(most, rows * columns, "panels", "component", advice)
        yield from layout.require_window(self.from_, self.to)

    def _grid(self, n_methods: int, n_states: int) -> tuple[int, int]:
        """Rows and columns of panels: methods side by side where they fit."""
        side_by_side = n_methods > 1 and self.width / n_methods >= COLUMN
        return (n_states, n_methods) if side_by_side else (n_states * n_methods, 1)

    def draw(self, results: Trials) -> MplFigure:
        """Draw the errors of one point; see `Figure.draw`."""
        found = self._content(results)
        rows, columns = self._grid(len(found.methods), len(found.states))
        size = self.size(0.8 + 1.1 * rows)
        return draw_errors(found.point, found.title, found.methods, found.states, found.window, size, columns)

    def caption(self, results: Trials) -> str:
        """Say what the lines are, and which share of the errors lies outside of the band; see `Figure.caption`."""
        found = self._content(results)
        lines = found.methods
        own = ", the median over the runs where every run has its own" if any(e.own for e in lines.values()) else ""
        sentences = [
            "Estimation error $\\hat{x} - x$ of every state over time; dashed: the band $\\pm 3 \\sqrt{P_{ii}}$ of the "
            f"covariance $P$ that the estimator reports{own}.",
            _runs_sentence(lines, self.runs),
        ]
        sentences += [
            f"{found.label(name)}: {text}"
            for name, each in lines.items()
            if (text := _mean_sentence(each, found.window))
        ]
        sentences += [_shares_sentence(found), sets_sentence(found.point, lines)]
        return " ".join(filter(None, sentences))

    def _content(self, results: Trials) -> ErrorContent:
        return shared_content(results, self, lambda: self._compute(results))

    def _compute(self, results: Trials) -> ErrorContent:
        """Read what the figure shows."""
        point, title = point_at(results, self.at)
        layout = layout_of(point)
        self.require(layout)
        methods, without = {}, []
        for name in self.order or methods_with_errors(layout):
            lines = errors_of(point, name, self.runs)
            if lines is None:
                without.append(name)
            else:
                methods[name] = lines
        if self.order and without:
            raise DesignError(f"'{without[0]}' {NO_BAND} in its recorded runs", "order")
        if not methods:
            raise DesignError(f"no method has an error and a covariance P; {NO_ERRORS}", "")
        n = min(each.band.shape[1] for each in methods.values())
        states = list(range(n)) if self.component is None else [self.component]
        last = min(len(each.band) for each in methods.values()) - 1
        return ErrorContent(point, title, methods, states, window_of(point, last, self.from_, self.to))


class ErrorContent(NamedTuple):
    """What the figure shows."""

    point: Trials
    title: str
    methods: dict[str, ErrorLines]
    states: list[int]
    window: TimeWindow

    def label(self, name: str) -> str:
        """Name of a method in a sentence."""
        return self.point.labels.get(name, name)


def errors_of(point: Trials, method: str, n_single: int) -> ErrorLines | None:
    """Read errors and band of a method; None where it reports no covariance, or has no errors."""
    recorded = recorded_errors(point, method)
    exact, sampled = (ensemble_errors(point, method, exact=each) for each in (True, False))
    moments = exact or sampled or _moments_of(recorded)
    if recorded is not None and recorded.P is not None and len(recorded.runs):
        variances, own = recorded.variances(), recorded.P.ndim == 4
        band = 3 * np.sqrt(np.maximum(np.median(variances, axis=0), 0.0))
    else:
        recorded, own = None, False
        n_samples = 0 if moments is None else len(moments.mean)
        P = reported_covariance(point, method, n_samples) if n_samples else None
        if P is None or moments is None:
            return None
        band = 3 * np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
    single = np.zeros((0, *band.shape)) if recorded is None else recorded.e[:n_single]
    return ErrorLines(single, moments, band, recorded, own)


def _moments_of(recorded: ErrorRuns | None) -> ErrorMoments | None:
    """Mean and covariance over the recorded runs; None of few runs."""
    if recorded is None or len(recorded.runs) < FEW:
        return None
    e = recorded.e
    gap = e - e.mean(axis=0)
    return ErrorMoments(e.mean(axis=0), np.einsum("rki,rkj->kij", gap, gap) / (len(e) - 1), len(e))


def methods_with_errors(layout: ResultLayout) -> list[str]:
    """Methods that have errors and may have a covariance."""
    return [name for name in layout.methods if _has_errors(layout, name) and _has_covariance(layout, name)]


def _has_errors(layout: ResultLayout, name: str) -> bool:
    return {"x", "x_hat"} <= set(layout.signals.get(name, {})) or {MEAN, SCATTER} <= set(layout.arrays.get(name, {}))


def _has_covariance(layout: ResultLayout, name: str) -> bool:
    return COVARIANCE in layout.arrays.get(name, {}) or COVARIANCE in layout.signals.get(name, {})


def require_errors(layout: ResultLayout, order: list[str] | None) -> Iterator[Issue]:
    """Some method has errors of its estimate and reports a covariance, and so have all methods to show."""
    known = [name for name in layout.methods if _has_errors(layout, name)]
    if not known:
        yield Issue("", NO_ERRORS)
        return
    having = methods_with_errors(layout)
    record = "that of an estimator without a design covariance is recorded with `record: {signals: [x, x_hat, P]}`"
    if not having:
        yield Issue("", f"{NO_P}; {record}")
    for name in order or ():
        if having and name in layout.methods and name not in having:
            what = NO_BAND if name in known else "has no errors"
            yield Issue("order", f"'{name}' {what} (those that have both: {', '.join(having)}); {record}")


def state_count(layout: ResultLayout, methods: list[str]) -> int | None:
    """Count the states of the errors that all methods have; None where it is not known."""
    sizes = [arrays[COVARIANCE][-1] for name in methods if COVARIANCE in (arrays := layout.arrays.get(name, {}))]
    for name in methods:
        x = layout.signals.get(name, {}).get("x")
        sizes += [x[0]] if x is not None else []
    return min(sizes, default=None)


def sets_sentence(point: Trials, methods: Collection[str]) -> str:
    """Name the methods that report a set besides the covariance, which P alone does not contain; empty without any."""
    known = point.series.loc[point.series["quantity"] == "M", "method"].unique()
    having = [point.labels.get(name, name) for name in methods if name in known]
    if not having:
        return ""
    verb = "reports" if len(having) == 1 else "report"
    return f"{' and '.join(having)} also {verb} a set $M$ of the error, which is no part of $P$."


def _runs_sentence(lines: dict[str, ErrorLines], n_single: int) -> str:
    """Count the recorded runs, and those that failed."""
    recorded = [each.recorded for each in lines.values() if each.recorded is not None]
    if not recorded or not n_single:
        return ""
    n, n_failed = max(len(each.runs) for each in recorded), sum(each.n_failed for each in recorded)
    total = " of all methods together" if len(recorded) > 1 else ""
    failed = f"; {n_failed} failed run{' is' if n_failed == 1 else 's are'} left out{total}" if n_failed else ""
    return f"Thin: {f'the first {min(n_single, n)} of {n} recorded runs' if n > 1 else 'the recorded run'}{failed}."


def _mean_sentence(lines: ErrorLines, window: TimeWindow) -> str:
    """Say what the solid lines are, and how the actual spread compares with the reported one."""
    moments = lines.moments
    if moments is None:
        return ""
    source = f"over {moments.n} runs" if moments.n else "exact"
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio: Array = 3 * moments.std[window.slice] / lines.band[window.slice]
    known = ratio[np.isfinite(ratio)]
    text = f"solid: mean and mean $\\pm 3$ standard deviations, {source}"
    if not len(known):
        return f"{text}."
    return f"{text}; the standard deviation is {known.min():.2g} to {known.max():.2g} times the reported one."


def _shares_sentence(found: ErrorContent) -> str:
    """State the shares of the samples of the recorded runs that lie outside of the band; empty without such runs."""
    recorded = {name: each for name, each in found.methods.items() if each.recorded is not None}
    if not recorded:
        return ""
    first, last = found.window.limits
    times = f"{first:g} to {last:g}{' s' if found.window.in_seconds else ''}"
    texts = [f"{found.label(name)} {_share_text(each, found.states, found.window)}" for name, each in recorded.items()]
    return (
        f"Share of all samples (time {times}) outside of the band of their run, beside {100 * GAUSSIAN_SHARE:.2f} % of "
        f"a Gaussian error with the covariance $P$: {'; '.join(texts)}. Successive samples are correlated."
    )


def _share_text(lines: ErrorLines, states: list[int], window: TimeWindow) -> str:
    """State the share outside of the band, of every state in per cent."""
    assert lines.recorded is not None
    outside = lines.recorded.outside()[:, window.slice]
    shares = [f"{100 * float(outside[:, :, i].mean()):.2g} %" for i in states]
    leaving = int(outside[:, :, states].any(axis=(1, 2)).sum())
    return f"{', '.join(shares)} (state {', '.join(map(str, states))}; {leaving} of {len(outside)} runs leave it)"
