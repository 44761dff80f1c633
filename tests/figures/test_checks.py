"""What a figure requires and the results will not have is an error of the configuration, at its place."""

import subprocess
import sys

import pytest
from small_experiment import write

from rmpc_bench import load_config, registry
from rmpc_bench.config_file.component import plain_data
from rmpc_bench.config_file.keys import model_of, validate
from rmpc_bench.config_file.tree import Problems
from rmpc_bench.config_file.yaml import parse
from rmpc_bench.publishing.figure_files import figure_component
from rmpc_bench.registry import names
from rmpc_bench.types import ConfigError, DesignError, OnePointFigure, ResultLayout


def mistakes(tmp_path, **keys):
    """Place and message of every mistake of a configuration."""
    try:
        assert load_config(write(tmp_path, **keys)).figures
    except ConfigError as error:
        return [(problem.path, problem.message) for problem in error.problems]
    return []


NO_RUN = "no run is recorded; record some with `record: {runs: 1}`"
NEEDS = ("", "needs ensemble moments: evaluate: [runs, moments]")
STATES = "{runs: 2, signals: [y, u, x, x_hat]}"
SHOWN = "'median' is not known; known: values, change, mean, share, rank"


@pytest.mark.parametrize(
    ("figure", "record", "key", "message"),
    [
        ("signals", "{runs: 2}", "", ""),
        ("signals", STATES, "", ""),  # all components of the states would be too many panels
        ("{kind: signals, signals: [x_hat.3, x.0]}", STATES, "", ""),
        ("{kind: signals, signals: [theta, y, L]}", "{runs: 2}", "", ""),
        ("{kind: signals, signals: ['P.3,3']}", "{runs: 2}", "", ""),
        ("{kind: scatter, x: input_power, y: mse}", None, "", ""),
        ("signals", None, "", NO_RUN),
        ("signals", "{runs: 2, signals: [x]}", ".signals", "is not recorded (recorded: x; series: K, L"),
        ("{kind: signals, signals: [x]}", "{runs: 2}", ".signals", "'x' is not recorded (recorded: y, u; series: K, L"),
        ("{kind: signals, signals: [y.1]}", "{runs: 2}", ".signals", "(they count from y.0 to y.0)"),
        ("{kind: signals, from: 7}", "{runs: 2}", ".from", "lie between `from` and `to` (there are 0 to 1)"),
        ("{kind: signals, to: 0}", "{runs: 2}", ".to", "fewer than two samples"),
        ("{kind: signals, signals: [P]}", "{runs: 2}", ".signals", "16 rows of panels do not fit into one figure"),
        ("{kind: signals, signals: [L.2]}", "{runs: 2}", ".signals", "(they count from L.0,0 to L.3,0)"),
        ("{kind: signals, signals: [theta.0]}", "{runs: 2}", ".signals", "it is a number and has none"),
        ("{kind: boxplot, order: [S-MPC, S-MPC]}", None, ".order", "must name at least one method, and each one once"),
        ("{kind: scatter, x: input_power, y: mes}", None, ".y", "'mes' is not a known metric of this configuration; "),
        ("{kind: ellipses, x: mse, y: input_power}", None, *NEEDS),
        ("{kind: rows, show: median}", None, ".show", SHOWN),
        ("{kind: sweep}", None, ".path", "nothing is swept in this configuration"),
        ("paired", None, "", "'paired' is now 'rows' (rmpc-bench list figures)"),
    ],
)
def test_what_is_asked_in_vain(tmp_path, figure, record, key, message):
    """One mistake each, with the key to blame and the way out; or nothing to say against it."""
    found = mistakes(tmp_path, record=record, figures=f"[{figure}]")
    assert {place for place, _ in found} == ({f"figures.0{key}"} if message else set())
    assert all(message in text for _, text in found) and (len(found) < 2 or figure == "signals")


@pytest.mark.parametrize("figures", ["[sweep]", "[boxplot]", "[rows]", "[]"])
@pytest.mark.parametrize("n_points", [1, 7, 12])
def test_no_number_of_points_is_refused(tmp_path, figures, n_points):
    sweep = f"{{grid: {{controller.Hp: {[*range(4, 4 + n_points)]}}}}}"
    load_config(write(tmp_path, sweep=sweep, figures=figures))


