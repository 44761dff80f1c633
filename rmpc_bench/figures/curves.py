"""What a panel over time shows of one method: runs, the thick one among them, and what they are compared with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.analysis.estimation_errors import (
    ErrorMoments,
    ErrorRuns,
    chi_square_band,
    ensemble_errors,
    recorded_errors,
    recorded_innovations,
    reported_covariance,
)
from rmpc_bench.figures.axes import drawable
from rmpc_bench.figures.quantities import Quantity
from rmpc_bench.figures.recorded_runs import (
    ERROR,
    OUTPUT,
    RunSelection,
    TimeWindow,
    reported_set,
    shown_part,
    signal_of,
)
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials


class Curve(NamedTuple):
    """Values of one component over the samples."""

    k: Array
    values: Array

    def at(self, k: int) -> float:
        """Value at a sample, NaN where there is none; a constant has it at every sample."""
        found = self.values if len(self.k) == 1 else self.values[self.k == k]
        return float(found[0]) if len(found) else np.nan

    def cut(self, window: TimeWindow) -> Curve:
        """Cut to a window; a constant covers it."""
        if len(self.k) == 1:
            return Curve(np.array([window.first, window.last]), np.repeat(self.values, 2))
        inside = (self.k >= window.first) & (self.k <= window.last)
        return Curve(self.k[inside], self.values[inside])


class SeriesComponent(NamedTuple):
    """A component of a series."""

    best: Curve  # the exact values where they exist, else those from runs
    behind: Curve | None  # those from runs where the exact ones exist too


def components(point: Trials, quantity: str, method: str) -> dict[str, SeriesComponent]:
    """Read all components of a quantity of a method; none where it does not have it."""
    best, *behind = [
        {name: Curve(np.arange(len(values)), values) for name, values in each.components().items()}
        for each in point.series_of(quantity, method)
    ] or [{}]
    return {name: SeriesComponent(curve, behind[0][name] if behind else None) for name, curve in best.items()}


class NeesLines(NamedTuple):
    """NEES of a method over the samples, divided by the degrees of freedom."""

    exact: Array | None  # (samples,) expected value; None without exact moments
    average: Array | None  # (samples,) average over runs; None without runs
    freedom: Array  # (samples,) degrees of freedom of all runs together


def nees_of(point: Trials, method: str) -> NeesLines | None:
    """Compute the average NEES: of the ensemble where all runs have the same P, else of the recorded runs."""
    recorded = recorded_errors(point, method)
    exact, sampled = (ensemble_errors(point, method, exact=each) for each in (True, False))
    known = exact or sampled
    P = None if known is None else reported_covariance(point, method, len(known.mean))
    own = recorded is not None and recorded.P is not None and recorded.P.ndim == 4
    expected, average = None, None
    if exact is not None and P is not None:
        squares = exact.squares(P)
        expected = _divided(squares.values, squares.freedom)
    if sampled is not None and P is not None and not own:
        squares = sampled.squares(P)
        average = _divided(squares.values, squares.freedom)
        return NeesLines(expected, average, sampled.n * squares.freedom)
    if recorded is not None and recorded.P is not None and len(recorded.runs):
        return _of_runs(recorded, expected)
    return None if expected is None else NeesLines(expected, None, np.zeros(len(expected)))


def _of_runs(recorded: ErrorRuns, expected: Array | None = None) -> NeesLines | None:
    """Average the normalised squares of runs; a sample that a run does not have counts for the others only."""
    values, freedom = recorded.squares()
    missing = np.isnan(values)
    if missing.all():
        return None
    total = np.where(missing, 0, freedom).sum(axis=0)
    average = _divided(np.where(missing, 0.0, values).sum(axis=0), total)
    return NeesLines(expected, average, total)


def _divided(values: Array, freedom: Array) -> Array:
    """Divide by the degrees of freedom; NaN where there are none."""
    return np.asarray(np.where(freedom > 0, values / np.maximum(freedom, 1), np.nan))


EDGE = 1e-9  # relative distance beyond the edge of a set up to which a state counts as inside: rounding
BAND = (0.05, 0.95)  # quantiles over the runs at the ends of a band
FEW = 10  # recorded runs below which no mean and standard deviation over them is shown


class Line(NamedTuple):
    """Values over time, NaN where there are none."""

    kind: str
    t: Array
    values: Array


class Area(NamedTuple):
    """The values between two curves."""

    kind: str
    t: Array
    low: Array
    high: Array


class Cell(NamedTuple):
    """The content of a panel, from below to above."""

    lines: tuple[Line, ...] = ()
    areas: tuple[Area, ...] = ()
    levels: tuple[tuple[str, float], ...] = ()  # kinds and values of horizontal lines


class Choice(NamedTuple):
    """Which runs of a method are shown, and how."""

    show: str
    selection: RunSelection | None  # None where no run of the method is recorded
    middle: int  # position of the thick run in the traces
    n_thin: int | None
    level: float
    log: bool | None  # None: for `nees` and `nis` only


def cell_of(point: Trials, method: str, quantity: Quantity, window: TimeWindow, choice: Choice) -> Cell | None:
    """Read what a panel shows; None where the method does not have the quantity."""
    made = _CELLS[quantity.kind](point, method, quantity, window, choice)
    return made if made is not None and (made.lines or made.areas) else None


def _recorded(point: Trials, method: str, quantity: Quantity, window: TimeWindow, choice: Choice) -> Cell | None:
    """Single runs, or what they have in common, of a recorded signal."""
    traces = point.traces.get(method)
    if traces is None or choice.selection is None:
        return None
    every = signal_of(traces, quantity.name, quantity.number)
    if every is None:
        return None
    held, t = every.shape[1] < len(traces.r), window.times
    values = shown_part(every[choice.selection.rows], traces, window)
    if choice.show == "width":
        low, high = np.nanquantile(values, BAND, axis=0)
        return Cell((Line("main", t, high - low),), levels=(("average", float(np.nanmean(high - low))),))
    of_difference = choice.show == "difference"
    levels = [("zero", 0.0)] if of_difference or quantity.name == ERROR else []
    levels += [] if of_difference else [("limit", limit) for limit in limits_of(point, method, quantity)]
    lines: list[Line] = []
    if quantity.name == OUTPUT and not of_difference:
        lines.append(Line("reference", *_steps(t, traces.r[window.slice, quantity.number])))
    areas: tuple[Area, ...] = ()
    if choice.show == "band":
        low, main, high = np.nanquantile(values, [BAND[0], 0.5, BAND[1]], axis=0)
        areas = (Area("band", t, low, high),)
    else:
        lines += [Line("run", t, run) for run in values[: choice.n_thin]] if len(values) > 1 else []
        (main,) = shown_part(every[[choice.middle]], traces, window)
    return Cell((*lines, Line("main", *(_steps(t, main) if held else (t, main)))), areas, tuple(levels))


def _steps(t: Array, values: Array) -> tuple[Array, Array]:
    """Corners of a signal that is held until the next sample."""
    return np.repeat(t, 2)[1:], np.repeat(values, 2)[:-1]


def limits_of(point: Trials, method: str, quantity: Quantity) -> list[float]:
    """Limits of a component in the method's controller."""
    known = point.limits.get(method, {})
    ends = known.get(f"{quantity.name}.{quantity.number}", known.get(quantity.name, (None, None)))
    return [end for end in ends if end is not None]


