"""The section `tune` and the ranges of methods: what is refused, with its place, and what is read."""

import numpy as np
import pytest
import recorded_runs
from tuned_experiment import KEYS, write

import rmpc_bench
from rmpc_bench import load_config
from rmpc_bench.config.experiment_config import tuning_seed
from rmpc_bench.config.search import _inside
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.numerics.direct_search import MOST_DIMENSIONS
from rmpc_bench.types import ConfigError
from rmpc_bench.types.tuning import MOST_PARAMETERS, TunedParameter


def method(tune, estimator="{kind: kalman}", more=""):
    return f"{{KF: {{estimator: {estimator}, tune: {tune}{more}}}}}"


def place(key, text, value):
    """Line and column of a part of the value of a top-level key."""
    return [*KEYS].index(key) + 1, len(key) + 3 + value.rindex(text)


C = "{kind: robust-kalman, c: 0.1}"
RANGES = [
    # range, estimator, text whose place is shown, path, message
    ("{estimator.c: [1, 0.1]}", C, "[1, 0.1]", '."estimator.c"', "the first number of a range must be smaller"),
    ("{estimator.c: [0, 1]}", C, "[0, 1]", '."estimator.c"', "on a logarithmic scale must begin above 0"),
    ("{estimator.c: [0.1]}", C, "[0.1]", '."estimator.c"', "has too few entries"),
    ("{estimator.c: 0.1}", C, "0.1", '."estimator.c"', "expected a list or a mapping"),
    ("{estimator.c: {range: [1, 2], scal: log}}", C, "scal", '."estimator.c".scal', "did you mean 'scale'?"),
    ("{estimator.c: {range: [1, 2.5], integer: true}}", C, "{range", '."estimator.c"', "must be integers"),
    ("{estimator.cc: [0.1, 1]}", C, "[0.1", '."estimator.cc"', "'cc' is not a known key"),
    ("{estimater.c: [0.1, 1]}", C, "estimater.c", '."estimater.c"', "did you mean 'estimator'?"),
    ("{label: [0.1, 1]}", C, "label", ".label", "name a parameter, such as estimator.radius"),
    ("{estimator.c: [0.1, 0.9], controller.R: [1, 2]}", C, "[1, 2]", '."controller.R"', "'kind' is missing"),
    ("{estimator.kind.x: [0.1, 1]}", C, "[0.1", '."estimator.kind.x"', "can be set only if this is a mapping"),
    ("{}", C, "{}", "", "(got an empty mapping)"),
    ("3", C, "3", "", "must be a mapping such as"),
    # The ends are validated as a value is.
    ("{estimator.c: {range: [-1, 1], scale: linear}}", C, "{range", '."estimator.c"', "estimator.c = -1: must be > 0"),
    ("{estimator.kl: [1, 2]}", C, "[1, 2]", '."estimator.kl"', "estimator.kl = 1: must be"),
]


@pytest.mark.parametrize(("given", "estimator", "where", "path", "message"), RANGES, ids=[case[0] for case in RANGES])
def test_a_wrong_range_is_reported_at_its_place(tmp_path, given, estimator, where, path, message):
    value = method(given, estimator)
    file = write(tmp_path, methods=value)
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    found = [each for each in caught.value.problems if message in each.message]
    assert found, str(caught.value)
    assert found[0].file == str(file)
    assert found[0].path == f"methods.KF.tune{path}"
    assert (found[0].line, found[0].column) == place("methods", where, value)


SECTIONS = [
    ("{budget: 0}", "tune.budget", "must be >= 1 (got 0)"),
    ("{runs: 0}", "tune.runs", "must be >= 1"),
    ("{statistic: best}", "tune.statistic", "must be mean, median or a quantile such as 'quantile 90%'"),
    ("{statistic: quantile 100%}", "tune.statistic", "must be mean, median or a quantile"),
    ("{penalty: -1}", "tune.penalty", "must be >= 0"),
    ("{search: grid}", "tune.search", "grid-golden"),
    ("{metric: mse}", "tune.metric", "metric of this configuration"),
    ("{budgit: 3}", "tune.budgit", "did you mean 'budget'?"),
]


