"""What a configuration asks of a figure in vain is a mistake of the file, at its place."""

import pytest
from small_experiment import write

from rmpc_bench import load_config, registry
from rmpc_bench.config.reader import parse
from rmpc_bench.config.schema import model_of, validate
from rmpc_bench.types import ConfigError, ResultLayout


@pytest.mark.parametrize(
    ("figure", "key", "message"),
    [
        ("{kind: trajectories, signals: [x]}", "signals", "'x' is not recorded (recorded: y, u)"),
        ("{kind: trajectories, signals: [y.1]}", "signals", "'y.1' is not a component"),
        ("{kind: trajectories, from: 0.5, to: 0.2}", "from", "the window from 0.5 to 0.2 s is empty"),
        ("{kind: trajectories, from: 7}", "from", "is empty"),
        ("{kind: trajectories, to: 0}", "to", "is empty"),
        ("{kind: series, quantity: gain}", "quantity", "'gain' is no series of these methods (they have K, L, P"),
        ("{kind: series, quantity: P}", "quantity", "has 16 components: choose one"),
        ("{kind: series, quantity: L, component: '4,0'}", "component", "they go from 0,0 to 3,0"),
        ("{kind: series, quantity: L, component: 2}", "component", "they go from 0,0 to 3,0"),
        ("{kind: series, quantity: theta, component: 0}", "component", "it is a number and has none"),
        ("{kind: boxplot, metric: mes}", "metric", "did you mean 'mse'?"),
        ("{kind: boxplot, order: [S-MPC, S-MPC]}", "order", "a method is named twice"),
        ("{kind: boxplot, at: [{controller.Hp: 3}]}", "at", "nothing is swept"),
    ],
)
def test_what_is_asked_in_vain(tmp_path, figure, key, message):
    """One mistake each, with the key to blame."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, record="{runs: 2}", figures=f"[{figure}]"))
    (problem,) = caught.value.problems
    assert problem.path == f"figures.0.{key}" and message in problem.message


def test_nothing_recorded(tmp_path):
    """The way out is in the message."""
    with pytest.raises(ConfigError, match="no run is recorded; record some with `record: {runs: 1}`"):
        load_config(write(tmp_path, figures="[trajectories]"))


def test_more_points_than_panels(tmp_path):
    """A boxplot of seven points has to choose, and may."""
    sweep = "{grid: {controller.Hp: [4, 5, 6, 7, 8, 9, 10]}}"
    with pytest.raises(ConfigError, match="7 points of the sweep do not fit"):
        load_config(write(tmp_path, sweep=sweep, figures="[boxplot]"))
    assert load_config(write(tmp_path, sweep=sweep, figures="[{kind: boxplot, at: [{controller.Hp: 4}]}]")).figures


@pytest.mark.parametrize(
    "figure",
    [
        "trajectories",
        "{kind: trajectories, signals: [x_hat.3, x.0]}",
        "{kind: series, quantity: L}",
        "{kind: series, quantity: P, component: '3,3'}",
        "{kind: series, quantity: theta}",
    ],
)
def test_what_there_is(tmp_path, figure):
    """Nothing to say against it."""
    record = "{runs: 2, signals: [y, u, x, x_hat]}" if "x_hat" in figure else "{runs: 2}"
    assert load_config(write(tmp_path, record=record, figures=f"[{figure}]")).figures


def test_the_usual_signals_are_shown_whatever_else_is_recorded(tmp_path):
    """All components of the states would be too many panels, and nobody has asked for them."""
    record = "{runs: 2, signals: [y, u, x, x_hat]}"
    assert load_config(write(tmp_path, record=record, figures="[trajectories]")).figures
    with pytest.raises(ConfigError, match="'y' is not recorded"):
        load_config(write(tmp_path, record="{runs: 2, signals: [x]}", figures="[trajectories]"))


def test_a_smoke_run_is_shorter_than_its_figures(tmp_path):
    """A window beyond its end is no mistake of the file."""
    path = write(tmp_path, record="{runs: 2}", figures="[{kind: trajectories, from: 0.7}]", smoke="{runs: 1, steps: 2}")
    assert load_config(path, smoke=True).figures


MOMENTS = {"mean(x)": (2,), "mean(x_hat)": (2,), "mean(e)": (2,), "cov(x)": (2, 2), "cov(e)": (2, 2)}
P = {"P": (2, 2)}
NEEDS = ("", "needs ensemble moments: evaluate: [runs, moments]")


def mistakes(kind, text, series, end=10.0, **more):
    """What a figure says against an layout."""
    problems = []
    keys = validate(model_of("figures", kind), parse(text, "f.yaml"), [], problems)
    assert not problems
    parameters = {name: getattr(keys, name) for name in type(keys).model_fields}
    layout = ResultLayout({}, end, series, 1)._replace(**more)
    return registry.get("figures", kind).mistakes(parameters, layout)


@pytest.mark.parametrize(
    ("kind", "text", "series", "found"),
    [
        ("means", "{}", MOMENTS, []),
        ("means", "{}", P, [NEEDS]),
        ("means", "{component: 2}", MOMENTS, [("component", "there is no state 2 (they count from 0 to 1)")]),
        ("means", "{from: 5, to: 2}", MOMENTS, [("from", "the window from 5 to 2 s is empty")]),
        ("variance-with-bound", "{log: true, component: 1}", MOMENTS | P, []),
        ("variance-with-bound", "{}", {}, [NEEDS]),
        ("variance-with-bound", "{}", P, [NEEDS]),
        ("variance-with-bound", "{}", MOMENTS, [("", "none of these methods tells a covariance P of its own")]),
        (
            "variance-with-bound",
            "{}",
            {"cov(e)": (7, 7), "P": (7, 7)},
            [("component", "there are 7 states, at most 6 fit: choose one of 0 to 6")],
        ),
        ("variance-with-bound", "{component: 6}", {"cov(e)": (7, 7), "P": (7, 7)}, []),
        ("ellipses", "{x: a, y: b}", MOMENTS | P, []),
        ("ellipses", "{x: a, y: b}", P, [NEEDS]),
        ("ellipses", "{x: a, y: b}", MOMENTS, [("", "none of these methods tells a covariance P of its own")]),
        (
            "ellipses",
            "{x: a, y: b, components: [0, 2]}",
            MOMENTS | P,
            [("components", "there is no state 2 (they count from 0 to 1)")],
        ),
        (
            "ellipses",
            "{x: a, y: b, components: [1, 1]}",
            MOMENTS | P,
            [("components", "must be two different states")],
        ),
    ],
)
def test_what_figures_of_an_ensemble_ask_for(kind, text, series, found):
    """Moments, and for a bound or an ellipse a P; a state that there is."""
    assert mistakes(kind, text, series) == found


@pytest.mark.parametrize("figure", ["means", "variance-with-bound", "{kind: ellipses, x: mse, y: input_power}"])
def test_an_experiment_without_moments(tmp_path, figure):
    """The way out is in the message, at the figure."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, figures=f"[{figure}]"))
    (problem,) = caught.value.problems
    assert (problem.path, problem.message) == ("figures.0", NEEDS[1])