def _error(point: Trials, method: str, quantity: Quantity, window: TimeWindow, choice: Choice) -> Cell | None:
    """Errors of the estimate with three reported standard deviations on both sides of 0, and their actual spread."""
    i, t = quantity.number, window.times
    recorded = recorded_errors(point, method)
    exact, sampled = (ensemble_errors(point, method, exact=each) for each in (True, False))
    moments = exact or sampled
    lines: list[Line] = []
    P = None
    if recorded is not None and len(recorded.runs):
        e = drawable(recorded.e[:, window.slice, i])
        lines += [Line("run", t, run) for run in e[: choice.n_thin]] if len(e) > 1 else []
        middle = np.flatnonzero(recorded.runs == point.traces[method].runs[choice.middle])
        lines += [Line("main", t, e[place]) for place in middle]
        if moments is None and len(e) >= FEW:
            gap = recorded.e - recorded.e.mean(axis=0)
            cov = np.einsum("rki,rkj->kij", gap, gap) / (len(e) - 1)
            moments = ErrorMoments(recorded.e.mean(axis=0), cov, len(e))
        if recorded.P is not None:
            P = np.median(recorded.variances(), axis=0)
    if P is None and moments is not None:
        covariance = reported_covariance(point, method, len(moments.mean))
        P = None if covariance is None else np.diagonal(covariance, axis1=1, axis2=2)
    areas: list[Area] = []
    if P is not None:
        band = drawable(3 * np.sqrt(np.maximum(P[window.slice, i], 0.0)))
        areas.append(Area("reported", t, -band, band))
    if moments is not None:
        mean, std = moments.mean[window.slice, i], moments.std[window.slice, i]
        lines += [Line("spread", t, drawable(edge)) for edge in (mean - 3 * std, mean + 3 * std)]
        lines += [] if any(line.kind == "main" for line in lines) else [Line("main", t, drawable(mean))]
    return Cell(tuple(lines), tuple(areas), (("zero", 0.0),)) if lines else None


