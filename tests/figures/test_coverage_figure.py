"""Coverage against its level and over time, read back from the artists."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import coverage_trials, errors, of_squares
from conftest import ROUND
from scipy import stats

from rmpc_bench.analysis.calibration import calibrations
from rmpc_bench.analysis.columns import Series
from rmpc_bench.analysis.intervals import wilson
from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.analysis.traces import Traces
from rmpc_bench.figures.coverage import APART, CoverageFigure
from rmpc_bench.types import DesignError

RUNS, SAMPLES = 40, 12


@pytest.fixture
def trials():
    """Return two methods with shares, and one without."""
    rng = np.random.default_rng(7)
    values = {name: of_squares(errors(rng, RUNS), s) for name, s in (("A", 1.0), ("B", 0.6))}
    return coverage_trials(values | {"none": dict.fromkeys(values["A"], np.full(RUNS, np.nan))})


@pytest.fixture
def recorded(trials):
    """The same with recorded states of A, unit covariance from its design, and a sample without one."""
    rng = np.random.default_rng(8)
    x, e = rng.standard_normal((2, RUNS, SAMPLES, 2))
    P = np.tile(np.eye(2), (SAMPLES, 1, 1))
    P[3] = np.nan
    traces = Traces(np.arange(RUNS), {"x": x, "x_hat": x + e}, np.zeros((SAMPLES, 1)), {})
    return replace(trials, traces={"A": traces}, over_time=(Series("A", "P", P),)), (e**2).sum(axis=2)


def marks(axes):
    """Lines of single marks, by method."""
    return [line for line in axes.lines if line.get_marker() not in ("None", None)]


def test_marks_and_intervals_are_the_rows(trials):
    """Oracle: the rows of the table; methods at one level are apart."""
    figure = CoverageFigure().draw(trials)
    (axes,) = figure.axes
    found = marks(axes)
    rows = [row for _, each in calibrations(trials) for row in each if row["of"] == "joint" and row["n"]]
    for place, (line, bars) in enumerate(zip(found, axes.collections[1:], strict=True)):
        mine = [row for row in rows if row["method"] == "AB"[place]]
        x, y = line.get_xydata().T
        np.testing.assert_allclose(x, np.array([0.5, 0.9, 0.95]) + APART * (place - 0.5), **ROUND)
        np.testing.assert_allclose(y, [row["covered"] for row in mine], **ROUND)
        ends = np.array([segment[:, 1] for segment in bars.get_segments()])
        np.testing.assert_allclose(ends, [[row["low"], row["high"]] for row in mine], **ROUND)
    assert len(found) == 2 and [text.get_text() for text in figure.legends[0].get_texts()] == ["A", "B"]


def test_the_band_is_the_margin(trials):
    """Oracle: scipy.stats with two degrees of freedom."""
    (axes,) = CoverageFigure().draw(trials).axes
    corners = axes.collections[0].get_paths()[0].vertices
    p = corners[1:200, 0]
    inner = stats.chi2.ppf(p, 2)
    np.testing.assert_allclose(corners[1:200, 1], stats.chi2.cdf(inner / 1.21, 2), rtol=1e-9)  # of two inverses


def test_a_second_panel_shows_recorded_runs_over_time(recorded):
    """Oracle: plain counts and the Wilson interval; a sample without a covariance is a gap."""
    trials, squares = recorded
    first, second = CoverageFigure().draw(trials).axes
    wanted = (squares <= stats.chi2.ppf(0.9, 2)).mean(axis=0)
    line = next(line for line in second.lines if len(line.get_xdata()) == SAMPLES)
    known = np.arange(SAMPLES) != 3
    np.testing.assert_allclose(line.get_ydata()[known], wanted[known], **ROUND)
    assert np.isnan(line.get_ydata()[3]) and second.get_ylabel() == "coverage, 90 %"
    ends = [wilson(int(round(c * RUNS)), RUNS, 0.95) for c in wanted[known]]
    band = np.concatenate([path.vertices for path in second.collections[0].get_paths()])
    assert set(np.ravel(ends).round(9)) <= set(band[:, 1].round(9))
    assert len(marks(first)) == 2
    caption = CoverageFigure().caption(trials)
    assert "below, over time at 90 %" in caption and caption.endswith("no run failed.") and caption.count(". ") == 0
    assert "below" not in CoverageFigure(order=["B"]).caption(trials)


def test_what_cannot_be_drawn_is_refused(trials):
    """Oracle: the words of the checks, before the run and of stored results."""
    assert not list(CoverageFigure(order=["A"]).check(layout_of(trials)))
    plain = replace(trials, metrics=trials.metrics[:0], calibration=None)
    (issue,) = CoverageFigure().check(layout_of(plain))
    assert issue.message == "needs shares of covered errors: calibration: true"
    with pytest.raises(DesignError, match="no method to show reports a covariance"):
        CoverageFigure(order=["none"]).draw(trials)
    with pytest.raises(DesignError, match="calibration: true"):
        CoverageFigure().draw(replace(trials, calibration=None))


def test_a_point_of_a_sweep(trials):
    """Oracle: the shares of the point that is named, the first one otherwise."""
    other = coverage_trials({"A": of_squares(errors(np.random.default_rng(1), RUNS), 2.0)})
    tables = [replace(table, point={"x": str(k)}, title=f"x={k}") for k, table in enumerate((trials, other))]
    whole = replace(tables[0], paths=("x",), points=tuple(tables), point={}, title="")
    (axes,) = CoverageFigure(at={"x": 1}).draw(whole).axes
    (line,) = marks(axes)
    np.testing.assert_allclose(line.get_ydata()[1], other.column("coverage_90", "A").mean(), **ROUND)
    assert "at x=1" in CoverageFigure(at={"x": 1}).caption(whole)
