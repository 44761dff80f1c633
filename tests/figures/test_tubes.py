"""One run among the reported sets, read back from the artists."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from conftest import ROUND
from matplotlib.colors import to_hex
from scipy import stats

from rmpc_bench.analysis.traces import Traces
from rmpc_bench.config.reader import parse
from rmpc_bench.config.schema import model_of, validate
from rmpc_bench.figures.files import save
from rmpc_bench.figures.style import BLACK, COLOURS, WHITE
from rmpc_bench.figures.tubes import MOST_ELLIPSES, NO_SET, Tubes
from rmpc_bench.types import DesignError


def tubes(trials, **keys):
    return Tubes(**keys).draw(trials)


N, RUNS = 40, 3
NAMES = ("KF", "ESM", "MIX")
SHAPE = np.array([[4.0, 1.0, 0.5], [1.0, 2.0, 0.2], [0.5, 0.2, 1.0]])
P_KF, P_MIX = 0.25 * SHAPE, 0.1 * SHAPE


def M_of(name, k):
    """The sets of ESM and MIX, that of MIX the same at all k."""
    return (9.0 + k) * SHAPE if name == "ESM" else 4.0 * SHAPE


@pytest.fixture
def states():
    """True states and estimates (runs, samples, 3) by method; the errors of KF are the largest."""
    rng = np.random.default_rng(8)
    x = rng.normal(size=(RUNS, N + 1, 3)).cumsum(axis=1)
    return x, {name: x + rng.normal(size=x.shape) for name in NAMES}


@pytest.fixture
def trials(make_trials, with_series, states):
    """A Kalman filter with P, a set-membership filter with M over k, a mixed estimator with P and a constant M."""
    table = make_trials({"mse": dict.fromkeys(NAMES, [1.0] * RUNS)})
    entries = []
    for i in range(3):
        for j in range(3):
            component = f"{i},{j}"
            entries += [
                ("KF", "P", component, [P_KF[i, j]], 0),
                ("MIX", "P", component, [P_MIX[i, j]], 0),
                ("MIX", "M", component, [M_of("MIX", 0)[i, j]], 0),
                ("ESM", "M", component, [M_of("ESM", k)[i, j] for k in range(N + 1)], 0),
            ]
    x, x_hat = states
    traces = {name: Traces(np.arange(RUNS), {"x": x, "x_hat": x_hat[name]}, np.zeros((N + 1, 1))) for name in NAMES}
    return replace(with_series(table, *entries), traces=traces, Ts=0.5, units={"x": "m"})


def reported(name, k, level=0.95):
    """The shape of the reported set, by its definition."""
    return stats.chi2.ppf(level, 3) * P_KF if name == "KF" else M_of(name, k)


def lines(axes, color, *, marker="None", closed=None):
    """Points of the lines of a colour."""
    found = [line for line in axes.lines if to_hex(line.get_color()) == color and line.get_marker() == marker]
    points = [np.array(line.get_xydata()) for line in found]
    return [each for each in points if closed is None or (len(each) > 100) == closed]


def dots(axes):
    """Fill -> points of the true states."""
    return {to_hex(line.get_mfc()): np.array(line.get_xydata()) for line in axes.lines if line.get_marker() == "o"}


def legend(figure):
    return [text for text in (text.get_text() for text in figure.legends[0].get_texts()) if text]


def test_a_plane_shows_the_states_and_the_reported_sets(trials, states):
    """(z - x_hat)' S^-1 (z - x_hat) = 1 with the part of S that belongs to the two states, at every 10th sample."""
    figure = tubes(trials, run=1, every=10)
    x, x_hat = states
    assert len(figure.axes) == len(NAMES)
    for axes, name, color in zip(figure.axes, NAMES, COLOURS, strict=False):
        (true_state,) = lines(axes, BLACK)
        np.testing.assert_array_equal(true_state, x[1][:, :2])
        (estimate,) = lines(axes, color, closed=False)
        np.testing.assert_array_equal(estimate, x_hat[name][1][:, :2])
        rings = lines(axes, color, closed=True)
        assert len(rings) == 5
        for k, ring in zip(range(0, N + 1, 10), rings, strict=True):
            gap, S = ring - x_hat[name][1][k, :2], reported(name, k)[:2, :2]
            np.testing.assert_allclose(np.einsum("pi,ij,pj->p", gap, np.linalg.inv(S), gap), 1.0, rtol=1e-9)
            np.testing.assert_allclose(gap.max(axis=0), np.sqrt(np.diag(S)), rtol=1e-3)  # between two of 181 points
        assert axes.get_ylabel() == "$x_1$ [m]" and axes.texts[0].get_text() == name
        assert to_hex(axes.texts[0].get_color()) == color
    assert figure.axes[-1].get_xlabel() == "$x_0$ [m]"
    assert figure.axes[0].get_title() == "run 1, t = 0 to 20 s, ellipses every 10 samples"