def _variance(point: Trials, method: str, quantity: Quantity, window: TimeWindow, _: Choice) -> Cell | None:
    """Variance of the error over the ensemble, and the reported one as its bound."""
    entry = f"{quantity.number},{quantity.number}"
    actual, reported = (components(point, name, method).get(entry) for name in ("cov(e)", "P"))
    if actual is None:
        return None
    shown = {"from runs": actual.behind, "main": actual.best, "bound": reported.best if reported else None}
    return _of_series(window, shown)


def _mean(point: Trials, method: str, quantity: Quantity, window: TimeWindow, _: Choice) -> Cell | None:
    """Mean of the estimate over the ensemble, and that of the true state."""
    entry = str(quantity.number)
    state, estimate = (components(point, name, method).get(entry) for name in ("mean(x)", "mean(x_hat)"))
    if state is None or estimate is None:
        return None
    return _of_series(window, {"state": state.best, "from runs": estimate.behind, "main": estimate.best})


def _series(point: Trials, method: str, quantity: Quantity, window: TimeWindow, _: Choice) -> Cell | None:
    """A series of the design or of the ensemble."""
    found = components(point, quantity.name, method)
    component = quantity.component if quantity.component or "" in found else next(iter(found), "")
    return _of_series(window, {"main": found[component].best}) if component in found else None


def _of_series(window: TimeWindow, curves: Mapping[str, Curve | None]) -> Cell:
    """Make lines of stored curves by kind, of those that have values in the window."""
    pieces = {kind: curve.cut(window) for kind, curve in curves.items() if curve is not None}
    lines = [(kind, window.sample * k, drawable(values)) for kind, (k, values) in pieces.items() if len(k)]
    return Cell(tuple(Line(*each) for each in lines))


def _nees(point: Trials, method: str, quantity: Quantity, window: TimeWindow, choice: Choice) -> Cell | None:
    """Average normalised square of errors or innovations, with the band of a consistent estimator."""
    if quantity.kind == "nees":
        found = nees_of(point, method)
    else:
        recorded = recorded_innovations(point, method)
        found = _of_runs(recorded) if recorded is not None and len(recorded.runs) else None
    if found is None:
        return None
    t, lines, areas = window.times, [], []

    def gaps(values: Array) -> Array:
        return np.where(np.isfinite(values) & ((values > 0) | (choice.log is False)), values, np.nan)[window.slice]

    if found.average is not None:
        low, high = chi_square_band(found.freedom[window.slice], choice.level)
        areas.append(Area("consistent", t, low, high))
        lines += [Line("from runs", t, gaps(found.average))] if found.exact is not None else []
    main = found.average if found.exact is None else found.exact
    lines += [Line("main", t, drawable(gaps(main)))] if main is not None else []
    return Cell(tuple(lines), tuple(areas), (("one", 1.0),))


def _tube(point: Trials, method: str, quantity: Quantity, window: TimeWindow, choice: Choice) -> Cell | None:
    """One run among the sets that the method reports for its state."""
    if choice.selection is None:
        return None
    signals, i = point.traces[method].signals, quantity.number
    x, x_hat = (signals[name][choice.middle][window.slice, i] for name in ("x", "x_hat"))
    shapes, gaussian = _shapes(point, method, choice.level)
    own = shapes[:, i, i]
    own = own[window.slice] if len(own) > 1 else np.repeat(own, len(x))
    half, t = np.sqrt(np.maximum(own, 0.0)), window.times
    error = point.traces[method].difference("x", x[:, None], x_hat[:, None], [i])[:, 0]
    beyond = np.where(np.abs(error) > half * (1.0 + EDGE), x, np.nan)
    lines = [Line("main", t, drawable(x_hat)), Line("state", t, drawable(x))]
    lines += [Line("outside", t, drawable(beyond))] if np.isfinite(beyond).any() else []
    kind = "set P" if gaussian else "set M"
    return Cell(tuple(lines), (Area(kind, t, drawable(x_hat - half), drawable(x_hat + half)),))


def _shapes(point: Trials, name: str, level: float) -> tuple[Array, bool]:
    """Return the shape matrices of the reported sets, axis 0 = k, and whether they are ellipsoids of P at `level`."""
    from scipy.special import gammaincinv

    quantity = reported_set({each.quantity: each.quantity for each in point.over_time if each.method == name})
    assert quantity is not None, "the check of the figure requires one"
    values = point.matrix_series(quantity, name)
    if quantity != "P":
        return values, False
    # The quantile of chi-square with n degrees of freedom.
    return 2.0 * float(gammaincinv(values.shape[-1] / 2.0, level)) * values, True


_CELLS = {
    "recorded": _recorded,
    "error": _error,
    "variance": _variance,
    "mean": _mean,
    "series": _series,
    "nees": _nees,
    "nis": _nees,
    "tube": _tube,
}