BELIEFS = {"KF": {"P": (1, 2, 2)}, "MIX": {"P": (101, 2, 2), "M": (101, 2, 2)}, "LP": {"L": (1, 2, 1)}}
STATES = {"y": 1, "x": 2, "x_hat": None}
NEITHER = "tells neither a set M nor a covariance P of its own"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("{}", []),
        ("{run: 1, over: time, components: [1], order: [MIX], level: 99%}", []),
        ("{run: 2}", [("run", "run 2 is not recorded (recorded: 2, from 0 on)")]),
        ("{order: [LP, MIX]}", [("order", f"'LP' {NEITHER}")]),
        ("{order: [unknown]}", []),  # which is said of every figure
        ("{components: [0, 2]}", [("components", "there is no state 2 (they count from 0 to 1)")]),
        ("{components: [1]}", [("components", "must be two different states")]),
        ("{components: [0, 0], over: time}", [("components", "must be two different states")]),
        ("{from: 5, to: 2}", [("from", "the window from 5 to 2 s is empty")]),
    ],
)
def test_what_tubes_ask_for(text, found):
    """A recorded run, methods that believe something, states that there are."""
    assert mistakes("tubes", text, {}, signals=STATES, arrays=BELIEFS, n_recorded=2) == found


@pytest.mark.parametrize("signals", [{}, {"y": 1, "u": 1}, {"x": 2}, {"x_hat": None}])
def test_tubes_need_states_and_estimates(signals):
    """Both; the way out is in the message."""
    message = "needs recorded states and estimates: record: {runs: 1, signals: [x, x_hat]}"
    assert mistakes("tubes", "{}", {}, signals=signals, arrays=BELIEFS, n_recorded=2) == [("", message)]