@pytest.mark.parametrize(("sweep", "kind"), [(None, "boxplot"), ("{grid: {controller.Hp: [4, 5]}}", "sweep")])
def test_the_default_figure_is_that_of_the_experiment(tmp_path, sweep, kind):
    assert [figure.kind for figure in load_config(write(tmp_path, sweep=sweep, figures=None)).figures] == [kind]


def test_a_smoke_run_is_shorter_than_its_figures(tmp_path):
    """A window beyond its end is no mistake of the file."""
    path = write(tmp_path, record="{runs: 2}", figures="[{kind: signals, from: 0.7}]", smoke="{runs: 1, steps: 2}")
    assert load_config(path, smoke=True).figures


MOMENTS = {"mean(x)": (2,), "mean(x_hat)": (2,), "mean(e)": (2,), "cov(x)": (2, 2), "cov(e)": (2, 2)}
P = {"P": (2, 2)}
SETS = {"KF": {"P": (1, 2, 2)}, "MIX": {"P": (101, 2, 2), "M": (101, 2, 2)}, "LP": {"L": (1, 2, 1)}}
OTHER = {"KF": {"P": (1, 2, 2)}, "S": {"P": (1, 4, 4)}}
NO_TUBE = "'tube' needs recorded x and x_hat of a method that reports a set M or a covariance P: "
NO_TUBE += "record: {runs: 1, signals: [x, x_hat]}"
NO_STATE = "there is no state 2 (they count from 0 to 1)"
EMPTY = "fewer than two samples lie between `from` and `to` (there are 0 to 10)"
NINE_ROWS = "9 rows of panels do not fit into one figure (at most 8): choose components such as x.0"
TOO_CLOSE = "more than 50 time marks overlap: choose a longer time between two marks"
TOO_MANY = "64 points of methods do not fit into one figure (at most 60): choose some points of the sweep, "
TOO_MANY += "or fewer methods"
COMMON = {"y": (3,), "bursts": (1,)}
RECORDED = {"A": {**COMMON, "Q_yw": (3, 3), "r": (3,)}, "B": {**COMMON, "Q_yw": (3, 3)}, "C": COMMON}


def ensemble(series):
    """Layout of a method with series of an ensemble."""
    return {"series": series, "arrays": {"A": {name: (101, *shape) for name, shape in series.items()}}}


def tubes(arrays, signals=("y", "x", "x_hat")):
    """Layout of methods with the same signals, of a plant with two states."""
    shapes = {"y": (1,), "u": (1,), "x": (2,), "x_hat": None}
    kept = {name: {signal: shapes[signal] for signal in signals} for name in arrays}
    series = {name: shape[1:] for shapes in arrays.values() for name, shape in shapes.items()}
    return {"arrays": arrays, "signals": kept, "series": series, "recorded": range(2)}


BOTH, BARE, SWEPT = ensemble(MOMENTS | P), {}, {"points": tuple({"k": str(number)} for number in range(16))}
KEPT, MORE = ({"signals": RECORDED, "recorded": range(n)} for n in (2, 9))
NO_Y, UNKNOWN = ({"signals": {"A": each}, "recorded": range(1)} for each in ({"u": (1,)}, {"x_hat": None}))


def read(kind, text):
    problems = Problems()
    return problems.tried(validate, model_of("figures", kind), parse(text, "f.yaml"), []), problems


def issues(kind, text, layout):
    """What a figure finds in a layout."""
    keys, problems = read(kind, text)
    assert not problems
    figure = registry.get("figures", kind)(**{name: getattr(keys, name) for name in type(keys).model_fields})
    known = {"metrics": ("a", "b"), "points": ({},), "end": 10.0, "Ts": 0.1}
    methods = tuple(layout.get("arrays", layout.get("signals", "ABCD")))
    return list(figure.check(ResultLayout(**known | {"methods": methods} | layout)))