@pytest.mark.parametrize(("given", "path", "message"), SECTIONS, ids=[case[0] for case in SECTIONS])
def test_a_wrong_section_is_reported(tmp_path, given, path, message):
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, tune=given))
    assert [(each.path, message in each.message) for each in caught.value.problems] == [(path, True)]


def test_a_range_needs_the_section(tmp_path):
    with pytest.raises(ConfigError, match="methods.KFR.tune: needs the section `tune` at the top"):
        load_config(write(tmp_path, tune=None))


def test_null_tunes_nothing(tmp_path):
    """The values of the file are used, also by the resolved configuration."""
    path = write(tmp_path)
    config = load_config(path, overrides=["tune=null"])
    assert config.tuning is None and config.parameters["KFR"] == "default"
    assert config.methods["KFR"]["model"]["P_v"] == 1.0
    (tmp_path / "resolved.yaml").write_text(dump(plain(config.resolved)), encoding="utf-8")
    assert load_config(tmp_path / "resolved.yaml").resolved == config.resolved


def test_the_section_without_a_range_is_a_warning(tmp_path):
    """The command line may add a method with one."""
    config = load_config(write(tmp_path, methods="{KF: {estimator: {kind: kalman}}}"))
    assert [each.path for each in config.warnings] == ["tune"] and config.tuning is None
    assert "no method has the key `tune`" in config.warnings[0].message
    assert load_config(write(tmp_path)).warnings == ()


def test_what_cannot_be_tuned_is_refused(tmp_path):
    two = method("{model.P_v: [0.1, 1], model.P_w: [0.1, 1]}")
    with pytest.raises(ConfigError, match=r"methods.KF.tune: `search: grid-golden` takes one parameter"):
        load_config(write(tmp_path, methods=two, tune="{search: grid-golden}"))
    with pytest.raises(ConfigError, match=r"tune: nothing is computed run by run here"):
        load_config(write(tmp_path, evaluate="[moments]"))
    with pytest.raises(ConfigError, match="must be 'as published' or 'default'"):
        load_config(write(tmp_path, methods="{KF: {estimator: {kind: kalman}, parameters: mine}}", tune=None))


def test_the_defaults_of_the_section(tmp_path):
    """Those of docs: 16 values on 40 runs, the mean of the primary metric."""
    protocol = load_config(write(tmp_path, tune="{}")).tuning.protocol
    expected = {"budget": 16, "runs": 40, "metric": "estimation_mse", "statistic": "mean", "penalty": 10.0, "seed": 0}
    assert vars(protocol) == {**expected, "search": "auto"}
    late = "[estimation_mse, {kind: estimation_mse, name: late, from: 10}]"
    other = load_config(write(tmp_path, tune="{}", metrics=late, statistics="{primary: late}"))
    assert other.tuning.protocol.metric == "late"


def test_an_inherited_component_is_tuned(tmp_path):
    """The default of all methods, and the model; the value of the file is the default of the search."""
    methods = "{A: {tune: {estimator.c: [0.01, 1]}}, B: {tune: {model.P_v: [1, 10]}}}"
    config = load_config(write(tmp_path, estimator="{kind: robust-kalman, c: 0.2}", methods=methods))
    a, b = config.tuning.searches
    assert (a.method, a.default, b.method, b.default) == ("A", (0.2,), "B", (1.0,))
    loaded = config.origin.load({("", "A"): {"estimator.c": 0.5}})
    assert loaded.methods["A"]["estimator"]["c"] == 0.5 and loaded.methods["B"]["estimator"]["c"] == 0.2
    assert [each.method for each in loaded.tuning.missing] == ["B"]


def test_a_value_without_a_number_has_no_default(tmp_path):
    config = load_config(write(tmp_path, model="{kind: linear, A: 0.9, B: 1, C: 1, P_w: 1, P_v: [[1]]}"))
    assert config.tuning.searches[0].default == (None,)