def test_true_states_outside_are_hollow(trials, states):
    """Oracle: the quadratic form of the shadow, by a solve; both kinds there are."""
    figure = tubes(trials, run=2, every=1, level=0.5)
    x, x_hat = states
    for axes, name in zip(figure.axes, NAMES, strict=True):
        e = (x_hat[name] - x)[2][:, :2]
        sizes = [e[k] @ np.linalg.solve(reported(name, k, 0.5)[:2, :2], e[k]) for k in range(N + 1)]
        outside = np.array(sizes) > 1.0
        found = dots(axes)
        np.testing.assert_array_equal(found[WHITE], x[2][outside][:, :2])
        np.testing.assert_array_equal(found[BLACK], x[2][~outside][:, :2])
    assert 0 < len(dots(figure.axes[0])[WHITE]) < N + 1
    assert figure.axes[0].get_title() == "run 2, t = 0 to 20 s, every sample"
    assert legend(figure) == ["true state", "estimate", "set $M$", "50 % of $P$", "outside"]


def test_the_legend_says_what_there_is(trials):
    """Of sets alone no ellipsoid of P; nothing outside where nothing is."""
    figure = tubes(trials, order=["ESM"])
    assert legend(figure) == ["true state", "estimate", "set $M$"]
    assert "outside" in legend(tubes(trials, order=["KF"], level=0.5)) and len(figure.axes) == 1


def test_a_dozen_ellipses_by_default(trials):
    """At most; the ends of the window are in seconds."""
    figure = tubes(trials)
    assert 10 <= len(lines(figure.axes[1], COLOURS[1], closed=True)) <= MOST_ELLIPSES
    short = tubes(trials, from_=2.0, to=4.0)
    assert len(lines(short.axes[1], COLOURS[1], closed=True)) == 5
    assert short.axes[0].get_title() == "run 0, t = 2 to 4 s, every sample"


@pytest.mark.parametrize(("components", "order"), [((2,), list(NAMES)), ((1, 0), ["ESM", "KF"])])
def test_over_time_the_band_is_as_wide_as_the_set(trials, states, components, order):
    """x_hat +- sqrt(S_ii); what lies beyond is hollow; a panel for every state and method, states first."""
    figure = tubes(trials, over="time", components=components, order=order, from_=5.0)
    x, x_hat = states
    k = np.arange(10, N + 1)
    panels = [(i, name) for i in components for name in order]
    for axes, (i, name) in zip(figure.axes, panels, strict=True):
        color, centre = COLOURS[NAMES.index(name)], x_hat[name][0][k, i]
        half = np.array([np.sqrt(reported(name, each)[i, i]) for each in k])
        low, high, middle = lines(axes, color)
        np.testing.assert_allclose(low, np.stack([0.5 * k, centre - half], axis=1), **ROUND)
        np.testing.assert_allclose(high, np.stack([0.5 * k, centre + half], axis=1), **ROUND)
        np.testing.assert_array_equal(middle, np.stack([0.5 * k, centre], axis=1))
        (true_state,) = lines(axes, BLACK)
        np.testing.assert_array_equal(true_state[:, 1], x[0][k, i])
        beyond = np.abs(x[0][k, i] - centre) > half
        np.testing.assert_array_equal(dots(axes)[WHITE], true_state[beyond])
        assert len(dots(axes)[BLACK]) == 0
        assert axes.get_ylabel() == f"$x_{i}$ [m]" and axes.texts[0].get_text() == name
    assert figure.axes[-1].get_xlabel() == "$t$ [s]" and figure.axes[-1].get_xlim() == (5.0, 20.0)
    assert figure.axes[0].get_title() == "run 0"


def test_panels_of_the_same_states_have_one_scale(trials):
    """So that sizes can be compared, and nothing is cut off."""
    for figure, groups in ((tubes(trials), [[0, 1, 2]]), (tubes(trials, over="time"), [[0, 1, 2], [3, 4, 5]])):
        for group in groups:
            assert len({figure.axes[number].get_ylim() for number in group}) == 1
        for axes in figure.axes:
            low, high = axes.get_ylim()
            assert low < axes.dataLim.y0 and axes.dataLim.y1 < high


def test_a_method_that_failed_is_named_and_does_not_shrink_the_others(trials):
    """Its run went far away."""
    frame = trials.frame.copy()
    frame.loc[(frame["method"] == "KF") & (frame["run"] == 0), "status"] = "diverged"
    wild = trials.traces["KF"]._replace(
        signals={"x": np.full((RUNS, N + 1, 3), 1e99), "x_hat": np.zeros((RUNS, N + 1, 3))}
    )
    figure = tubes(replace(trials, frame=frame, traces=trials.traces | {"KF": wild}), every=10)
    assert figure.axes[0].get_title() == "run 0, t = 0 to 20 s, ellipses every 10 samples,\nKF diverged"
    expected = tubes(trials, order=["ESM", "MIX"], every=10)
    assert figure.axes[0].get_ylim() == expected.axes[0].get_ylim()
    assert figure.axes[0].get_xlim() == expected.axes[0].get_xlim()


