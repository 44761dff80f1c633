"""Metrics that tuning must not make small are refused at their place; where the parameters of methods come from."""

import pytest
from tuned_experiment import KEYS, write

from rmpc_bench import load_config
from rmpc_bench.config.tuned_methods import _inside
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.numerics.direct_search import MOST_DIMENSIONS
from rmpc_bench.types import ConfigError
from rmpc_bench.types.tuning import MOST_PARAMETERS, TunedParameter

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
