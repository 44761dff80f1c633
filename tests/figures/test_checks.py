"""What a figure requires and the results will not have is an error of the configuration, at its place."""

import subprocess
import sys

import pytest
from small_experiment import write

from rmpc_bench import load_config, registry
from rmpc_bench.config.component import plain_data
from rmpc_bench.config.reader import parse
from rmpc_bench.config.schema import model_of, validate
from rmpc_bench.execution.evaluation import figure_component
from rmpc_bench.registry import names
from rmpc_bench.types import ConfigError, DesignError, OnePointFigure, ResultLayout


@pytest.mark.parametrize(
    ("figure", "key", "message"),
    [
        ("{kind: signals, signals: [x]}", "signals", "'x' is not recorded (recorded: y, u; series: K, L"),
        ("{kind: signals, signals: [y.1]}", "signals", "'y.1' is not a component (they count from y.0 to y.0)"),
        (
            "{kind: signals, from: 0.5, to: 0.2}",
            "from",
            "fewer than two samples lie between `from` and `to` (there are 0 to 1)",
        ),
        ("{kind: signals, from: 7}", "from", "lie between `from` and `to` (there are 0 to 1)"),
        ("{kind: signals, to: 0}", "to", "fewer than two samples"),
        ("{kind: signals, signals: [gain]}", "signals", "'gain' is not recorded (recorded: y, u; series: "),
        ("{kind: signals, signals: [P]}", "signals", "16 rows of panels do not fit into one figure (at most 8)"),
        ("{kind: signals, signals: ['L.4,0']}", "signals", "(they count from L.0,0 to L.3,0)"),
        ("{kind: signals, signals: [L.2]}", "signals", "(they count from L.0,0 to L.3,0)"),
        ("{kind: signals, signals: [theta.0]}", "signals", "it is a number and has none"),
        ("{kind: boxplot, metric: mes}", "metric", "did you mean 'mse'?"),
        ("{kind: boxplot, order: [S-MPC, S-MPC]}", "order", "must name at least one method, and each one once"),
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
        load_config(write(tmp_path, figures="[signals]"))


@pytest.mark.parametrize("figures", ["[sweep]", "[boxplot]", "[rows]", "[]"])
@pytest.mark.parametrize("n_points", [1, 7, 12])
def test_no_number_of_points_is_refused(tmp_path, figures, n_points):
    """Whatever the figures ask for."""
    sweep = f"{{grid: {{controller.Hp: {[*range(4, 4 + n_points)]}}}}}"
    load_config(write(tmp_path, sweep=sweep, figures=figures))


def test_the_default_figure_is_that_of_the_experiment(tmp_path):
    """A boxplot at one point, the changes over a sweep."""
    without = {"figures": None}
    assert [figure.kind for figure in load_config(write(tmp_path, **without)).figures] == ["boxplot"]
    swept = write(tmp_path, sweep="{grid: {controller.Hp: [4, 5]}}", **without)
    assert [figure.kind for figure in load_config(swept).figures] == ["sweep"]


@pytest.mark.parametrize(
    ("figure", "message"),
    [
        ("paired", "figures.0: 'paired' is now 'rows' (rmpc-bench list figures)"),
        ("{kind: shares}", "figures.0.kind: 'shares' is now 'rows' with show: share (rmpc-bench list figures)"),
        (
            "{kind: rows, show: median}",
            "figures.0.show: 'median' is not known; known: values, change, mean, share, rank",
        ),
        ("{kind: sweep}", "figures.0.path: nothing is swept in this configuration"),
    ],
)
def test_what_an_earlier_version_drew_is_named(tmp_path, figure, message):
    """One line with the place in the file and what takes its place."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, figures=f"[{figure}]"))
    (line,) = str(caught.value).splitlines()
    assert message in line and not set(registry.RENAMED_FIGURES) & set(registry.names("figures"))


@pytest.mark.parametrize(
    "figure",
    [
        "signals",
        "{kind: signals, signals: [x_hat.3, x.0]}",
        "{kind: signals, signals: [L]}",
        "{kind: signals, signals: ['P.3,3']}",
        "{kind: signals, signals: [theta, y]}",
    ],
)
def test_what_there_is(tmp_path, figure):
    """Nothing to say against it."""
    record = "{runs: 2, signals: [y, u, x, x_hat]}" if "x_hat" in figure else "{runs: 2}"
    assert load_config(write(tmp_path, record=record, figures=f"[{figure}]")).figures


def test_the_usual_signals_are_shown_whatever_else_is_recorded(tmp_path):
    """All components of the states would be too many panels, and nobody has asked for them."""
    record = "{runs: 2, signals: [y, u, x, x_hat]}"
    assert load_config(write(tmp_path, record=record, figures="[signals]")).figures
    with pytest.raises(ConfigError, match="'[yu]' is not recorded|no run is recorded"):
        load_config(write(tmp_path, record="{runs: 2, signals: [x]}", figures="[signals]"))


def test_a_smoke_run_is_shorter_than_its_figures(tmp_path):
    """A window beyond its end is no mistake of the file."""
    path = write(tmp_path, record="{runs: 2}", figures="[{kind: signals, from: 0.7}]", smoke="{runs: 1, steps: 2}")
    assert load_config(path, smoke=True).figures


MOMENTS = {"mean(x)": (2,), "mean(x_hat)": (2,), "mean(e)": (2,), "cov(x)": (2, 2), "cov(e)": (2, 2)}
P = {"P": (2, 2)}
NEEDS = ("", "needs ensemble moments: evaluate: [runs, moments]")
NO_P = ("", "no method reports a covariance P")
EMPTY = "fewer than two samples lie between `from` and `to` (there are 0 to 10)"


def issues(kind, text, **layout):
    """What a figure finds in a layout."""
    problems = []
    keys = validate(model_of("figures", kind), parse(text, "f.yaml"), [], problems)
    assert not problems
    figure = registry.get("figures", kind)(**{name: getattr(keys, name) for name in type(keys).model_fields})
    known = {"metrics": ("a", "b"), "points": ({},), "end": 10.0, "Ts": 0.1}
    return list(figure.check(ResultLayout(**known | {"methods": tuple(layout.get("arrays", ()))} | layout)))


@pytest.mark.parametrize(
    ("kind", "text", "series", "found"),
    [
        ("signals", "{signals: [variance.1, mean], log: true}", MOMENTS | P, []),
        ("signals", "{signals: [variance]}", P, [("signals", f"'variance' {NEEDS[1]}")]),
        ("signals", "{signals: [variance]}", MOMENTS, []),
        ("ellipses", "{x: a, y: b}", MOMENTS | P, []),
        ("ellipses", "{x: a, y: b}", P, [NEEDS]),
        ("ellipses", "{x: a, y: b}", MOMENTS, [NO_P]),
        (
            "ellipses",
            "{x: a, y: b, components: [0, 2]}",
            MOMENTS | P,
            [("components", "there is no state 2 (they count from 0 to 1)")],
        ),
        ("ellipses", "{x: a, y: b, components: [1, 1]}", MOMENTS | P, [("components", "must be two different states")]),
    ],
)
def test_what_figures_of_an_ensemble_require(kind, text, series, found):
    """Moments, for a bound or an ellipse also P, and a state that exists."""
    arrays = {"A": {name: (101, *shape) for name, shape in series.items()}}
    assert issues(kind, text, series=series, arrays=arrays) == found


def test_an_experiment_without_moments(tmp_path):
    """The way out is in the message, at the figure."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, figures="[{kind: ellipses, x: mse, y: input_power}]"))
    (problem,) = caught.value.problems
    assert (problem.path, problem.message) == ("figures.0", NEEDS[1])


SETS = {"KF": {"P": (1, 2, 2)}, "MIX": {"P": (101, 2, 2), "M": (101, 2, 2)}, "LP": {"L": (1, 2, 1)}}
NO_TUBE = "'tube' needs recorded x and x_hat of a method that reports a set M or a covariance P: "
NO_TUBE += "record: {runs: 1, signals: [x, x_hat]}"


def of_tubes(text, arrays, signals=("y", "x", "x_hat")):
    """What tubes find in a layout whose methods have the same signals, of a plant with two states."""
    shapes = {"y": (1,), "u": (1,), "x": (2,), "x_hat": None}
    kept = {name: {signal: shapes[signal] for signal in signals} for name in arrays}
    series = {name: shape[1:] for shapes in arrays.values() for name, shape in shapes.items()}
    return issues("signals", text, arrays=arrays, signals=kept, series=series, recorded=range(2))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("{signals: [tube]}", []),
        ("{signals: [tube.1], run: 1, order: [MIX], level: 99%}", []),
        ("{signals: [tube], run: 2}", [("run", "run 2 is not recorded (recorded: 0, 1)")]),
        ("{signals: [tube], order: [LP, MIX]}", [("order", "'LP' has none of tube (those that have: KF, MIX)")]),
        ("{signals: [tube.2]}", [("signals", "'tube.2' is not a component (they count from tube.0 to tube.1)")]),
        ("{signals: [tube], from: 5, to: 2}", [("from", EMPTY)]),
    ],
)
def test_what_tubes_require(text, found):
    """A recorded run, methods that report a set, states that exist."""
    assert of_tubes(text, SETS) == found