def test_integers_stay_integers(tmp_path):
    methods = "{KF: {estimator: {kind: kalman}, tune: {model.P_v: {range: [1, 30], integer: true}}}}"
    config = load_config(write(tmp_path, methods=methods))
    loaded = config.origin.load({("", "KF"): {"model.P_v": 7.0}})
    row = loaded.resolved["tune"]["values"]
    key = loaded.tuning.searches[0].settings
    assert row == [{"method": "KF", "values": {"model.P_v": 7}, "key": key}] and isinstance(
        row[0]["values"]["model.P_v"], int
    )


def test_values_of_a_method_are_used_and_not_searched(tmp_path):
    given = load_config(write(tmp_path, tune="{values: [{method: KFR, values: {model.P_v: 3}}]}"))
    assert not given.tuning.missing and given.methods["KFR"]["model"]["P_v"] == 3.0


def test_where_parameters_come_from(tmp_path):
    """The key of a method says so; else the methods of a paper are as published, and all others default."""
    methods = KEYS["methods"].replace("KF: {", "P: {parameters: as published, estimator: {kind: kalman}}, KF: {")
    words = {"P": "as published", "KF": "default", "KFR": "tuned (budget 6, 5 runs)"}
    assert load_config(write(tmp_path, methods=methods)).parameters == words
    paper = load_config(write(tmp_path, methods=methods, paper="wang2021")).parameters
    assert paper == words | {"KF": "as published"}
    resolved = load_config(write(tmp_path, methods=methods)).resolved
    assert resolved["methods"]["P"]["parameters"] == "as published"


def test_an_extending_file_inherits_and_changes_ranges(tmp_path):
    base = write(tmp_path, file="base.yaml")
    other = tmp_path / "other.yaml"
    other.write_text(f"extends: {base.name}\nname: other\nmethods: {{KFR: {{tune: {{model.P_v: [1, 10]}}}}}}\n")
    before, after = load_config(base).tuning, load_config(other).tuning
    assert [(each.low, each.high) for each in after.searches[0].parameters] == [(1.0, 10.0)]
    assert before.searches[0].key != after.searches[0].key


def test_a_smoke_run_tunes_with_three_values(tmp_path):
    protocol = load_config(write(tmp_path), smoke=True).tuning.protocol
    assert (protocol.budget, protocol.runs) == (3, 4)
    assert not load_config(write(tmp_path), smoke=True).tuning.regret


def test_overrides_of_tuning_get_a_directory_of_their_own(tmp_path):
    """The hash of everything counts ranges and protocol; that of an experiment without tuning stays."""
    path = write(tmp_path)
    whole = load_config(path).full_hash
    assert load_config(path, overrides=["tune.budget=7"]).full_hash != whole
    assert load_config(path, overrides=['methods.KFR.tune."model.P_v"=[1, 10]']).full_hash != whole
    assert load_config(path).full_hash == whole
    assert load_config(path).hash == load_config(path, overrides=["tune.budget=7"]).hash


def test_the_tuning_seed_has_63_bits():
    seeds = [tuning_seed(seed, number) for seed in (0, 1, 2**63 - 1) for number in (0, 1, 2**32 - 1)]
    assert len({*seeds}) == len(seeds) and all(0 <= seed < 2**63 for seed in seeds)


def test_a_swept_value_is_not_tuned(tmp_path):
    """A swept component around it is: each of its points is tuned."""
    with pytest.raises(ConfigError, match=r'methods.KFR.tune."model.P_v": is swept, so tuning has nothing to choose'):
        load_config(write(tmp_path, sweep="{grid: {methods.KFR.model.P_v: [1, 2]}}"))
    config = load_config(write(tmp_path, sweep="{grid: {methods.KFR.model.P_w: [1, 2]}}"))
    assert len({each.key for each in config.tuning.searches}) == 2