def test_tubes_of_methods_that_cannot_be_shown():
    """None believes anything; or a filter knows other states than the plant has."""
    silent = mistakes("tubes", "{}", {}, signals=STATES, arrays={"LP": {}}, n_recorded=1)
    assert silent == [("", "none of these methods tells a set M or a covariance P of its own")]
    other = {"KF": {"P": (1, 2, 2)}, "S": {"P": (1, 4, 4)}}
    message = "x_hat of 'S' has 4 components and x of the plant 2: leave the method out with `order`"
    for text, key in (("{}", ""), ("{order: [S, KF]}", "order")):
        assert mistakes("tubes", text, {}, signals=STATES, arrays=other, n_recorded=1) == [(key, message)]
    assert mistakes("tubes", "{order: [KF]}", {}, signals=STATES, arrays=other, n_recorded=1) == []


def test_more_tubes_than_panels():
    """Four methods and two states over time; in a plane there is one panel for each method."""
    arrays = {name: {"P": (1, 2, 2)} for name in "ABCD"}
    message = "8 panels do not fit (at most 6): name fewer methods or states"
    for text, found in (("{over: time}", [("order", message)]), ("{}", []), ("{over: time, components: [0]}", [])):
        assert mistakes("tubes", text, {}, signals=STATES, arrays=arrays, n_recorded=1) == found


def test_tubes_of_an_experiment(tmp_path):
    """Refused at load where nothing is recorded, and for the run that is not."""
    record = "{runs: 2, signals: [x, x_hat]}"
    assert load_config(write(tmp_path, record=record, figures="[{kind: tubes, run: 1, components: [0, 3]}]")).figures
    with pytest.raises(ConfigError, match=r"figures\.0\.run: run 2 is not recorded"):
        load_config(write(tmp_path, record=record, figures="[{kind: tubes, run: 2}]"))
    with pytest.raises(ConfigError, match=r"figures\.0: needs recorded states and estimates"):
        load_config(write(tmp_path, figures="[tubes]"))


REPORTS = {"A": {"Q_yw": (3, 3), "r": (3,)}, "B": {"Q_yw": (3, 3)}, "C": {}}
RECORDED = {"y": 3, "Q_yw": 9, "r": 3, "bursts": 1}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("{signals: [e, Q_yw.8, r.0, bursts]}", []),
        ("{signals: [e.3]}", [("signals", "'e.3' is not a component (they count from e.0)")]),
        ("{signals: [Q_yw.9]}", [("signals", "'Q_yw.9' is not a component (they count from Q_yw.0)")]),
        ("{signals: [e, r, u]}", [("signals", "'u' is not recorded (recorded: y, Q_yw, r, bursts)")]),
        ("{signals: [Q_yw]}", [("signals", "asks for 9 panels (at most 8): choose components such as x.0")]),
    ],
)
def test_trajectories_of_what_is_reported(text, found):
    """Components of a matrix count row by row; the control error is there where y is."""
    assert mistakes("trajectories", text, {}, signals=RECORDED, reports=REPORTS, n_recorded=2) == found


