"""The section `input` replaces the controller of all methods."""

import numpy as np
import pytest
from conftest import ROUND
from uncertain_experiment import write_estimation, write_taking

from rmpc_bench import load_config, run
from rmpc_bench.types import ConfigError

PLANT = "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], B: [[0], [1]], C: [[1, 0]]}"
MODEL = "{from: plant, P_w: 0.01, P_v: 0.04}"
SIGNAL = "{kind: steps, times: [0, 5], values: [1, -2]}"
OPEN = {
    "plant": PLANT,
    "model": MODEL,
    "input": SIGNAL,
    "initial": None,
    "methods": "{KF: {estimator: {kind: kalman}}, slow: {estimator: {kind: kalman}, model: {P_w: 1e-6}}}",
    "record": "{runs: all, signals: [u, x]}",
}


def problems(path, **options):
    with pytest.raises(ConfigError) as caught:
        load_config(path, **options)
    return [str(problem) for problem in caught.value.problems]


def test_plant_and_estimators_get_the_input(tmp_path):
    """Without noise the state is that of the recursion, which the estimators know exactly."""
    path = write_estimation(tmp_path, **(OPEN | {"noise": "none"}))
    results = run(load_config(path), directory=tmp_path / "results", jobs=1)
    A, B, x, states = np.array([[0.9, 0.2], [0.0, 0.7]]), np.array([0.0, 1.0]), np.zeros(2), []
    u = np.where(np.arange(12) < 5, 1.0, -2.0)
    for value in u:
        states.append(x)
        x = A @ x + B * value
    for traces in results.traces.values():
        for row in range(6):
            np.testing.assert_allclose(traces.signals["u"][row, :, 0], u, **ROUND)
            np.testing.assert_allclose(traces.signals["x"][row, :12], np.array(states), **ROUND)
    assert (results.trials.frame["estimation_mse"] < 1e-25).all()  # rounding of states of size 10


def test_the_bytes_do_not_depend_on_workers_and_block(tmp_path):
    path = write_estimation(tmp_path, **OPEN)
    one = run(load_config(path), directory=tmp_path / "one", jobs=1)
    config = load_config(path, overrides=["execution.block=4"])
    two = run(config, directory=tmp_path / "two", jobs=2)
    assert one.trials.frame.equals(two.trials.frame)


def test_the_input_is_a_part_of_the_experiment(tmp_path):
    hashes = {
        load_config(write_estimation(tmp_path, **(OPEN | {"input": signal}))).hash
        for signal in (SIGNAL, SIGNAL.replace("-2", "-3"), "{kind: sine, amplitude: 1, period: 5}", None)
    }
    assert len(hashes) == 4


def test_the_resolved_configuration_has_the_input(tmp_path):
    path = write_estimation(tmp_path, **OPEN)
    results = run(load_config(path), directory=tmp_path / "results", jobs=1)
    assert load_config(tmp_path / "results" / "config.resolved.yaml").hash == results.experiment.hash


@pytest.mark.parametrize(
    "keys",
    [
        {"controller": "{kind: lqr, horizon: 12, Q_x: 1, R_u: 1}"},
        {"methods": "{A: {estimator: {kind: kalman}, controller: {kind: lqr, horizon: 12, Q_x: 1, R_u: 1}}}"},
    ],
)
def test_a_controller_beside_an_input_is_refused(tmp_path, keys):
    found = problems(write_estimation(tmp_path, **(OPEN | keys)))
    assert any("input: replaces the controller of all methods; leave out `" in text for text in found)


def test_wrong_keys_are_shown_at_their_place(tmp_path):
    found = problems(write_estimation(tmp_path, **(OPEN | {"input": "{kind: stps}"})))
    assert any("input.kind: 'stps' is not a known input; did you mean 'steps'?" in text for text in found)
    found = problems(write_estimation(tmp_path, **(OPEN | {"input": "{kind: steps, times: [0], values: [[1, 2]]}"})))
    assert any("input.values: " in text for text in found)


def test_the_input_may_be_swept(tmp_path):
    path = write_estimation(tmp_path, **OPEN, sweep="{grid: {input.values: {up: [0, 1], down: [0, -1]}}}")
    assert len({point.experiment_hash for point in load_config(path).points}) == 2


def test_the_input_comes_with_the_plant_of_another_file_unless_there_is_a_controller(tmp_path):
    write_estimation(tmp_path, file="source.yaml", **OPEN)
    taken = load_config(write_taking(tmp_path, "{from: source.yaml}", methods=OPEN["methods"]))
    assert taken.first_point["input"]["kind"] == "steps"
    controlled = write_taking(
        tmp_path, "{from: source.yaml}", methods=OPEN["methods"], controller="{kind: lqr, horizon: 12, Q_x: 1, R_u: 1}"
    )
    assert "input" not in load_config(controlled).first_point