def test_the_opponent_of_an_adversary_is_not_tuned(tmp_path):
    """Its choice would change the plant of all methods; the others are tuned against the same uncertainty."""
    plant = "{kind: uncertain-linear, A: 0.9, B: 1, C: 1, Bw: 1, Dv: 1, H_A: 0.1, G_x: 1, uncertainty: %s}"
    against = [plant % f"{{law: greedy, against: {name}}}" for name in ("KFR", "KF")]
    with pytest.raises(ConfigError, match="methods.KFR.tune: the uncertainty of the plant is chosen against this"):
        load_config(write(tmp_path, plant=against[0]))
    results = rmpc_bench.run(load_config(write(tmp_path, plant=against[1])), directory=tmp_path / "out", jobs=1)
    assert np.isfinite(results.tuning.search("KFR").test).all()


def test_recorded_runs_are_not_tuned_on(tmp_path):
    """They would be the runs of the experiment."""
    recorded_runs.record(tmp_path)
    methods = "{KF: {estimator: {kind: kalman}, tune: {model.P_v: [0.01, 1]}}}"
    path = recorded_runs.write(tmp_path, methods=methods, more="tune: {}")
    with pytest.raises(ConfigError, match="tune: a recorded plant has the same runs for tuning"):
        load_config(path)


@pytest.mark.parametrize(("metric", "why"), [("inside", "a larger inside is better"), ("nees", "nees is best at 1")])
def test_a_metric_of_which_less_is_not_better_is_refused(tmp_path, metric, why):
    with pytest.raises(ConfigError, match=rf"tune.metric: tuning minimises its metric, and {why}"):
        load_config(write(tmp_path, metrics=f"[estimation_mse, {metric}]", tune=f"{{metric: {metric}}}"))


ADAPTED = "{KF: {estimator: {kind: kalman}}, KFR: {estimator: {kind: kalman}, tune: %s}}"
MHE = "{MHE: {estimator: {kind: moving-horizon, window: 3}, tune: {estimator.window: {range: [2, 5], integer: true}}}}"
SWEPT = {"sweep": "{grid: {plant.A: [0.9, 0.8]}}"}
MISFITS = [
    # row of `values`, text whose place is shown, path below the row, message, other keys
    ("{method: KFR, values: {model.P_v: 5000}}", "5000", '.values."model.P_v"', "the nearest value is 1000", {}),
    ("{method: KFR, values: {model.P_v: 0.001}}", "0.001", '.values."model.P_v"', "the nearest value is 0.01", {}),
    ("{method: KFX, values: {model.P_v: 5}}", "KFX", ".method", "did you mean 'KFR'?", {}),
    ("{method: KF, values: {model.P_v: 5}}", "KF,", ".method", "is not a known method with the key `tune`", {}),
    ("{method: KFR, values: {model.P_w: 5}}", "5", '.values."model.P_w"', "did you mean 'model.P_v'?", {}),
    ("{method: KFR, at: x=1, values: {model.P_v: 5}}", "x=1", ".at", "no sweep; leave out `at`", {}),
    ("{method: KFR, at: plant.A=0.7, values: {model.P_v: 5}}", "plant", ".at", "did you mean 'plant.A=0.9'?", SWEPT),
    ("{method: KFR, values: {model.P_v: 5}}", "{method", "", "name its point, such as `at: plant.A=0.9`", SWEPT),
    (
        "{method: KFR, at: plant.A=0.8, values: {model.P_v: 5000}}",
        "5000",
        '.values."model.P_v"',
        "the nearest value is 1000",
        SWEPT,
    ),
    (
        "{method: KFR, values: {model.P_v: 1}}",
        "{model",
        ".values",
        "model.P_w is missing, which is tuned too",
        {"methods": ADAPTED % "{model.P_v: [1, 2], model.P_w: [1, 2]}"},
    ),
    (
        "{method: KFR, values: {model.P_v: 0.2}}",
        "0.2",
        '.values."model.P_v"',
        "the nearest value is 0.3",
        {"methods": ADAPTED % "{model.P_v: {range: [0.2, 5], offset: 0.1}}"},
    ),
    (
        "{method: MHE, values: {estimator.window: 7}}",
        "7",
        '.values."estimator.window"',
        "the nearest value is 5",
        {"methods": MHE},
    ),
]