def test_the_control_error_needs_the_output():
    """It is made of it."""
    message = "'e' is not recorded (recorded: u)"
    assert mistakes("trajectories", "{signals: [e]}", {}, signals={"u": 1}, n_recorded=1) == [("signals", message)]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("{signal: Q_yw, run: 1, order: [B]}", []),
        ("{signal: S}", [("signal", "'S' is not recorded (recorded: y, Q_yw, r, bursts)")]),
        ("{signal: r}", [("signal", "r is no square matrix (3): show it with trajectories")]),
        ("{signal: y}", [("signal", "y is no square matrix: show it with trajectories")]),
        ("{signal: Q_yw, run: 2}", [("run", "run 2 is not recorded (recorded: 2, from 0 on)")]),
        ("{signal: Q_yw, order: [A, C]}", [("order", "'C' does not report Q_yw")]),
        ("{signal: Q_yw, width: 3}", [("width", "3 columns need a width of 3.2 inches (got 3)")]),
        ("{signal: Q_yw, to: 0}", [("to", "the window from 0 to 0 s is empty")]),
    ],
)
def test_what_elements_ask_for(text, found):
    """A recorded square matrix of a recorded run, which fits."""
    assert mistakes("elements", text, {}, signals=RECORDED, reports=REPORTS, n_recorded=2) == found


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("{}", []),
        ("{components: [2, 0], run: 1, marks: 0, magnify: 20}", []),
        ("{run: 5}", [("run", "run 5 is not recorded (recorded: 2, from 0 on)")]),
        ("{components: [0, 3]}", [("components", "there is no output 3 (they count from 0 to 2)")]),
        ("{components: [1, 1]}", [("components", "must be two different outputs")]),
        ("{marks: 0.1}", [("marks", "more than 50 time marks cannot be told apart: name a longer time")]),
        ("{marks: 0.1, from: 2, to: 4}", []),
        ("{from: 5, to: 2}", [("from", "the window from 5 to 2 s is empty")]),
    ],
)
def test_what_a_plane_asks_for(text, found):
    """A recorded run, two outputs, marks that can be told apart."""
    assert mistakes("plane", text, {}, signals=RECORDED, n_recorded=2) == found


def test_pictures_of_a_run_need_one():
    """The way out is in the message."""
    message = "no run is recorded; record some with `record: {runs: 1}`"
    for kind, text in (("elements", "{signal: Q_yw}"), ("plane", "{}")):
        assert mistakes(kind, text, {}) == [("", message)]
    message = "needs recorded outputs: record: {runs: 1, signals: [y]}"
    assert mistakes("plane", "{}", {}, signals={"x": 2}, n_recorded=1) == [("", message)]


def test_what_a_pareto_figure_asks_for(tmp_path):
    """Two metrics that there are, and no more points than can be told apart."""
    arrays = {name: {} for name in "ABCD"}
    assert mistakes("pareto", "{x: a, y: b}", {}, arrays=arrays) == []
    assert mistakes("pareto", "{x: a, y: a}", {}, arrays=arrays) == [("y", "must be another metric than x")]
    many = "up to 64 points cannot be told apart (at most 60): name some points of the sweep, or fewer methods"
    assert mistakes("pareto", "{x: a, y: b}", {}, arrays=arrays, n_points=16) == [("at", many)]
    assert mistakes("pareto", "{x: a, y: b, order: [A]}", {}, arrays=arrays, n_points=16) == []
    assert mistakes("pareto", "{x: a, y: b, at: [{k: 1}]}", {}, arrays=arrays, n_points=16) == []
    with pytest.raises(ConfigError, match=r"figures\.0\.y: 'mes' is not a known metric .*did you mean 'mse'"):
        load_config(write(tmp_path, figures="[{kind: pareto, x: input_power, y: mes}]"))
    assert load_config(write(tmp_path, figures="[{kind: pareto, x: input_power, y: mse}]")).figures
