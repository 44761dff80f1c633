"""Late and rarely measured outputs in configurations: short forms, names, identity and mistakes."""

import pytest
from uncertain_experiment import write_estimation

from rmpc_bench import load_config
from rmpc_bench.types import ConfigError

PLANT = "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], B: [[1], [0]], C: [[1, 0], [0, 1]]}"
LATE = "{measurement: {sum: [{gaussian: {cov: 1}}, {delayed: 2}]}}"


@pytest.fixture
def load(tmp_path):
    """Return a function that loads a configuration with some keys replaced."""
    keys = {"plant": PLANT, "model": "{from: plant, P_w: 0.1, P_v: 1}", "methods": "{KF: {estimator: {kind: kalman}}}"}
    keys |= {"noise": LATE, "initial": "{x: 1, x_hat: 0, P: 1}"}
    return lambda **given: load_config(write_estimation(tmp_path, **(keys | given)))


def law_of(config):
    """The last law of the measurement."""
    return config.experiment.scenario.measurement[-1]


def test_a_number_is_short_for_its_samples(load):
    """Oracle: the long form has the same law and the same identity; a sweep reaches the number by both."""
    short, long = load(), load(noise=LATE.replace("2}", "{samples: 2}}"))
    assert law_of(short).longest_delay == law_of(long).longest_delay == 2
    assert short.resolved["noise"]["measurement"]["sum"][1] == {"delayed": {"samples": 2, "per": "step"}}
    assert short.points[0].method_keys == long.points[0].method_keys
    swept = load(sweep="{grid: {noise.measurement.sum.1.delayed: [0, 3]}}")
    assert [each.experiment.scenario.measurement[-1].longest_delay for each in swept.points] == [0, 3]


def test_outputs_by_names_and_by_numbers(load, tmp_path):
    """Oracle: the outputs of the plant, in the order of the file; without names they are y.0 and y.1."""
    for only in ("[y.1]", "[1]"):
        law = law_of(load(noise=LATE.replace("2}", f"{{samples: 2, only: {only}}}}}")))
        assert law.chosen.tolist() == [False, True]
    equation = "def rhs(x, u, p):\n    return x[1], u[0]\n\ndef out(x, p):\n    return x[1], x[0]\n"
    (tmp_path / "eq.py").write_text(equation)
    names = "states: [position, speed], inputs: [force], outputs: [speed, position]"
    plant = f"{{ode: eq.py:rhs, output: eq.py:out, {names}}}"
    given = {"plant": plant, "model": "{linearise: plant, at: {u: 0, x: 0}, noise: {process: 1, measurement: 1}}"}
    given |= {"noise": LATE.replace("2}", "{samples: 2, only: [position]}}"), "initial": "{x_hat: 0, P: 1}"}
    assert law_of(load(**given)).chosen.tolist() == [False, True]
    with pytest.raises(ConfigError, match="'positon' is not a known name of this signal; did you mean 'position'"):
        load(**given | {"noise": given["noise"].replace("position]", "positon]")})


def test_new_keys_leave_old_identities(load):
    """Oracle: the plain data of the law have the keys that are written."""
    found = load(noise="{measurement: {missing: {probability: 0.2}}}").resolved["noise"]["measurement"]
    assert found == {"missing": {"probability": 0.2, "outputs": "together"}}


SINGLE = """
from rmpc_bench import single_run

@single_run
class Own:
    bridges_missing = True
    def update(self, y):
        return [0.0, 0.0]

@single_run
class Blind:
    def update(self, y):
        return [0.0, 0.0]
"""
NUMBER = "{from: plant, P_w: 0.1, P_v: 1, delay: {measurement: 1}}"
KNOWN = {"model": "{from: plant, P_w: 0.1, P_v: 1, delay: same}"}
UNFIT = "the estimator of 'A' cannot use late measurements: `delay: none` gives it y as it arrives"


@pytest.mark.parametrize(
    ("keys", "path", "message"),
    [
        ({"noise": LATE.replace("2}", "1.5}")}, "noise.measurement.sum.1.delayed.samples", "for parts of a sample"),
        ({"noise": LATE.replace("2}", "{samples: [0, 1.5]}}")}, "noise.measurement.sum.1.delayed.samples.1", "whole"),
        ({"noise": LATE.replace("2}", "{samples: 2, pre: run}}")}, "noise.measurement.sum.1.delayed.pre", "'per'"),
        ({"noise": "{process: {delayed: 1}}"}, "noise.process.delayed", "alters a"),
        ({"noise": "{measurement: {missing: {every: 2, known: true}}}"}, "noise.measurement.missing.known", "input"),
        ({"evaluate": "moments"}, "evaluate", "no exact moments"),
        ({"evaluate": "moments", "noise": "{measurement: {gaussian: {cov: 1}}}", "model": NUMBER}, "evaluate", "late"),
        (KNOWN | {"methods": "{A: {estimator: {file: own.py:Blind}}}"}, "methods.A", UNFIT),
        (KNOWN | {"methods": "{A: {estimator: {file: own.py:Own, on_failure: hold}}}"}, "methods.A", UNFIT),
    ],
)  # fmt: skip
def test_mistakes_are_reported_at_their_key(load, tmp_path, keys, path, message):
    """Oracle: the specification."""
    (tmp_path / "own.py").write_text(SINGLE)
    with pytest.raises(ConfigError) as caught:
        load(**keys)
    [problem] = caught.value.problems
    assert message in problem.message and problem.path == path and problem.line > 1


def test_such_estimators_get_y_as_it_arrives(load, tmp_path):
    """Oracle: with `delay: none` the same estimator is accepted."""
    (tmp_path / "own.py").write_text(SINGLE)
    model = "{from: plant, P_w: 0.1, P_v: 1, delay: none}"
    load(methods="{A: {estimator: {file: own.py:Own, on_failure: hold}}}", model=model)
