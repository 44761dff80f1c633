"""Estimation error with its reported band, and NEES over time, read back from the artists."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from scipy import stats

from rmpc_bench.analysis.traces import Traces
from rmpc_bench.figures.estimation_error import EstimationError
from rmpc_bench.figures.files import save_as
from rmpc_bench.figures.nees import NeesOverTime
from rmpc_bench.figures.style import BLACK, COLOURS
from rmpc_bench.types import DesignError

RUNS, STEPS = 60, 25
K = np.arange(STEPS + 1.0)
VARIANCE = np.array([4.0, 0.25])
FACTOR = {"A": 1.0, "B": 2.0}
"""Actual standard deviation of the errors of a method, relative to the reported one."""


@pytest.fixture
def trials(make_trials, with_series):
    """A is consistent, B has errors of twice its reported size, C has no covariance; run 3 of A failed."""
    rng = np.random.default_rng(11)
    values = {name: [1.0] * RUNS for name in "ABC"}
    values["A"] = ["diverged" if i == 3 else 1.0 for i in range(RUNS)]
    table = make_trials({"mse": values}, labels={"B": "robust"})
    entries = [
        (name, "P", f"{i},{j}", (VARIANCE[i] if i == j else 0.0) * np.ones(STEPS + 1), 0)
        for name in "AB"
        for i in (0, 1)
        for j in (0, 1)
    ]
    traces = {}
    for name in "ABC":
        x = rng.standard_normal((RUNS, STEPS + 1, 2)).cumsum(axis=1)
        e = FACTOR.get(name, 1.0) * np.sqrt(VARIANCE) * rng.standard_normal(x.shape)
        if name == "A":
            e[3] = 1e6
        traces[name] = Traces(np.arange(RUNS), {"x": x, "x_hat": x + e}, np.zeros((STEPS + 1, 1)))
    return replace(with_series(table, *entries), traces=traces, Ts=0.5, units={"x": "m"})


def errors(trials, name):
    """(runs, samples, n) of the runs that finished."""
    signals = trials.traces[name].signals
    return np.delete(signals["x_hat"] - signals["x"], [3] if name == "A" else [], axis=0)


def lines(axes, **wanted):
    """Values of the lines of a panel that have these properties."""
    found = [line for line in axes.lines if len(line.get_xdata()) > 2]
    return [
        np.asarray(line.get_ydata())
        for line in found
        if all(getattr(line, f"get_{name}")() == value for name, value in wanted.items())
    ]


def test_band_mean_and_spread(trials):
    """Oracle: +-3 times the root of the diagonal of P; mean and standard deviation by numpy."""
    figure = EstimationError().draw(trials)
    assert len(figure.axes) == 4
    for column, name in enumerate("AB"):
        e = errors(trials, name)
        for state in (0, 1):
            axes = figure.axes[2 * state + column]
            low, high = lines(axes, color=BLACK)
            np.testing.assert_allclose(high, 3 * np.sqrt(VARIANCE[state]) * np.ones(STEPS + 1))
            np.testing.assert_array_equal(low, -high)
            (mean,) = lines(axes, linewidth=1.4)
            np.testing.assert_allclose(mean, e[:, :, state].mean(axis=0))
            below, above = lines(axes, linewidth=0.8)
            std = e[:, :, state].std(axis=0, ddof=1)
            np.testing.assert_allclose([below, above], [mean - 3 * std, mean + 3 * std])
            single = lines(axes, linewidth=0.5)
            np.testing.assert_array_equal(single, e[:5, :, state])
    assert [axes.get_title() for axes in figure.axes[:2]] == ["A", "robust"]
    assert "[m]" in figure.axes[0].get_ylabel() and figure.axes[2].get_xlabel() == "$t$ [s]"


def test_share_outside_in_the_caption(trials):
    """Oracle: a direct count over runs and samples, beside the share of a Gaussian; the failed run does not count."""
    caption = EstimationError(from_=1.0).caption(trials)
    assert "beside 0.27 % of a Gaussian error" in caption and "2 of" not in caption.split("Thin")[0]
    for name, label in (("A", "A"), ("B", "robust")):
        e = np.abs(errors(trials, name)[:, 2:])
        shares = [f"{100 * np.mean(e[:, :, i] > 3 * np.sqrt(VARIANCE[i])):.2g} %" for i in (0, 1)]
        assert f"{label} {', '.join(shares)} (state 0, 1;" in caption
    assert "Thin: the first 5 of 60 recorded runs; 1 failed run is left out" in caption
    # Of a Gaussian with twice the reported deviation 13 % are outside.
    e = np.abs(errors(trials, "B"))
    assert np.mean(e > 3 * np.sqrt(VARIANCE)) == pytest.approx(0.1336, abs=0.02)


def with_moments(trials, with_series, n):
    """Add the moments of the recorded runs of B as those of an ensemble."""
    e = -errors(trials, "B")
    cov = np.array([np.cov(e[:, k].T) for k in range(STEPS + 1)])
    entries = [("B", "mean(e)", f"{i}", e.mean(axis=0)[:, i], n) for i in (0, 1)]
    entries += [("B", "cov(e)", f"{i},{j}", cov[:, i, j], n) for i in (0, 1) for j in (0, 1)]
    return with_series(trials, *entries)


def test_an_ensemble_has_the_other_sign(trials, with_series):
    """The series are of x - x_hat; the figure shows x_hat - x, whether from the ensemble or from recorded runs."""
    only_series = replace(with_moments(trials, with_series, RUNS), traces={})
    for table in (only_series, trials):
        (axes,) = EstimationError(order=["B"], component=0).draw(table).axes
        (mean,) = lines(axes, linewidth=1.4)
        np.testing.assert_allclose(mean, errors(trials, "B")[:, :, 0].mean(axis=0), atol=1e-12)
    assert lines(EstimationError(order=["B"], component=0).draw(only_series).axes[0], linewidth=0.5) == []
    assert "Share" not in EstimationError(order=["B"]).caption(only_series)


def test_a_covariance_of_every_run(trials):
    """The median over the runs is drawn, and every run is compared with its own band."""
    rng = np.random.default_rng(4)
    traces = trials.traces["C"]
    scale = rng.uniform(0.5, 2.0, RUNS)
    P = scale[:, None, None, None] * np.diag(VARIANCE) * np.ones((RUNS, STEPS + 1, 1, 1))
    signals = {**traces.signals, "P": P.reshape(RUNS, STEPS + 1, 4)}
    table = replace(trials, traces={"C": traces._replace(signals=signals, shapes={"P": (2, 2)})})
    (axes,) = EstimationError(component=0).draw(table).axes
    np.testing.assert_allclose(lines(axes, color=BLACK)[1], 3 * np.sqrt(np.median(scale) * VARIANCE[0]))
    outside = np.abs(errors(trials, "C")[:, :, 0]) > 3 * np.sqrt(scale * VARIANCE[0])[:, None]
    caption = EstimationError(component=0).caption(table)
    assert f"C {100 * outside.mean():.2g} % (state 0;" in caption and "the median over the runs" in caption
    (axes,) = NeesOverTime().draw(table).axes
    e = errors(trials, "C")
    wanted = (e**2 / (scale[:, None, None] * VARIANCE)).sum(axis=2).mean(axis=0) / 2
    np.testing.assert_allclose(lines(axes, color=COLOURS[2])[-1], wanted)
    # A signal of NaN only, which a method without covariance leaves, counts as none.
    nothing = traces._replace(signals={**signals, "P": np.full((RUNS, STEPS + 1, 4), np.nan)})
    with pytest.raises(DesignError, match="'C' reports no covariance P in its recorded runs"):
        EstimationError(order=["C"]).draw(replace(trials, traces={"C": nothing}))


def test_nees_and_its_band(trials):
    """Oracle: the mean of e_i^2 / P_ii over runs and states; the band of n = 59 and 60 runs differs."""
    (axes,) = NeesOverTime().draw(trials).axes
    for color, name in zip(COLOURS, "AB", strict=False):
        wanted = (errors(trials, name) ** 2 / VARIANCE).mean(axis=(0, 2))
        np.testing.assert_allclose([*lines(axes, color=color)][-1], wanted)
    texts = [text.get_text() for text in axes.get_figure().legends[0].get_texts()]
    assert "A (n = 59)" in texts and "robust (n = 60)" in texts and "95 % band" in texts
    edges = {to_hex(line.get_color()): line for line in axes.lines if line.get_linewidth() == 0.6}
    assert set(edges) == set(COLOURS[:2])


def test_nees_of_the_ensemble_is_that_of_its_runs(trials, with_series):
    """Mean and covariance give the same line as the runs; exact moments are the main line, with no runs left out."""
    ensemble = replace(with_moments(trials, with_series, RUNS), traces={})
    (axes,) = NeesOverTime(order=["B"]).draw(ensemble).axes
    wanted = (errors(trials, "B") ** 2 / VARIANCE).mean(axis=(0, 2))
    np.testing.assert_allclose(lines(axes, color=COLOURS[1])[-1], wanted)
    exact = replace(with_moments(trials, with_series, 0), traces={})
    caption = NeesOverTime(order=["B"]).caption(exact)
    assert "expected values from exact moments" in caption and "exact." in caption and "outside at" not in caption


def test_nees_caption(trials):
    """Shares above and below the band by direct count with the band of scipy.stats."""
    caption = NeesOverTime(level=0.8).caption(trials)
    for name, label in (("A", "A"), ("B", "robust")):
        e = errors(trials, name)
        values = (e**2 / VARIANCE).mean(axis=(0, 2))
        n = len(e)
        low, high = stats.chi2.ppf([0.1, 0.9], 2 * n) / (2 * n)
        failed = ", 1 failed" if name == "A" else ""
        assert f"{label} (n = {n}{failed}): {values.mean():.3g} on average over time" in caption
        above, below = 100 * np.mean(values > high), 100 * np.mean(values < low)
        assert f"above the band at {above:.3g} % and below it at {below:.3g} %" in caption
    assert "outside at 20 % of the samples on average" in caption


def test_nis(trials):
    """Innovations with their own covariance; a missing measurement does not count."""
    rng = np.random.default_rng(6)
    S = 3.0
    e = np.sqrt(S) * rng.standard_normal((RUNS, STEPS + 1, 1))
    e[:10, 5] = np.nan
    signals = {"e": e, "S": np.full((RUNS, STEPS + 1, 1), S)}
    table = replace(trials, traces={"B": Traces(np.arange(RUNS), signals, np.zeros((STEPS + 1, 1)))})
    (axes,) = NeesOverTime(of="nis").draw(table).axes
    np.testing.assert_allclose(lines(axes, color=COLOURS[1])[-1], np.nanmean(e[:, :, 0] ** 2, axis=0) / S)
    assert "n_y" in axes.get_ylabel() and "innovation" in NeesOverTime(of="nis").caption(table)


def test_an_error_outside_of_a_singular_covariance(trials):
    """A gap at that sample, which the caption counts; elsewhere the rank is the number of degrees of freedom."""
    series = trials.series.copy()
    series.loc[(series["component"] == "1,1") & (series["method"] == "B"), "value"] = 0.0
    traces = trials.traces["B"]
    x, x_hat = traces.signals["x"], traces.signals["x_hat"].copy()
    x_hat[:, :, 1] = x[:, :, 1]
    x_hat[0, 7, 1] += 1.0
    table = replace(trials, series=series, traces={"B": traces._replace(signals={"x": x, "x_hat": x_hat})})
    figure = NeesOverTime(order=["B"])
    (axes,) = figure.draw(table).axes
    values = lines(axes, color=COLOURS[1])[-1]
    assert list(np.flatnonzero(np.isnan(values))) == [7]
    wanted = ((x_hat - x)[:, :, 0] ** 2 / VARIANCE[0]).mean(axis=0)
    np.testing.assert_allclose(np.delete(values, 7), np.delete(wanted, 7))
    assert "infinite at 1 samples where an error leaves the range of $P$" in figure.caption(table)


@pytest.mark.parametrize(
    ("figure", "message", "key"),
    [
        (EstimationError(order=["C"]), "'C' reports no covariance P (those that have both: A, B)", "order"),
        (NeesOverTime(order=["A", "C"]), "'C' reports no covariance P (those that have both: A, B)", "order"),
        (EstimationError(component=2), "there is no state 2 (they count from 0 to 1)", "component"),
        (NeesOverTime(of="nis"), "needs recorded e and S", "of"),
        (EstimationError(from_=12.5), "fewer than two samples lie between", "from"),
    ],
)
def test_errors(trials, figure, message, key):
    """What is missing, and the choices."""
    with pytest.raises(DesignError) as error:
        figure.draw(trials)
    assert str(error.value).startswith(message) and error.value.parameter == key


def test_nothing_to_show(make_trials, trials):
    """The way out is a key of the configuration."""
    with pytest.raises(DesignError, match="needs recorded x and x_hat"):
        EstimationError().draw(make_trials({"mse": {"A": [1.0, 2.0]}}))
    with pytest.raises(DesignError, match="no method reports a covariance P; that of"):
        NeesOverTime().draw(replace(trials, series=trials.series.iloc[:0]))


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_panels_fit(trials, n):
    """Side by side at a sufficient width, below each other else; not more than fit."""
    names = [f"M{i}" for i in range(n)]
    series = [trials.series[trials.series["method"] == "B"].assign(method=name) for name in names]
    table = replace(
        trials,
        methods=tuple(names),
        labels={name: name for name in names},
        frame=pd.concat([trials.frame[trials.frame["method"] == "B"].assign(method=name) for name in names]),
        series=pd.concat(series),
        traces={name: trials.traces["B"] for name in names},
        baseline=names[0],
    )
    wide = EstimationError(width=7.0).draw(table) if n <= 4 else EstimationError(width=9.5).draw(table)
    assert len(wide.axes) == 2 * n
    if n > 3:
        with pytest.raises(DesignError, match="panels do not fit"):
            EstimationError(width=3.5).draw(table)


def test_same_bytes(trials, tmp_path):
    """Drawn twice, saved twice."""
    for figure in (EstimationError(), NeesOverTime()):
        for stem in ("one", "other"):
            save_as(figure.draw(trials), tmp_path / f"{stem}.svg")
        assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "other.svg").read_bytes()
