"""The section `input` replaces the controller of all methods."""

import numpy as np
import pytest
from conftest import ROUND
from recorded_runs import SIMULATED, N
from recorded_runs import write as write_recorded
from uncertain_experiment import write_estimation, write_taking

from rmpc_bench import load_config, run
from rmpc_bench.simulation.closed_loop import simulate_block
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
    two = run(config, directory=tmp_path / "two", jobs=2, engine="joblib")
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


@pytest.fixture
def directory(tmp_path):
    for i in range(4):
        rows = "\n".join(f"{0.1 * k:.1f},{i + 0.1 * k:.1f}" for k in range(N))
        (tmp_path / f"u-{i}.csv").write_text(f"time,voltage\n{rows}\n", encoding="utf-8")
    return tmp_path


def inputs_of(directory, section, runs, n=4):
    experiment = (
        load_config(write_recorded(directory, SIMULATED, runs=n, more=f"input: {section}")).points[0].experiment
    )
    return simulate_block(experiment, experiment.methods[0], runs).traces["u"][:, :, 0]


def recorded_problems(directory, section, **keys):
    with pytest.raises(ConfigError) as caught:
        load_config(write_recorded(directory, SIMULATED, more=f"input: {section}", **keys))
    return [str(problem) for problem in caught.value.problems]


def test_every_run_has_its_own_file_in_any_block(directory):
    """The naive version takes file 0 for the first run of every block."""
    section = "{file: 'u-*.csv', columns: voltage, t: time}"
    expected = np.arange(4)[:, None] + np.round(0.1 * np.arange(N), 1)
    np.testing.assert_array_equal(inputs_of(directory, section, range(4)), expected)
    np.testing.assert_array_equal(inputs_of(directory, section, range(2, 4)), expected[2:])


def test_one_file_holds_for_all_runs(directory):
    found = inputs_of(directory, "{file: u-2.csv, columns: voltage}", range(3), n=9)
    np.testing.assert_array_equal(found, np.tile(2.0 + np.round(0.1 * np.arange(N), 1), (3, 1)))


def test_the_content_of_the_file_counts(directory):
    path = write_recorded(directory, SIMULATED, more="input: {file: u-0.csv, columns: voltage}")
    before = load_config(path).hash
    file = directory / "u-0.csv"
    file.write_text(file.read_text(encoding="utf-8").replace("0.3,0.3", "0.3,9"), encoding="utf-8")
    assert load_config(path).hash != before


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("{file: 'u-*.csv', columns: voltage}", "there are 5 runs, and `input.file` names 4 files"),
        ("{file: u-9.csv}", "there is no file u-9.csv; did you mean"),
        ("{file: u-0.csv, columns: volts}", "input.columns: u-0.csv: 'volts' is not a known column"),
        ("{file: u-0.csv, columns: [voltage, time]}", "names 2 columns of u-0.csv, and there are 1 inputs"),
        ("{file: u-0.csv, columns: voltage, resample: linear}", "needs the column of the time; give `t`"),
    ],
)
def test_what_does_not_fit_is_shown(directory, section, message):
    assert any(message in text for text in recorded_problems(directory, section)), recorded_problems(directory, section)