def test_a_set_that_is_a_segment(trials, states):
    """Drawn as one; what lies beside it is outside."""
    series = trials.series.copy()
    mixed = (series["method"] == "MIX") & (series["quantity"] == "M")
    series.loc[mixed, "value"] = 4.0
    axes = tubes(replace(trials, series=series), order=["MIX"], every=20).axes[0]
    segments = [each for each in lines(axes, COLOURS[2]) if len(each) == 2]
    centres = states[1]["MIX"][0][::20, :2]
    np.testing.assert_allclose(
        sorted(map(tuple, (each[0] for each in segments))), sorted(map(tuple, centres + 2)), **ROUND
    )
    assert len(dots(axes)[WHITE]) == 3


def test_what_is_no_shape(trials):
    """The figure is left out with a reason."""
    series = trials.series.copy()
    series.loc[
        (series["method"] == "MIX") & (series["quantity"] == "M") & (series["component"] == "0,0"), "value"
    ] = -4.0
    with pytest.raises(DesignError, match="a reported set is not an ellipsoid: its matrix has a negative eigenvalue"):
        tubes(replace(trials, series=series))


@pytest.mark.parametrize(
    ("given", "parameter", "message"),
    [
        ({"run": 3}, "run", "run 3 is not recorded (recorded: 0, 1, 2)"),
        ({"components": (0, 3)}, "components", "there is no state 3 (they count from 0 to 2)"),
        ({"components": (1, 1)}, "components", "must be two different states"),
        ({"components": (1,)}, "components", "must be two different states"),
        ({"components": (1, 1), "over": "time"}, "components", "must be two different states"),
        ({"order": ["D"]}, "order", "'D' is not a known method; known: KF, ESM, MIX"),
        ({"from_": 20.0}, "from", "fewer than two samples lie between `from` and `to` (there are 0 to 20)"),
        ({"height": 0.5}, "height", "must be at least 1 inch (got 0.5)"),
    ],
)
def test_errors_show_the_choices(trials, given, parameter, message):
    """A figure that cannot be drawn is left out with a reason."""
    with pytest.raises(DesignError) as error:
        tubes(trials, **given)
    assert (str(error.value), error.value.parameter) == (message, parameter)


def test_a_method_that_reports_no_set_or_was_not_recorded(trials):
    """It is not shown unless asked for; without any other there is no figure."""
    silent = replace(trials, series=trials.series[trials.series["method"] != "KF"])
    assert [axes.texts[0].get_text() for axes in tubes(silent).axes] == ["ESM", "MIX"]
    with pytest.raises(DesignError, match="'KF' reports neither a set M nor a covariance P"):
        tubes(silent, order=["KF"])
    for table, message in (
        (replace(trials, series=trials.series.iloc[:0]), NO_SET),
        (replace(trials, traces={}), "needs recorded x and x_hat: record: {runs: 1, signals: [x, x_hat]}"),
    ):
        with pytest.raises(DesignError) as error:
            tubes(table)
        assert str(error.value) == message


def test_more_panels_than_fit(trials):
    """Four methods and two states over time; fewer of either will do."""
    also = {
        name: pd.concat([table, table[table["method"] == "KF"].assign(method="D")])
        for name, table in (("series", trials.series), ("frame", trials.frame))
    }
    traces = trials.traces | {"D": trials.traces["KF"]}
    table = replace(trials, methods=(*NAMES, "D"), traces=traces, **also)
    with pytest.raises(DesignError, match="8 panels do not fit .* .at most 6.: name fewer methods or states"):
        tubes(table, over="time")
    assert len(tubes(table, over="time", components=(0,)).axes) == 4


def test_a_point_of_a_sweep(trials, make_sweep):
    """Named above the run."""
    sweep = make_sweep(({"model.d": "1"}, trials), ({"model.d": "2"}, trials))
    assert tubes(sweep, over="time", at={"model.d": 2}).axes[0].get_title() == "d=2\nrun 0"


def test_same_bytes(trials, tmp_path):
    """Drawn twice, saved twice."""
    for over in ("plane", "time"):
        paths = [save(tubes(trials, over=over, order=["KF"]), tmp_path, stem) for stem in ("one", "other")]
        assert [path.read_bytes() for path in paths[0]] == [path.read_bytes() for path in paths[1]]


def test_keys():
    """As a configuration writes them."""
    problems = []
    text = "{over: time, run: 2, components: [1], from: 5, every: 4, level: 99%}"
    keys = validate(model_of("figures", "tubes"), parse(text, "f.yaml"), [], problems)
    assert not problems and (keys.over, keys.run, keys.components) == ("time", 2, (1,))
    assert (keys.from_, keys.every, keys.level) == (5.0, 4, 0.99)
    validate(
        model_of("figures", "tubes"),
        parse("{over: space, run: -1, level: 1, every: 0, components: []}", "f.yaml"),
        [],
        problems,
    )
    assert sorted(str(problem).split(": ", 1)[1] for problem in problems) == [
        "components: has too few entries (got a list of 0)",
        "every: must be >= 1 (got 0)",
        "level: must be < 1 (got 1)",
        "over: must be 'plane' or 'time' (got 'space')",
        "run: must be >= 0 (got -1)",
    ]