@pytest.mark.parametrize(("row", "text", "path", "message", "keys"), MISFITS)
def test_values_that_nothing_tunes_are_refused_at_their_place(tmp_path, row, text, path, message, keys):
    """Of another method, point, path or range: they were used or ignored without a word."""
    tune = f"{{budget: 6, runs: 5, values: [{row}]}}"
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, tune=tune, **keys))
    (found,) = caught.value.problems
    assert found.path == f"tune.values.0{path}" and message in found.message
    assert (found.line, found.column) == (*place("tune", text, tune),)


def test_values_of_a_method_are_given_once(tmp_path):
    row = "{method: KFR, values: {model.P_v: 5}}"
    with pytest.raises(ConfigError, match="tune.values.1: KFR has values above already"):
        load_config(write(tmp_path, tune=f"{{values: [{row}, {row}]}}"))


def test_ends_of_a_range_are_values_of_it_although_the_sum_with_an_offset_is_rounded(tmp_path):
    """0.1 + 0.2 is 0.30000000000000004, and a configuration has 12 digits."""
    methods = ADAPTED % "{model.P_v: {range: [0.2, 5], offset: 0.1}}"
    for value in (0.3, 5.1):
        path = write(tmp_path, methods=methods, tune=f"{{values: [{{method: KFR, values: {{model.P_v: {value}}}}}]}}")
        assert load_config(path).tuning.searches[0].values == {"model.P_v": value}


def test_inherited_values_of_a_method_that_is_not_here_are_left_out_and_named(tmp_path):
    """As claims and figures are; those of a range that has changed are an error of the change."""
    write(tmp_path, tune="{values: [{method: KFR, values: {model.P_v: 5}}]}")
    path = tmp_path / "tuned.yaml"
    config = load_config(path, overrides=["methods.KFR.tune=null"])
    (line,) = config.left_out
    assert line.startswith("tune.values.0: 'KFR' is not a known method with the key `tune`")
    with pytest.raises(ConfigError, match=r"the nearest value is 4; `-s tune.values=\[\]` searches again"):
        load_config(path, overrides=["methods.KFR.tune={model.P_v: [1, 4]}"])
    assert load_config(path, overrides=["methods.KFR.tune={model.P_v: [1, 4]}", "tune.values=[]"]).tuning.missing


LINES = [*KEYS]


def problem(path):
    """Return the only problem of a configuration."""
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    (found,) = caught.value.problems
    return found


BEST_INSIDE = [("nees", "nees is best at 1"), ("sample", "sample is best at 0")]


@pytest.mark.parametrize(("metric", "why"), [*BEST_INSIDE, ("inside", "a larger inside is better")])
def test_a_metric_that_is_not_to_be_small_is_refused_at_its_place(tmp_path, metric, why):
    """Whether the section names it, or it is the primary one; then the place is the section."""
    keys = "{kind: sample, of: e.0}" if metric == "sample" else metric
    changes = {"metrics": f"[estimation_mse, {keys}]"}
    named = f"{{budget: 6, metric: {metric}}}"
    found = problem(write(tmp_path, tune=named, **changes))
    assert found.path == "tune.metric" and why in found.message
    assert (found.line, found.column) == (LINES.index("tune") + 1, len("tune: ") + named.index(metric) + 1)
    found = problem(write(tmp_path, statistics=f"{{primary: {metric}}}", **changes))
    assert found.path == "tune.metric" and why in found.message and found.line == LINES.index("tune") + 1


def test_another_metric_may_be_tuned_where_the_primary_one_is_best_inside(tmp_path):
    changes = {"metrics": "[nees, estimation_mse]", "tune": "{metric: estimation_mse}"}
    assert load_config(write(tmp_path, **changes)).tuning.protocol.metric == "estimation_mse"


def test_values_that_were_tuned_elsewhere_have_their_budget(tmp_path):
    """In words, and in the resolved configuration, which loads as the same one; trials keep their hash."""
    given = KEYS["methods"].replace("KF: {", "KF: {parameters: {budget: 9, runs: 50}, ")
    config, other = load_config(write(tmp_path, methods=given)), load_config(write(tmp_path))
    assert config.parameters == {"KF": "tuned (budget 9, 50 runs)", "KFR": "tuned (budget 6, 5 runs)"}
    assert config.points[0].method_keys == other.points[0].method_keys
    (tmp_path / "resolved.yaml").write_text(dump(plain(config.resolved)), encoding="utf-8")
    assert load_config(tmp_path / "resolved.yaml").parameters == config.parameters