@pytest.mark.parametrize("signals", [("y", "u"), ("x",), ("x_hat",)])
def test_tubes_need_states_and_estimates(signals):
    """Both, and a set of the plant's states; the way out is in the message."""
    assert of_tubes("{signals: [tube]}", SETS, signals=signals) == [("signals", NO_TUBE)]
    assert of_tubes("{signals: [tube]}", {"LP": {}}) == [("signals", NO_TUBE)]
    other = {"KF": {"P": (1, 2, 2)}, "S": {"P": (1, 4, 4)}}
    assert [key for key, _ in of_tubes("{signals: [tube], order: [S]}", other)] == ["order"]
    assert of_tubes("{signals: [tube], order: [KF]}", other) == []


NINE_ROWS = "9 rows of panels do not fit into one figure (at most 8): choose components such as x.0"
TOO_CLOSE = "more than 50 time marks overlap: choose a longer time between two marks"
COMMON = {"y": (3,), "bursts": (1,)}
RECORDED = {"A": {**COMMON, "Q_yw": (3, 3), "r": (3,)}, "B": {**COMMON, "Q_yw": (3, 3)}, "C": COMMON}
LAYOUT = {"methods": tuple(RECORDED), "signals": RECORDED, "recorded": range(2)}


def test_components_of_a_signal_of_unknown_size():
    """Any may exist, and it takes one panel."""
    layout = {"methods": ("A",), "signals": {"A": {"x_hat": None}}, "recorded": range(1)}
    assert issues("signals", "{signals: [x_hat, x_hat.7]}", **layout) == []