@pytest.mark.parametrize(
    ("kind", "layout", "text", "key", "message"),
    [
        # Moments, for a bound or an ellipse also P, and a state that exists.
        ("signals", BOTH, "{signals: [variance.1, mean], log: true}", "", ""),
        ("signals", ensemble(P), "{signals: [variance]}", "signals", f"'variance' {NEEDS[1]}"),
        ("signals", ensemble(MOMENTS), "{signals: [variance]}", "", ""),
        ("ellipses", BOTH, "{x: a, y: b}", "", ""),
        ("ellipses", ensemble(P), "{x: a, y: b}", *NEEDS),
        ("ellipses", ensemble(MOMENTS), "{x: a, y: b}", "", "no method reports a covariance P"),
        ("ellipses", BOTH, "{x: a, y: b, components: [0, 2]}", "components", NO_STATE),
        ("ellipses", BOTH, "{x: a, y: b, components: [1, 1]}", "components", "must be two different states"),
        # Tubes: a recorded run with states and estimates, methods that report a set of the plant's states.
        ("signals", tubes(SETS), "{signals: [tube]}", "", ""),
        ("signals", tubes(SETS), "{signals: [tube.1], run: 1, order: [MIX], level: 99%}", "", ""),
        ("signals", tubes(SETS), "{signals: [tube], run: 2}", "run", "run 2 is not recorded (recorded: 0, 1)"),
        ("signals", tubes(SETS), "{signals: [tube], order: [LP]}", "order", "(those that have: KF, MIX)"),
        ("signals", tubes(SETS), "{signals: [tube.2]}", "signals", "(they count from tube.0 to tube.1)"),
        *(("signals", tubes(SETS, each), "{signals: [tube]}", "signals", NO_TUBE) for each in ("yu", ["x"], ["x_hat"])),
        ("signals", tubes({"LP": {}}), "{signals: [tube]}", "signals", NO_TUBE),
        ("signals", tubes(OTHER), "{signals: [tube], order: [S]}", "order", "'S' has none of tube"),
        ("signals", tubes(OTHER), "{signals: [tube], order: [KF]}", "", ""),
        # Recorded signals: components that exist (of a matrix row by row); e is there with y.
        ("signals", KEPT, "{signals: [e, Q_yw.8, r.0, bursts]}", "", ""),
        ("signals", KEPT, "{signals: [e.3]}", "signals", "'e.3' is not a component (they count from e.0 to e.2)"),
        ("signals", KEPT, "{signals: [Q_yw.9]}", "signals", "(they count from Q_yw.0 to Q_yw.8)"),
        ("signals", KEPT, "{signals: [e, r, u]}", "signals", "'u' is not recorded (recorded: y, bursts, Q_yw, r)"),
        ("signals", KEPT, "{signals: [Q_yw]}", "signals", NINE_ROWS),
        ("signals", KEPT, "{signals: []}", "signals", "must name at least one signal"),
        ("signals", NO_Y, "{signals: [e]}", "signals", "'e' is not recorded (recorded: u)"),
        # Any component of a signal of unknown size may exist, and it takes one panel.
        ("signals", UNKNOWN, "{signals: [x_hat, x_hat.7]}", "", ""),
        ("elements", KEPT, "{signal: Q_yw, run: 1, order: [B]}", "", ""),
        ("elements", KEPT, "{signal: S}", "signal", "'S' is not recorded (recorded: y, bursts, Q_yw, r)"),
        ("elements", KEPT, "{signal: r}", "signal", "r is not a square matrix (3): show it with signals"),
        ("elements", KEPT, "{signal: Q_yw, run: 2}", "run", "run 2 is not recorded (recorded: 0, 1)"),
        ("elements", KEPT, "{signal: Q_yw, order: [A, C]}", "order", "'C' does not report Q_yw"),
        ("elements", KEPT, "{signal: Q_yw, width: 3}", "width", "3 columns need a width of 3.2 inches (got 3)"),
        ("elements", KEPT, "{signal: Q_yw, to: 0}", "to", EMPTY),
        ("elements", BARE, "{signal: Q_yw}", "", NO_RUN),
        ("scatter", KEPT, "{x: y.0, y: y.1}", "", ""),
        ("scatter", KEPT, "{x: y.2, y: y.0, run: 1, marks: 1, magnify: 20}", "", ""),
        ("scatter", KEPT, "{x: y.0, y: y.1, run: 5}", "run", "run 5 is not recorded (recorded: 0, 1)"),
        ("scatter", MORE, "{x: y.0, y: y.1, run: 9}", "run", "run 9 is not recorded (recorded: 0 to 8)"),
        ("scatter", KEPT, "{x: y.0, y: y.3}", "y", "'y.3' is not a component (they count from y.0 to y.2)"),
        ("scatter", KEPT, "{x: y.1, y: y.1}", "y", "must be another metric or signal than x"),
        ("scatter", KEPT, "{x: y.0, y: y}", "y", "must be one component of a recorded signal, such as y.0"),
        ("scatter", KEPT, "{x: y.0, y: y.1, marks: 0.1}", "marks", TOO_CLOSE),
        ("scatter", KEPT, "{x: y.0, y: y.1, marks: 0.1, from: 2, to: 4}", "", ""),
        ("scatter", KEPT, "{x: y.0, y: y.1, from: 5, to: 2}", "from", EMPTY),
        ("scatter", BARE, "{x: y.0, y: y.1}", "", NO_RUN),
        ("scatter", BARE, "{x: y.0, y: b}", "x", "'y.0' is not a known metric of this configuration; known: a, b"),
        # Metrics: no more points than can be distinguished.
        ("scatter", BARE, "{x: a, y: b}", "", ""),
        ("scatter", BARE, "{x: a, y: a}", "y", "must be another metric or signal than x"),
        ("scatter", SWEPT, "{x: a, y: b}", "at", TOO_MANY),
        ("scatter", SWEPT, "{x: a, y: b, order: [A]}", "", ""),
        ("scatter", SWEPT, "{x: a, y: b, at: [{k: 1}]}", "", ""),
        ("rows", BARE, "{show: []}", "show", "at least one column"),
        ("rows", BARE, "{show: [values, values]}", "show", "each one once"),
        ("rows", BARE, "{show: [rank, values]}", "show", "over all points"),
        ("sweep", SWEPT, "{path: b}", "path", "'b' is not a known path"),
        ("sweep", SWEPT, "{path: [k, k]}", "path", "two different"),
        ("sweep", SWEPT, "{log: true}", "log", "is for values"),
    ],
)
def test_what_figures_require_of_the_layout(kind, layout, text, key, message):
    found = issues(kind, text, layout)
    assert bool(found) == bool(message) and all(each.key == key and message in each.message for each in found[:1])