def test_the_key_tune_of_a_method_counts_before_what_was_tuned_elsewhere(tmp_path):
    """Where `tune: null` tunes nothing, the values of the file are those that were tuned elsewhere."""
    given = KEYS["methods"].replace("KFR: {", "KFR: {parameters: {budget: 9, runs: 50}, ")
    assert load_config(write(tmp_path, methods=given)).parameters["KFR"] == "tuned (budget 6, 5 runs)"
    assert load_config(write(tmp_path, methods=given, tune="null")).parameters["KFR"] == "tuned (budget 9, 50 runs)"


SOURCES = [
    ("mine", "", "mine", "must be 'as published' or 'default' (got 'mine')"),
    ("{budget: 0, runs: 50}", ".budget", "0, ", "must be >= 1 (got 0)"),
    ("{budget: 9}", "", "{budget", "'runs' is missing"),
    ("{budget: 9, runs: 50, seed: 1}", ".seed", "seed", "'seed' is not a known key; known: budget, runs"),
]


@pytest.mark.parametrize(("given", "path", "where", "message"), SOURCES, ids=[case[0] for case in SOURCES])
def test_a_wrong_source_of_parameters_is_reported_at_its_place(tmp_path, given, path, where, message):
    methods = f"{{KF: {{estimator: {{kind: kalman}}, parameters: {given}}}}}"
    found = problem(write(tmp_path, methods=methods, tune=None))
    assert found.path == f"methods.KF.parameters{path}" and message in found.message
    column = len("methods: ") + methods.index(given) + given.index(where) + 1
    assert (found.line, found.column) == (LINES.index("methods") + 1, column)


def test_more_parameters_than_the_search_has_dimensions_for_are_refused(tmp_path):
    names = ("A", "B", "C", "P_w", "P_v", "M_w", "M_v", "w_mean", "v_mean", "scale.process", "scale.measurement")
    ranges = {n: ", ".join(f"model.{name}: [0.1, 0.9]" for name in names[:n]) for n in (10, 11)}
    methods = {n: f"{{KF: {{estimator: {{kind: kalman}}, tune: {{{text}}}}}}}" for n, text in ranges.items()}
    found = problem(write(tmp_path, methods=methods[11]))
    assert found.path == "methods.KF.tune" and "has 11 parameters; at most 10 are chosen together" in found.message
    assert len(load_config(write(tmp_path, methods=methods[10])).tuning.searches[0].parameters) == 10
    assert MOST_PARAMETERS <= MOST_DIMENSIONS


WINDOW = "{{E: {{estimator: {{kind: moving-horizon}}, tune: {{estimator.window: {}}}}}}}"


def test_a_whole_number_needs_a_range_of_whole_numbers(tmp_path):
    """Its ends are whole numbers, but the values between them would have no design."""
    found = problem(write(tmp_path, methods=WINDOW.format("{range: [2, 40], scale: linear}")))
    assert found.path == 'methods.E.tune."estimator.window"'
    assert "must be a whole number" in found.message and "`integer: true` in its range tries only such" in found.message
    both = problem(write(tmp_path, methods=WINDOW.format("[2, 4]")))
    assert both.path == found.path and "whole number" in both.message
    for given in ("{range: [2, 40], scale: linear, integer: true}", "{range: [2, 3], integer: true}"):
        assert load_config(write(tmp_path, methods=WINDOW.format(given))).tuning.searches


@pytest.mark.parametrize("ends", [(0.0, 1.0), (2.0, 40.0), (-3.0, 5.0), (0.5, 2.5), (1e-9, 1e-6), (0.0, 2.0**0.5 * 2)])
def test_the_value_inside_of_a_range_is_no_whole_number(ends):
    value = _inside(TunedParameter("estimator.window", *ends, scale="linear"))
    assert ends[0] < value < ends[1] and value % 1