def test_the_control_error_needs_the_output():
    """It is made of it."""
    found = issues("signals", "{signals: [e]}", methods=("A",), signals={"A": {"u": (1,)}}, recorded=range(1))
    assert found == [("signals", "'e' is not recorded (recorded: u)")]


@pytest.mark.parametrize(
    ("kind", "text", "key", "message"),
    [
        ("signals", "{signals: [e, Q_yw.8, r.0, bursts]}", "", ""),
        ("signals", "{signals: [e.3]}", "signals", "'e.3' is not a component (they count from e.0 to e.2)"),
        ("signals", "{signals: [Q_yw.9]}", "signals", "'Q_yw.9' is not a component (they count from Q_yw.0 to Q_yw.8)"),
        ("signals", "{signals: [e, r, u]}", "signals", "'u' is not recorded (recorded: y, bursts, Q_yw, r)"),
        ("signals", "{signals: [Q_yw]}", "signals", NINE_ROWS),
        ("signals", "{signals: []}", "signals", "must name at least one signal"),
        ("elements", "{signal: Q_yw, run: 1, order: [B]}", "", ""),
        ("elements", "{signal: S}", "signal", "'S' is not recorded (recorded: y, bursts, Q_yw, r)"),
        ("elements", "{signal: r}", "signal", "r is not a square matrix (3): show it with signals"),
        ("elements", "{signal: y}", "signal", "y is not a square matrix (3): show it with signals"),
        ("elements", "{signal: Q_yw, run: 2}", "run", "run 2 is not recorded (recorded: 0, 1)"),
        ("elements", "{signal: Q_yw, order: [A, C]}", "order", "'C' does not report Q_yw"),
        ("elements", "{signal: Q_yw, width: 3}", "width", "3 columns need a width of 3.2 inches (got 3)"),
        ("elements", "{signal: Q_yw, to: 0}", "to", EMPTY),
        ("scatter", "{x: y.0, y: y.1}", "", ""),
        ("scatter", "{x: y.2, y: y.0, run: 1, marks: 1, magnify: 20}", "", ""),
        ("scatter", "{x: y.0, y: y.1, run: 5}", "run", "run 5 is not recorded (recorded: 0, 1)"),
        ("scatter", "{x: y.0, y: y.3}", "y", "'y.3' is not a component (they count from y.0 to y.2)"),
        ("scatter", "{x: y.1, y: y.1}", "y", "must be another metric or signal than x"),
        ("scatter", "{x: y.0, y: y}", "y", "must be one component of a recorded signal, such as y.0"),
        ("scatter", "{x: y.0, y: y.1, marks: 0.1}", "marks", TOO_CLOSE),
        ("scatter", "{x: y.0, y: y.1, marks: 0.1, from: 2, to: 4}", "", ""),
        ("scatter", "{x: y.0, y: y.1, from: 5, to: 2}", "from", EMPTY),
    ],
)
def test_what_figures_of_recorded_signals_require(kind, text, key, message):
    """Recorded runs, components that exist (of a matrix row by row), marks that do not overlap; e is there with y."""
    assert issues(kind, text, **LAYOUT) == ([(key, message)] if message else [])


