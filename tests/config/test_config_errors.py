"""Messages for a wrong configuration: the place, the key, the reason, and all errors at once."""

import pickle

import pytest
from small_experiment import KEYS, write

from rmpc_bench import load_config
from rmpc_bench.types import ConfigError

MPC = "kind: mpc, Hp: 10, Hu: 3, Q: 0.1, R: 0.1"
KALMAN = "{estimator: {kind: kalman}}"


@pytest.fixture
def mistakes(tmp_path):
    """Return a function that gives (line, column, path, message) of all mistakes in the small experiment."""

    def load(**keys):
        path = write(tmp_path, **keys)
        with pytest.raises(ConfigError) as caught:
            load_config(path)
        assert {problem.file for problem in caught.value.problems} == {str(path)}
        return [(each.line, each.column, each.path, each.message) for each in caught.value.problems]

    return load


def place(key, text, value):
    """Line and column of a part of the value of a top-level key."""
    keys = [*KEYS] if key in KEYS else [*KEYS, key]
    assert value.count(text) >= 1
    return keys.index(key) + 1, len(key) + 3 + value.rindex(text)


CASES = [
    # key, its value, the text whose place is shown, path, message
    ("name", "../x", "../x", "name", "must have 1 to 100 letters"),
    ("version", "2", "2", "version", "must be 1 (got 2)"),
    ("runs", "0", "0", "runs", "must be >= 1 (got 0)"),
    ("runs", "[1]", "[1]", "runs", "got [1]"),
    ("seed", "-1", "-1", "seed", "must be >= 0 (got -1)"),
    ("time", "{step: 0.1}", "{step", "time", "give either duration or steps"),
    ("time", "{duration: 1, steps: 2}", "{dur", "time", "give either duration or steps"),
    ("time", "{step: 0.1, duration: 1.05}", "{step", "time", "duration 1.05 is not a whole number of steps of 0.1"),
    ("time", "{step: -1, steps: 3}", "-1", "time.step", "must be > 0 (got -1)"),
    ("time", "{stp: 1, steps: 3}", "stp", "time.stp", "'stp' is not a known key; did you mean 'step'?"),
    ("plant", "{}", "{}", "plant", "'kind' is missing; known kinds of plant: "),
    ("plant", "{kind: [1]}", "[1]", "plant.kind", "is not a known plant"),
    ("plant", "{kind: servo-linear, J_l: 0}", "0", "plant.J_l", "must be > 0 (got 0)"),
    ("plant", "{kind: servo-linear, perturb: {J_x: 2}}", "J_x", "plant.perturb.J_x", "did you mean 'J_m'?"),
    ("plant", "{kind: servo-linear, perturb: {R: 1 + epz}}", "1 +", "plant.perturb.R", "did you mean 'eps'?"),
    ("plant", "{kind: servo-linear, set: [R]}", "[R]", "plant.set", "must be a mapping (got a list of 1)"),
    ("plant", "{kind: servo-linear, perturb: {R: 1}, set: {R: 2}}", "R: 2", "plant.set.R", "is already changed by"),
    ("uncertainty", "{eps: 10%}", "10%", "uncertainty.eps", "expected a range such as +-10% or {dist: ..}"),
    ("uncertainty", "{eps: +-x}", "+-x", "uncertainty.eps", "unknown name 'x'"),
    ("uncertainty", "{eps: {dist: norml}}", "norml", "uncertainty.eps.dist", "did you mean 'normal'?"),
    ("uncertainty", "{eps: {kind: normal}}", "kind", "uncertainty.eps.kind", "did you mean 'dist'? (one of uniform,"),
    ("uncertainty", "{eps: {std: 0.1}}", "{std", "uncertainty.eps", "needs the key `dist` (one of uniform, normal,"),
    ("uncertainty", "{eps: {dist: [1]}}", "[1]", "uncertainty.eps.dist", "is not a known distribution"),
    ("uncertainty", "{eps: {dist: uniform, low: 1, high: 0}}", "{dist", "uncertainty.eps", "low (1) must not exceed"),
    ("uncertainty", "{eps: {dist: normal, std: -1}}", "-1", "uncertainty.eps.std", "must be >= 0 (got -1)"),
    ("uncertainty", "{eps: {dist: choice, values: []}}", "{dist", "uncertainty.eps", "values must not be empty"),
    ("uncertainty", "{eps: +-1%, 1x: +-1%}", "1x", "uncertainty.1x", "and begins with a letter or _"),
    ("noise", "{measurement: {gausian: {std: 1}}}", "{gau", "noise.measurement", "did you mean 'gaussian'?"),
    ("noise", "{measurment: none}", "meas", "noise.measurment", "did you mean 'measurement'?"),
    ("noise", "{process: {same: 0.1}}", "0.1", "noise.process.same", "must be a mapping (got 0.1)"),
    ("noise", "{process: {same: {scale: -1}}}", "-1", "noise.process.same.scale", "must be >= 0 (got -1)"),
    ("noise", "{process: {same: {scal: 1}}}", "scal", "noise.process.same.scal", "did you mean 'scale'?"),
    ("noise", "{process: {gaussian: {}}}", "{}", "noise.process.gaussian", "give one of std, cov and density"),
    ("noise", "{process: {gaussian: {std: [1, 2]}}}", "[1, 2]", "noise.process.gaussian.std", "4 numbers are required"),
    ("initial", "{x: [1, 2]}", "[1, 2]", "initial.x", "a number or 4 numbers are required"),
    ("initial", "{x0: 1}", "x0", "initial.x0", "known key"),
    ("initial", "{P: -1}", "-1", "initial.P", "must be positive semidefinite (smallest eigenvalue -1)"),
    ("reference", "{kind: constant, value: [1, 2]}", "[1, 2]", "reference.value", "1 numbers are required"),
    ("model", "{kind: servo-linear}", "{kind", "model", "'noise' is missing"),
    ("controller", f"{{{MPC}, limits: {{u: [5, 1]}}}}", "[5, 1]", "controller.limits.u", "the lower bound 5 must be"),
    ("controller", f"{{{MPC}, limit: 3}}", "limit", "controller.limit", "did you mean 'limits'?"),
    ("controller", "{kind: mpc, Hp: 3, Hu: 4, Q: 1, R: 1}", "4", "controller.Hu", "must be at most Hp = 3 (got 4)"),
    ("methods", "{}", "{}", "methods", "there must be at least one method"),
    ("methods", "{a: 3}", "3", "methods.a", "must be a mapping (got 3)"),
    ("methods", "{a: {}}", "{}", "methods.a", "'estimator' is missing, here and as a default of all methods"),
    ("methods", f"{{'a[1]': {KALMAN}}}", "'a[1]'", "methods.a[1]", "brackets"),
    ("methods", "{a: {estimator: {kind: kalman, c: 1}}}", "c: 1", "methods.a.estimator.c", "'c' is not a known key"),
    ("methods", "{a: {estimator: {kind: kalman}, lable: x}}", "lable", "methods.a.lable", "did you mean 'label'?"),
    ("methods", "{a: {estimator: {kind: risk-sensitive}}}", "{kind", "methods.a.estimator", "give either theta or"),
    ("metrics", "[mse, 3]", "3", "metrics.1", "must be a mapping (got 3)"),
    ("metrics", "[mse, msee]", "msee", "metrics.1", "did you mean 'mse'? (rmpc-bench list metrics)"),
    ("metrics", "[mse, mse]", "mse]", "metrics.1", "'mse' is given twice; give one a `name`"),
    ("metrics", "[mae, {kind: mse, name: mae}]", "{kind", "metrics.1", "'mae' is given twice; give one a `name`"),
    ("metrics", "[{kind: mse, from: 5, to: 3}]", "{kind", "metrics.0", "the window from 5 to 3 (samples)"),
    ("metrics", "[{kind: mse, to: 11}]", "{kind", "metrics.0", "must lie in 0..10"),
    ("figures", "[boxplt]", "boxplt", "figures.0", "did you mean 'boxplot'? (rmpc-bench list figures)"),
    ("figures", "[{kind: boxplot, metric: mes}]", "mes", "figures.0.metric", "did you mean 'mse'?"),
    ("statistics", "{adjust: true}", "true", "statistics.adjust", "'auto' or 'none' or a list or a mapping"),
    ("statistics", "{primary: mes}", "mes", "statistics.primary", "did you mean 'mse'?"),
    ("statistics", "{baseline: MPC}", "MPC", "statistics.baseline", "did you mean"),
    ("statistics", "{relevant: {mes: 1%}}", "1%", "statistics.relevant.mes", "did you mean 'mse'?"),
    ("statistics", "{relevant: {mse: -1%}}", "-1%", "statistics.relevant.mse", "must be >= 0"),
    ("statistics", "{relevant: 2}", "2", "statistics.relevant", "must be < 1 (got 2)"),
    ("statistics", "{average: median}", "median", "statistics.average", "must be 'geometric', 'mean' or 'both'"),
    ("statistics", "{confidence: 95}", "95", "statistics.confidence", "must be < 1 (got 95)"),
    ("claims", "[{source: a}]", "{source", "claims.0", "'says' is missing"),
    ("claims", "[{says: a, finding: maybe}]", "maybe", "claims.0.finding", "inconclusive"),
    ("claims", "[{says: a, check: 'mean(mse[X]) < 1'}]", "'mean", "claims.0.check", "'X' is not a known method"),
    ("claims", "[{says: a, check: 'mean(mes[S-MPC]) < 1'}]", "'mean", "claims.0.check", "did you mean 'mse'?"),
    ("claims", "[{says: a, check: 'mean(mse[S-MPC] < 1'}]", "'mean", "claims.0.check", "expected ')'"),
    ("metrix", "[mse]", None, "metrix", "'metrix' is not a known key; did you mean 'metrics'?"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value", "text", "path", "message"), CASES, ids=[f"{case[0]}-{case[1]}" for case in CASES]
)
def test_one_mistake_is_reported_once_at_its_place(mistakes, key, value, text, path, message):
    """Line, column, key path and reason; nothing that only follows from it."""
    line, column = place(key, text, value) if text else (len(KEYS) + 1, 1)
    plant = {"plant": "{kind: servo-linear}"} if key == "uncertainty" else {}
    found = mistakes(**plant, **{key: value})
    assert [each[:3] for each in found] == [(line, column, path)]
    assert message in found[0][3]


@pytest.mark.parametrize(
    ("keys", "path"),
    [
        ({"metrics": "[]"}, "metrics"),
        ({"metrics": "[mse, {kind: mae, name: run}]"}, "metrics.1"),
        ({"metrics": "[mse, {kind: mae, name: status}]"}, "metrics.1"),
        ({"metrics": "[mse, {kind: mae, name: ''}]"}, "metrics.1"),
        ({"uncertainty": "{eps: +-1%, run: +-1%}"}, "uncertainty.run"),
        ({"uncertainty": "{pi: +-1%}", "plant": "{kind: servo-linear}"}, "uncertainty.pi"),
        ({"plant": "{kind: servo-linear, perturb: {R: 1/0}}"}, "plant.perturb.R"),
        ({"plant": "{kind: servo-linear, set: {R: sqrt(-1)}}"}, "plant.set.R"),
    ],
)
def test_what_could_never_run_is_refused_before(mistakes, keys, path):
    """No metric, a column that exists already, a name with a meaning, arithmetic without a value in any run."""
    assert [each[2].startswith(path) for each in mistakes(**keys)] == [True]


def test_a_suggestion_is_not_what_was_written(mistakes):
    """A law without its parameters: the way out is not to write the same again."""
    [(*_, path, message)] = mistakes(noise="{measurement: gaussian}")
    assert path == "noise.measurement" and "did you mean 'gaussian'" not in message


@pytest.mark.parametrize("key", ["name", "runs", "time", "plant", "model", "methods"])
def test_what_is_required(mistakes, key):
    """A missing key is missed at the top of the file."""
    assert mistakes(**{key: None})[0] == (1, 1, "", f"{key!r} is missing")


@pytest.mark.parametrize(
    ("key", "value", "path"),
    [
        ("model", "{kind: servo-linear, noise: {process: 1.0, measurement: -1.0}}", "model.noise.measurement"),
        ("model", "{kind: servo-linear, noise: {process: 1.0, measurement: 1.0}, J: 1}", "model.J"),
        ("estimator", "{kind: robust-kalman, c: -1}", "estimator.c"),
        ("estimator", "{kind: robust-kalmann, c: 1}", "estimator.kind"),
        ("controller", f"{{{MPC}, scale: {{u: 1, x: 2}}}}", "controller.scale.x"),
    ],
)
def test_an_error_in_a_default_is_reported_at_the_default(mistakes, key, value, path):
    """Once, not of every method that inherits it."""
    found = mistakes(
        **{key: value, "methods": "{a: {label: x}, b: {label: y}}" if key == "estimator" else KEYS["methods"]}
    )
    assert [each[2] for each in found] == [path]


def test_an_error_of_one_method_is_reported_at_the_method(mistakes):
    """What it changes itself is wrong there and nowhere else."""
    found = mistakes(methods=f"{{a: {KALMAN}, b: {{estimator: {{kind: kalman}}, controller: {{Hu: 11}}}}}}")
    assert [each[2:] for each in found] == [("methods.b.controller.Hu", "must be at most Hp = 10 (got 11)")]


def test_an_invalid_metric_counts_among_the_others(mistakes):
    """Oracle: the third metric has the name of the first, whatever is wrong with the second."""
    found = mistakes(metrics="[mse, nosuch, mse]")
    assert [each[2] for each in found] == ["metrics.1", "metrics.2"]


def test_all_mistakes_at_once_sorted_by_place(mistakes):
    """Mistakes of schema, names, designs and claims, from the first line to the last."""
    found = mistakes(
        seed="-1",
        plant="{kind: servo-linear, perturb: {J_x: 1 + epz}}",
        noise="{measurement: {gaussian: {std: [1, 2]}}}",
        controller="{kind: mpc, Hp: 3, Hu: 4, Q: 0.1, R: 0.1}",
        methods=f"{{a: {{estimator: {{kind: robust-kalman, c: -1}}}}, b: {{estimator: {{kind: kalmn}}}}, c: {KALMAN}}}",
        metrics="[mse, {kind: mse, name: late, from: 20}]",
        statistics="{primary: foo, confidence: 2}",
        claims="[{says: a, check: 'mean(mse[X]) < 1'}]",
    )
    assert [each[:2] for each in found] == sorted(each[:2] for each in found)
    assert {each[2] for each in found} >= {
        "seed",
        "plant.perturb.J_x",
        "noise.measurement.gaussian.std",
        "controller.Hu",
        "methods.a.estimator.c",
        "methods.b.estimator.kind",
        "metrics.1",
        "statistics.primary",
        "statistics.confidence",
        "claims.0.check",
    }


def test_an_error_survives_a_process(tmp_path):
    """It pickles by its problems."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, seed=-1, runs=0))
    again = pickle.loads(pickle.dumps(caught.value))
    assert again.problems == caught.value.problems and str(again) == str(caught.value)