@pytest.mark.parametrize("kind", registry.names("figures"))
def test_names_are_checked_in_the_same_way_by_every_figure(kind):
    """Methods, metrics and points of the sweep; of an experiment of which nothing else is known."""
    figure = registry.get("figures", kind)
    keys = {key: "mes" for key in figure.metric_keys} | ({"x": "mes", "y": "mse"} if kind == "scatter" else {})
    keys |= {"signal": "Q"} if kind == "elements" else {}
    at = {"controller.Hp": 3}
    wrong = figure(**keys, order=["S-MCP"], at=at if issubclass(figure, OnePointFigure) else [at])
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
    words = registry.RENAMED_FIGURES[kind]
    ((place, message),) = mistakes(tmp_path, figures=f"[{{kind: {kind}}}]")
    assert place == "figures.0.kind" and kind not in registry.names("figures")
    assert message == f"{kind!r} {words} (rmpc-bench list figures)"
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
        ("elements", "{signal: Q_yw, run: 2, from: 1, to: 2*3, width: 7}", {"from_": 1, "to": 6, "width": 7}),
        ("ellipses", "{x: a, y: b, k: 1500, sigmas: [1, 2*2], components: [2, 0]}", {"k": 1500, "sigmas": (1, 4)}),
        ("scatter", "{x: a, y: b, bars: se, front: false, at: [{kp: 1}]}", {"front": False, "at": [{"kp": 1}]}),
        ("rows", "{show: share}", {"show": "share"}),
        ("rows", "{show: [mean]}", {"show": ["mean"]}),
    ],
)
def test_keys_are_read_as_a_configuration_writes_them(kind, text, expected):
    """With arithmetic, and `from`, which is no name in Python."""
    keys, problems = read(kind, text)
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
    assert sorted(str(problem).split(": ", 1)[1] for problem in read(kind, text)[1]) == found