def test_pictures_of_a_run_need_one():
    """The way out is in the message."""
    message = "no run is recorded; record some with `record: {runs: 1}`"
    assert issues("elements", "{signal: Q_yw}") == [("", message)]
    assert issues("scatter", "{x: y.0, y: y.1}")[0] == ("", message)
    found = issues("scatter", "{x: y.0, y: y.1, run: 200}", **LAYOUT | {"recorded": range(200)})
    assert found == [("run", "run 200 is not recorded (recorded: 0 to 199)")]


def test_what_a_scatter_figure_of_metrics_requires(tmp_path):
    """Two metrics that exist, and no more points than can be distinguished."""
    methods, points = tuple("ABCD"), tuple({"k": str(number)} for number in range(16))
    assert issues("scatter", "{x: a, y: b}", methods=methods) == []
    assert issues("scatter", "{x: a, y: a}", methods=methods) == [("y", "must be another metric or signal than x")]
    many = "64 points of methods do not fit into one figure (at most 60): "
    many += "choose some points of the sweep, or fewer methods"
    assert issues("scatter", "{x: a, y: b}", methods=methods, points=points) == [("at", many)]
    assert issues("scatter", "{x: a, y: b, order: [A]}", methods=methods, points=points) == []
    assert issues("scatter", "{x: a, y: b, at: [{k: 1}]}", methods=methods, points=points) == []
    with pytest.raises(ConfigError, match=r"figures\.0\.y: 'mes' is not a known metric .*did you mean 'mse'"):
        load_config(write(tmp_path, figures="[{kind: scatter, x: input_power, y: mes}]"))
    assert load_config(write(tmp_path, figures="[{kind: scatter, x: input_power, y: mse}]")).figures


