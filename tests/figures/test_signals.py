"""Signals and other quantities over time, read back from the artists and compared with the stored numbers."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from data_frames import arrays
from data_frames import series as series_of
from matplotlib.colors import to_hex
from scipy import stats

from rmpc_bench.analysis.traces import Traces
from rmpc_bench.figures.files import page_svg
from rmpc_bench.figures.labels import symbol
from rmpc_bench.figures.palette import BAND, INK, METHODS, PRINT
from rmpc_bench.figures.signal_content import MOST_THIN, WORDS, needed_points
from rmpc_bench.figures.signals import Signals
from rmpc_bench.types import DesignError

RUNS, STEPS = 60, 25
T = 0.5 * np.arange(STEPS + 1)
VARIANCE = np.array([4.0, 0.25])
FACTOR = {"A": 1.0, "B": 2.0, "C": 1.0}
"""Actual standard deviation of the errors of a method, relative to the reported one."""


@pytest.fixture
def trials(make_trials, with_series):
    """A is consistent, B has errors of twice its reported size, C has no covariance; run 3 of A failed."""
    rng = np.random.default_rng(11)
    values = {name: [float(i) for i in rng.permutation(RUNS)] for name in "ABC"}
    values["A"][3] = "diverged"
    table = make_trials({"mse": values}, labels={"B": "robust"})
    entries = [
        (name, "P", f"{i},{j}", (VARIANCE[i] if i == j else 0.0) * np.ones(STEPS + 1), 0)
        for name, i, j in product("AB", (0, 1), (0, 1))
    ]
    traces = {}
    for name in "ABC":
        x = rng.standard_normal((RUNS, STEPS + 1, 2)).cumsum(axis=1)
        e = FACTOR[name] * np.sqrt(VARIANCE) * rng.standard_normal(x.shape)
        if name == "A":
            e[3], x[3] = 1e6, 1e6
        u = rng.uniform(-1, 1, (RUNS, STEPS, 1))
        signals = {"y": x[:, :, :1], "u": u, "x": x, "x_hat": x + e}
        traces[name] = Traces(np.arange(RUNS), signals, np.ones((STEPS + 1, 1)))
    limits = {"A": {"u": (-1.5, 1.5), "x.1": (None, 3.0)}, "B": {"u": (-50.0, 50.0)}}
    made = replace(with_series(table, *entries), traces=traces, Ts=0.5, units={"x": "m", "y": "m"}, limits=limits)
    return replace(made, names={"u.0": "voltage"})


def panel(figure, row, column, n_columns=3):
    return figure.axes[row * n_columns + column]


def lines(axes, kind, color=INK):
    """Values (points, 2) of the lines of a kind in a panel, those drawn first before others."""
    how = WORDS[kind].style
    wanted = to_hex(how["color"] or color, keep_alpha=True), how.get("zorder")
    found = [line for line in axes.lines if (to_hex(line.get_color(), keep_alpha=True), line.get_zorder()) == wanted]
    return [np.asarray(line.get_xydata()) for line in found]


def split(line):
    return [piece[~np.isnan(piece[:, 1])] for piece in np.split(line, np.flatnonzero(np.isnan(line[:, 1])) + 1)][:-1]


def errors(trials, name):
    """(runs, samples, n) of the runs that finished."""
    signals = trials.traces[name].signals
    return np.delete(signals["x_hat"] - signals["x"], [3] if name == "A" else [], axis=0)


def test_a_panel_per_method_and_signal(trials):
    """The thick line is the run with the middle MSE, every thin one a run; steps for the input; names are keys."""
    figure = Signals(signals=["y", "u"]).draw(trials)
    assert [axes.get_title(loc="left") for axes in figure.axes[:3]] == ["A", "B", "C"]
    assert panel(figure, 0, 0).get_ylabel() == "$y$ [m]" and panel(figure, 1, 0).get_ylabel() == "voltage"
    assert [axes.get_xlabel() for axes in figure.axes] == [""] * 3 + ["$t$ [s]"] * 3
    for column, name in enumerate("ABC"):
        table = trials.frame[(trials.frame["method"] == name) & (trials.frame["status"] == "ok")]
        ordered = table.sort_values("mse")["run"].to_numpy()
        middle = ordered[len(ordered) // 2]
        for row, signal in enumerate("yu"):
            axes = panel(figure, row, column)
            values = trials.traces[name].signals[signal][:, :, 0]
            (main,) = lines(axes, "main", METHODS[column])
            t, expected = T, values[middle]
            if signal == "u":
                t, expected = np.repeat(T, 2)[1:-1], np.repeat(expected, 2)
                main = main[:-1]
            np.testing.assert_array_equal(main, np.stack([t, expected], axis=1))
            (thin,) = lines(axes, "run")
            for piece in split(thin):
                at = np.rint(piece[:, 0] / 0.5).astype(int)
                found = np.take(np.concatenate([values, values[:, -1:]], axis=1), at, axis=1)
                run = np.flatnonzero((found == piece[:, 1]).all(axis=1))
                assert len(run) == 1 and (name, run[0]) != ("A", 3)
        (reference,) = lines(panel(figure, 0, column), "reference")
        assert (reference[:, 1] == 1.0).all()


def test_all_panels_of_a_row_have_the_same_axes(trials):
    figure = Signals(signals=["y", "u"], from_=1.0, to=9.0).draw(trials)
    for row, signal in enumerate("yu"):
        limits = {(panel(figure, row, k).get_xlim(), panel(figure, row, k).get_ylim()) for k in range(3)}
        ((x, y),) = limits
        assert x == (1.0, 9.0)
        values = [np.delete(trials.traces[name].signals[signal][:, :, 0], 3, axis=0) for name in "ABC"]
        good = np.concatenate(values)[:, 2:19]
        assert y[0] < good.min() and good.max() < y[1] < 100


def test_limits_of_the_controller(trials):
    """Those in reach are drawn, in the panels of their method; one far away would flatten the curves."""
    figure = Signals(signals=["u", "x.1"]).draw(trials)
    colour = to_hex(PRINT["worse"], keep_alpha=True)
    drawn = [
        {line.get_ydata()[0] for line in axes.lines if to_hex(line.get_color(), keep_alpha=True) == colour}
        for axes in figure.axes
    ]
    assert drawn == [{-1.5, 1.5}, set(), set(), {3.0}, set(), set()]
    assert panel(figure, 0, 1).get_ylim()[1] < 2 and "dotted: limit" in Signals(signals=["u"]).caption(trials)


@pytest.mark.parametrize("n", [1, 3, 4, 5, 9, 20])
def test_any_number_of_methods(make_trials, record, n):
    """At most four columns; every method has its panels, and the ninth is grey; the caption says that more do not fit.

    More methods that are named are an error.
    """
    names = [f"M{i}" for i in range(n)]
    table = record(make_trials({"mse": {name: [1.0, 2.0] for name in names}}), dict.fromkeys(names, 2))
    assert ("the first 9 methods are shown" in Signals().caption(table)) == (n > 9)
    if n > 9:
        with pytest.raises(DesignError, match="40 panels do not fit into one figure"):
            Signals(order=names).draw(table)
        return
    figure = Signals().draw(table)
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert len(shown) == 2 * n and [t for axes in shown if (t := axes.get_title(loc="left"))] == names
    assert {axes.get_xlim() for axes in shown} == {(0.0, 20.0)} and figure.get_figwidth() == 7.2
    assert all(axes.get_position().width > 0.14 for axes in shown)


def test_shows(trials):
    """Median and band, their width, and differences in paired runs; oracle: numpy."""
    y = trials.traces["B"].signals["y"][:, :, 0]
    low, middle, high = np.quantile(y, [0.05, 0.5, 0.95], axis=0)
    axes = panel(Signals(signals=["y"], show="band").draw(trials), 0, 1)
    np.testing.assert_array_equal(lines(axes, "main", METHODS[1])[0][:, 1], middle)
    outline = axes.patches[0].get_xy()
    assert {*outline[:, 1]} <= {*low, *high} and {*outline[:, 0]} <= {*T}
    axes = panel(Signals(signals=["y"], show="width").draw(trials), 0, 1)
    np.testing.assert_array_equal(lines(axes, "main", METHODS[1])[0][:, 1], high - low)
    assert lines(axes, "average", METHODS[1])[0][0, 1] == pytest.approx((high - low).mean())
    figure = Signals(signals=["y"], show="difference", run=7).draw(trials)
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["B", "C"]
    (main,) = lines(figure.axes[0], "main", METHODS[1])
    np.testing.assert_array_equal(main[:, 1], y[7] - trials.traces["A"].signals["y"][7, :, 0])


def test_runs_that_failed(trials):
    """Left out where others finished; shown up to their failure where none did, without changing the axis."""
    frame = trials.frame.copy()
    frame.loc[frame["method"] == "C", ["status", "mse"]] = ["diverged", np.nan]
    signals = {name: values.copy() for name, values in trials.traces["C"].signals.items()}
    for name in ("x", "y", "x_hat"):
        signals[name][:, 10:] = 1e9
    table = replace(
        trials, columns=arrays(frame), traces=trials.traces | {"C": trials.traces["C"]._replace(signals=signals)}
    )
    figure = Signals(signals=["y"]).draw(table)
    (main,) = lines(figure.axes[2], "main", METHODS[2])
    assert np.isnan(main[12:, 1]).all() and figure.axes[2].get_ylim()[1] < 100
    assert "all recorded runs of C failed" in Signals(signals=["y"]).caption(table)


def test_errors_with_the_reported_band(trials):
    """Oracle: 3 roots of the diagonal of P; mean and standard deviation by numpy; a method without P has no band."""
    figure = Signals(signals=["error"], run=5).draw(trials)
    for column, name in enumerate("ABC"):
        e = errors(trials, name)
        for state in (0, 1):
            axes = panel(figure, state, column)
            assert len(axes.patches) == (name != "C")
            if name != "C":
                assert {*np.abs(axes.patches[0].get_xy()[:, 1])} == {3 * np.sqrt(VARIANCE[state])}
            below, above = (line[:, 1] for line in lines(axes, "spread", METHODS[column]))
            mean, std = e[:, :, state].mean(axis=0), e[:, :, state].std(axis=0, ddof=1)
            np.testing.assert_allclose([below, above], [mean - 3 * std, mean + 3 * std])
            (main,) = lines(axes, "main", METHODS[column])
            np.testing.assert_array_equal(main[:, 1], e[5 - (name == "A"), :, state])
    assert "[m]" in figure.axes[0].get_ylabel()


def with_moments(trials, with_series, n):
    """Add the moments of the recorded runs of B as those of an ensemble."""
    e = -errors(trials, "B")
    cov = np.array([np.cov(e[:, k].T) for k in range(STEPS + 1)])
    entries = [("B", "mean(e)", f"{i}", e.mean(axis=0)[:, i], n) for i in (0, 1)]
    entries += [("B", "cov(e)", f"{i},{j}", cov[:, i, j], n) for i in (0, 1) for j in (0, 1)]
    return with_series(trials, *entries)


def test_variance_with_its_bound_and_the_sign_of_an_ensemble(trials, with_series):
    """Solid the exact one, pale from runs, dashed the reported one; the figure shows x_hat - x, a series x - x_hat."""
    table = with_moments(with_moments(trials, with_series, 500), with_series, 0)
    figure = Signals(signals=["variance"]).draw(table)
    for state in (0, 1):
        axes = figure.axes[state]
        expected = errors(trials, "B")[:, :, state].var(axis=0, ddof=1)
        np.testing.assert_allclose(lines(axes, "main", METHODS[1])[0][:, 1], expected)
        assert (lines(axes, "bound")[0][:, 1] == VARIANCE[state]).all()
        assert any(line.get_alpha() == 0.5 for line in axes.lines)
    assert "var $e_0$ [m$^{2}$]" in figure.axes[0].get_ylabel()
    table = replace(with_moments(trials, with_series, RUNS), traces={})
    (main,) = lines(Signals(signals=["error.0"]).draw(table).axes[0], "main", METHODS[1])
    np.testing.assert_allclose(main[:, 1], errors(trials, "B")[:, :, 0].mean(axis=0), atol=1e-12)


@pytest.mark.parametrize("exact", [False, True])
def test_nees_and_its_band(trials, with_series, exact):
    """Oracle: the mean of e_i^2 / P_ii over runs and states, and chi-square of scipy with the runs of each method."""
    table = replace(with_moments(trials, with_series, RUNS), traces={}) if exact else trials
    figure = Signals(signals=["nees"], level=0.8).draw(table)
    names = "B" if exact else "AB"
    for column, name in enumerate(names):
        axes, e = figure.axes[column], errors(trials, name)
        (main,) = lines(axes, "main", METHODS["AB".index(name)])
        np.testing.assert_allclose(main[:, 1], (e**2 / VARIANCE).mean(axis=(0, 2)))
        ends = stats.chi2.ppf([0.1, 0.9], 2 * len(e)) / (2 * len(e))
        found = axes.patches[0].get_xy()[:, 1]
        np.testing.assert_allclose([found.min(), found.max()], ends)
        assert axes.get_yscale() == "log"
    assert "80 % band of a consistent estimator" in Signals(signals=["nees"], level=0.8).caption(table)


def test_nis_and_an_error_outside_of_a_singular_covariance(trials):
    """A missing measurement does not count; a gap where no rank fits, else it is the number of degrees of freedom."""
    e = np.sqrt(3.0) * np.random.default_rng(6).standard_normal((RUNS, STEPS + 1, 1))
    e[:10, 5] = np.nan
    signals = {"e": e, "S": np.full((RUNS, STEPS + 1, 1), 3.0)}
    table = replace(trials, traces={"B": Traces(np.arange(RUNS), signals, np.zeros((STEPS + 1, 1)))})
    axes = Signals(signals=["nis"], log=False).draw(table).axes[0]
    np.testing.assert_allclose(lines(axes, "main", METHODS[1])[0][:, 1], np.nanmean(e[:, :, 0] ** 2, axis=0) / 3.0)
    assert "n_y" in axes.get_ylabel()
    series = trials.series.copy()
    series.loc[(series["component"] == "1,1") & (series["method"] == "B"), "value"] = 0.0
    x, x_hat = (trials.traces["B"].signals[name].copy() for name in ("x", "x_hat"))
    x_hat[:, :, 1] = x[:, :, 1]
    x_hat[0, 7, 1] += 1.0
    traces = {"B": trials.traces["B"]._replace(signals={"x": x, "x_hat": x_hat})}
    axes = Signals(signals=["nees"]).draw(replace(trials, over_time=series_of(series), traces=traces)).axes[0]
    values = lines(axes, "main", METHODS[1])[0][:, 1]
    assert list(np.flatnonzero(np.isnan(values))) == [7]
    wanted = ((x_hat - x)[:, :, 0] ** 2 / VARIANCE[0]).mean(axis=0)
    np.testing.assert_allclose(np.delete(values, 7), np.delete(wanted, 7))


def test_tubes(trials):
    """The run, its estimate, and the projection of the ellipsoid of P; states outside of it are circles."""
    axes = Signals(signals=["tube.1"], run=4, level=0.95, order=["B"]).draw(trials).axes[0]
    x, x_hat = (trials.traces["B"].signals[name][4, :, 1] for name in ("x", "x_hat"))
    half = np.sqrt(stats.chi2.ppf(0.95, 2) * VARIANCE[1])
    np.testing.assert_array_equal(lines(axes, "main", METHODS[1])[0][:, 1], x_hat)
    np.testing.assert_array_equal(lines(axes, "state")[0][:, 1], x)
    edges = axes.patches[0].get_xy()
    at = np.rint(edges[:, 0] / 0.5).astype(int)
    np.testing.assert_allclose(np.abs(edges[:, 1] - x_hat[at]), half)
    (outside,) = lines(axes, "outside")
    np.testing.assert_array_equal(np.isfinite(outside[:, 1]), np.abs(x - x_hat) > half)


def test_series_means_and_bursts(trials, with_series):
    """A constant covers the window; the mean of the state is black; bursts are bands, half a sample beyond theirs."""
    entries = [("B", "L", "1,0", [7.0], 0), ("B", "L", "0,0", [5.0], 0)]
    entries += [("B", f"mean({name})", f"{i}", i + T, 0) for name in ("x", "x_hat") for i in (0, 1)]
    figure = Signals(signals=["L.1,0", "mean"], log=True).draw(with_series(trials, *entries))
    assert figure.axes[0].get_ylabel() == "$L_{1,0}$" and figure.axes[0].get_yscale() == "log"
    assert lines(figure.axes[0], "main", METHODS[1])[0].tolist() == [[0.0, 7.0], [12.5, 7.0]]
    np.testing.assert_array_equal(lines(figure.axes[2], "state")[0][:, 1], 1 + T)
    assert figure.axes[1].get_yscale() == "linear" and "linear" in figure.axes[1].get_ylabel()
    flags = np.zeros((RUNS, STEPS + 1, 1))
    flags[:, 4:6] = 1.0
    for differ, expected in ((False, [(1.75, 2.75)]), (True, [])):
        flags[0, 9] = differ
        traces = {n: t._replace(signals={**t.signals, "bursts": flags}) for n, t in trials.traces.items()}
        axes = Signals(signals=["y"]).draw(replace(trials, traces=traces)).axes[0]
        bands = [p for p in axes.patches if to_hex(p.get_facecolor()) == BAND]
        assert [(p.get_x(), p.get_x() + p.get_width()) for p in bands] == expected


def test_what_cannot_be_drawn(trials):
    for table, keys, message in (
        (trials, {"signals": ["nis"]}, "'nis' needs recorded e and S"),
        (trials, {"order": ["C"], "signals": ["nees"]}, r"'C' has none of nees \(those that have: A, B\)"),
        (replace(trials, traces={}), {}, "no run is recorded; record some with"),
    ):
        with pytest.raises(DesignError, match=message) as error:
            Signals(**keys).draw(table)
        assert error.value.parameter == next(iter(keys), "")


def test_files_are_small_and_symbols_are_formulas(trials):
    """Noise is the worst case: 60 runs of three methods stay below the size of a fold."""
    figure = Signals().draw(trials)
    assert len(page_svg(figure, "signals")) <= 50_000
    assert sum(len(lines(axes, "run")[0]) for axes in figure.axes) <= 1.1 * MOST_THIN
    shown = {("x_hat", ""): r"$\hat{x}$", ("Q_yw", "0,1"): "$(Q_{yw})_{0,1}$", ("load", "2"): "load[2]"}
    assert {given: symbol(*given) for given in shown} == shown and symbol("theta", "") == r"$\theta$"


def test_points_that_a_line_needs():
    """Oracle: the distance of every point from the broken line through the kept ones."""
    t = np.linspace(0, 10, 400)
    values = np.exp(-t) * np.sin(5 * t)
    kept = needed_points(t, values, 2.0, 0.01)
    assert len(kept) < 60
    points = np.stack([1.5 * t / 10, values / 2.0], axis=1)
    fine = np.linspace(0, 10, 200_001)
    line = np.stack([1.5 * fine / 10, np.interp(fine, t[kept], values[kept]) / 2.0], axis=1)
    away = [np.hypot(*(line - point).T).min() for point in points]
    assert 0.001 < max(away) <= 0.01 + 1e-3
    values[100:110] = np.nan
    kept = needed_points(t, values, 2.0, 0.01)
    assert {99, 110, *range(100, 110)} <= {*kept.tolist()}