@pytest.mark.parametrize("kind", registry.names("figures"))
def test_names_are_checked_in_the_same_way_by_every_figure(kind):
    """Methods, metrics and points of the sweep; of an experiment of which nothing else is known."""
    figure = registry.get("figures", kind)
    keys = {key: "mes" for key in figure.metric_keys} | ({"x": "mes", "y": "mse"} if kind == "scatter" else {})
    keys |= {"signal": "Q"} if kind == "elements" else {}
    at = {"controller.Hp": 3}
    single = issubclass(figure, OnePointFigure)
    wrong = figure(**keys, order=["S-MCP"], at=at if single else [at])
    layout = ResultLayout(methods=("S-MPC",), metrics=("mse",), points=({},), has_runs=False, is_complete=False)
    found = [(key, message) for key, message in wrong.check_names(layout) if message]
    expected = [("", "shows runs, but no runs are evaluated: add `runs` to `evaluate`")] if figure.needs_runs else []
    expected += [
        (key, "'mes' is not a known metric of this configuration; did you mean 'mse'?")
        for key in (*figure.metric_keys, *(["x"] if kind == "scatter" else []))
    ]
    expected += [("order", "'S-MCP' is not a known method; did you mean 'S-MPC'?")]
    assert sorted(found) == sorted([*expected, ("at", "nothing is swept in this configuration")])


@pytest.mark.parametrize("kind", registry.RENAMED_FIGURES)
def test_earlier_kinds_say_what_has_become_of_them(tmp_path, kind):
    """In a file at its place, and as an error of the Python interface."""
    words = registry.RENAMED_FIGURES[kind]
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, figures=f"[{{kind: {kind}}}]"))
    (problem,) = caught.value.problems
    assert problem.path == "figures.0.kind" and problem.message.startswith(f"{kind!r} is ")
    assert words in problem.message and problem.message.endswith("(rmpc-bench list figures)")
    with pytest.raises(DesignError, match=words):
        figure_component({"kind": kind})


HEAVY = {"pandas", "matplotlib", "scipy", "numba", "jinja2"}


def test_figures_are_loaded_without_the_libraries_that_draw_them():
    program = (
        "import sys\nfrom rmpc_bench.registry import get, names\n"
        "print(*(get('figures', name).__name__ for name in names('figures')))\n"
        "print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    kinds, modules = done.stdout.splitlines()
    assert len(kinds.split()) == len(list(names("figures")))
    assert not HEAVY & set(modules.split())


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
    [
        (
            "elements",
            "{signal: Q_yw, run: 2, from: 1, to: 2*3, width: 7, order: [A]}",
            {"from_": 1, "to": 6, "width": 7},
        ),
        ("ellipses", "{x: a, y: b, k: 1500, sigmas: [1, 2*2], components: [2, 0]}", {"k": 1500, "sigmas": (1, 4)}),
        ("scatter", "{x: a, y: b, bars: se, front: false, at: [{kp: 1}]}", {"front": False, "at": [{"kp": 1}]}),
        ("rows", "{show: share}", {"show": "share"}),
        ("rows", "{show: [mean]}", {"show": ["mean"]}),
    ],
)
def test_keys_are_read_as_a_configuration_writes_them(kind, text, expected):
    """With arithmetic, and `from`, which is no name in Python."""
    problems = []
    keys = validate(model_of("figures", kind), parse(text, "f.yaml"), [], problems)
    assert not problems and {name: getattr(keys, name) for name in expected} == expected
    assert plain_data(getattr(keys, "sigmas", (1, 4))) == [1, 4]


@pytest.mark.parametrize(
    ("kind", "text", "found"),
    [
        ("elements", "{run: -1}", ["'signal' is missing", "run: must be >= 0 (got -1)"]),
        ("ellipses", "{x: a, k: -1}", ["'y' is missing", "k: must be >= 0 (got -1)"]),
        ("ellipses", "{x: a, y: b, sigmas: [1, 2, 3, 4, 5]}", ["sigmas: has too many entries (got a list of 5)"]),
        ("ellipses", "{x: a, y: b, components: [0, 1, 2]}", ["components: has too many entries (got a list of 3)"]),
        ("scatter", "{x: a, bars: iqr}", ["'y' is missing", "bars: must be 'quartiles' or 'se' (got 'iqr')"]),
    ],
)
def test_keys_that_are_no_values_of_a_figure(kind, text, found):
    """Each with its place."""
    problems = []
    validate(model_of("figures", kind), parse(text, "f.yaml"), [], problems)
    assert sorted(str(problem).split(": ", 1)[1] for problem in problems) == found
