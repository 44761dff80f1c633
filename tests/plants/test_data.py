"""Recorded runs as plant: replayed as they are, and refused where they do not fit."""

import shutil

import numpy as np
import pytest
from conftest import EXACT, ROUND
from recorded_runs import N_RUNS, REPLAY, WITH_STATE, N, record, write, write_run

from rmpc_bench import load_config, run
from rmpc_bench.types import ConfigError


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    directory = tmp_path_factory.mktemp("recorded")
    return directory, *record(directory)


@pytest.fixture
def copy(recorded, tmp_path):
    shutil.copytree(recorded[0] / "runs", tmp_path / "runs")
    return tmp_path, recorded[1]


def problems(path):
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    return [str(problem) for problem in caught.value.problems]


def signals_of(results):
    return next(iter(results.traces.values())).signals


def replayed(directory, **keys):
    """Simulate the runs in this process, without a store."""
    from rmpc_bench.simulation.closed_loop import simulate_block

    experiment = load_config(write(directory, **keys)).points[0].experiment
    return lambda runs: simulate_block(experiment, experiment.methods[0], runs)


def test_estimates_on_recorded_data_are_those_of_the_original_run(recorded):
    directory, original, frame = recorded
    path = write(directory, WITH_STATE, metrics="[estimation_mse, nis]")
    results = run(load_config(path), directory=directory / "replay", jobs=1)
    for name in ("u", "x", "x_hat"):
        np.testing.assert_allclose(signals_of(results)[name], original[name], **ROUND)
    for name in ("estimation_mse", "nis"):
        np.testing.assert_allclose(results.trials.frame[name], frame[name], **ROUND)


def test_data_without_inputs_and_a_model_without_inputs(tmp_path):
    """Oracle: the scalar Kalman filter by hand; a missing B is no input, one with an effect is refused."""
    (tmp_path / "y.csv").write_text("t,y\n0,0\n0.1,0.1\n0.2,0.2\n0.3,0.3\n")
    text = """version: 1
name: silent
runs: 1
time: {step: 0.1, steps: 3}
plant: {data: y.csv, columns: {y: [y]}, t: t}
model: {kind: linear, A: [[0.9]], C: [[1]], P_w: 0.01, P_v: 0.01}
initial: {x_hat: 0, P: 1}
methods: {KF: {estimator: {kind: kalman}}}
metrics: [innovation_mse]
"""
    (tmp_path / "silent.yaml").write_text(text)
    trials = run(load_config(tmp_path / "silent.yaml"), directory=tmp_path / "out", jobs=1).trials.frame
    x, P, squares = 0.0, 1.0, []
    for y in (0.0, 0.1, 0.2, 0.3):
        squares.append((y - x) ** 2)
        gain = P / (P + 0.01)
        x, P = 0.9 * (x + gain * (y - x)), 0.81 * (1 - gain) * P + 0.01
    assert trials["innovation_mse"][0] == pytest.approx(np.mean(squares), rel=1e-12)
    (tmp_path / "silent.yaml").write_text(text.replace("C: [[1]]", "B: [[1]], C: [[1]]"))
    assert any("has 1 inputs and the recorded data have 0" in each for each in problems(tmp_path / "silent.yaml"))


def test_without_a_state_no_run_diverges_and_only_the_innovation_is_judged(recorded):
    directory, original, frame = recorded
    path = write(directory, name="stateless", metrics="[nis, innovation_mse, {kind: whiteness, lags: 5}]")
    results = run(load_config(path), directory=directory / "stateless", jobs=1)
    assert (results.trials.frame["status"] == "ok").all()
    np.testing.assert_allclose(results.trials.frame["nis"], frame["nis"], **ROUND)
    np.testing.assert_allclose(signals_of(results)["x_hat"], original["x_hat"], **ROUND)
    assert "x" not in signals_of(results)
    found = problems(write(directory, name="state-metric", metrics="[estimation_mse, nis]"))
    assert len(found) == 1 and "metrics.0" in found[0] and "plant.columns.x" in found[0]


def test_the_file_of_a_run_does_not_depend_on_the_block(recorded):
    """A plant that takes the rows of a block for the runs replays file 0 as the first run of every block."""
    block = replayed(recorded[0], name="blocks")
    together = block(range(N_RUNS)).metrics[0]
    np.testing.assert_array_equal([block(range(i, i + 1)).metrics[0, 0] for i in range(N_RUNS)], together)
    assert len(set(together)) == N_RUNS


def test_the_bytes_do_not_depend_on_workers_and_block(copy, tmp_path):
    """Recorded runs in worker processes; the configuration in the results finds the data of another directory."""
    path = write(copy[0], name="workers")
    results = tmp_path / "one"
    one = run(load_config(path), directory=results, jobs=1)
    config = load_config(path, overrides=["execution.block=2"])
    two = run(config, directory=tmp_path / "two", jobs=2, engine="joblib")
    assert one.trials.frame.equals(two.trials.frame)
    again = load_config(results / "config.resolved.yaml")
    assert again.points[0].method_keys == load_config(path).points[0].method_keys


def test_a_gap_is_a_prediction_of_the_kalman_filter(copy):
    """From the gap on the covariance is that of a filter without this measurement; other runs keep their bits."""
    directory, original = copy
    before = replayed(directory, plant=WITH_STATE, metrics="[nis, nees]")(range(N_RUNS))
    y = original["y"].copy()
    y[2, 7:10] = np.nan
    write_run(directory / "runs" / "run-2.csv", *(each[2] for each in (original["u"], y, original["x"])))
    block = replayed(directory, plant=WITH_STATE, metrics="[nis, nees]")
    found = block(range(N_RUNS))
    assert not found.status.any()
    others = [0, 1, 3, 4]
    np.testing.assert_allclose(found.metrics[:, others], before.metrics[:, others], **ROUND)
    for i in range(N_RUNS):
        alone = block(range(i, i + 1))
        np.testing.assert_array_equal(alone.metrics[:, 0], found.metrics[:, i])
    A, B, C = np.array([[0.9, 0.2], [0.0, 0.7]]), np.array([0.0, 1.0]), np.array([[1.0, 0.0]])
    x, P, errors, nis = np.zeros(2), 0.01 * np.eye(2), [], []
    for k in range(N + 1):
        if np.isfinite(y[2, k, 0]):
            S = (C @ P @ C.T)[0, 0] + 0.04
            e = y[2, k, 0] - x[0]
            L = P @ C.T / S
            x, P = x + L[:, 0] * e, P - L @ C @ P
            nis.append(e**2 / S)
        errors.append((x - original["x"][2, k]) @ np.linalg.solve(P, x - original["x"][2, k]) / 2)
        if k < N:
            x, P = A @ x + B * original["u"][2, k, 0], A @ P @ A.T + 0.01 * np.eye(2)
    np.testing.assert_allclose(found.metrics[:, 2], [np.mean(nis), np.mean(errors[:N])], rtol=1e-9)  # other recursion


def test_gaps_of_recorded_data_need_no_remark_where_estimators_bridge_them(copy):
    directory, original = copy
    y = original["y"][1].copy()
    y[4] = np.nan
    write_run(directory / "runs" / "run-1.csv", original["u"][1], y, original["x"][1])
    methods = "{KF: {estimator: {kind: kalman}}, SM: {estimator: {kind: set-membership}}}"
    config = load_config(write(directory, methods=methods, metrics="[innovation_mse]"))
    texts = [str(each) for each in config.warnings]
    assert not [text for text in texts if "the first at sample 4 of run-1.csv" in text]


@pytest.mark.parametrize(
    ("keys", "place", "message"),
    [
        ({"runs": 6}, "runs:", "there are 6 runs, and `plant.data` names 5 files"),
        ({"plant": REPLAY.replace("level", "levle")}, "plant.columns", "did you mean 'level'?"),
        ({"plant": REPLAY.replace("*", "nothing-*")}, "plant.data", "there is no file runs/nothing-*.csv"),
        ({"plant": REPLAY.replace("t: time", "t: tmie")}, "plant.t", "did you mean 'time'?"),
        ({"plant": REPLAY.replace("level", "[level, x2]")}, "plant:", "has 1 outputs and the recorded data have 2"),
        ({"more": "controller: {kind: lqr, horizon: 5, Q_x: 1, R_u: 1}"}, "controller:", "no controller can act"),
        ({"more": "input: {kind: steps, times: [0], values: [1]}"}, "input:", "leave `input` out"),
        ({"more": "noise: {measurement: {gaussian: {std: 1}}}"}, "noise:", "contain their noise"),
        ({"more": "initial: {x: 1}"}, "initial.x:", "leave `x` out"),
    ],
)
def test_what_does_not_fit_is_shown_at_its_key(recorded, keys, place, message):
    found = problems(write(recorded[0], name="wrong", **keys))
    assert any(place in text and message in text for text in found), found


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: lines[1:], "run-3.csv: the first line must name the columns"),
        (lambda lines: lines[:10], "run-3.csv: has 9 samples at a step of 0.1, and the experiment needs 21"),
        (lambda lines: [*lines[:5], *lines[6:], lines[-1].replace("2.0,", "2.1,", 1)], "give `resample: linear`"),
        (lambda lines: [*lines[:5], "0.4,,1.0,1.0,1.0", *lines[6:]], "the input is missing at sample 4"),
        (lambda lines: [*lines[:5], "0.4,1.0,1.0,,1.0", *lines[6:]], "x is missing at sample 4"),
        (lambda lines: [*lines[:5], "0.4,one,1.0,1.0,1.0", *lines[6:]], "line 6: 'one' in the column 'voltage'"),
        (lambda lines: [*lines[:5], "0.4,1.0", *lines[6:]], "line 6 has 2 cells, and there are 5 columns"),
        (lambda lines: [lines[0].replace("x2", "x1"), *lines[1:]], "two columns of the name 'x1'"),
        (lambda lines: [], "run-3.csv: is empty"),
    ],
)
def test_a_file_that_does_not_fit_is_named(copy, change, message):
    directory, _ = copy
    file = directory / "runs" / "run-3.csv"
    file.write_text("\n".join(change(file.read_text(encoding="utf-8").splitlines())), encoding="utf-8")
    found = problems(write(directory, WITH_STATE))
    assert any(message in text for text in found), found


def test_other_steps_are_resampled_on_request(copy):
    """Every second sample is on a recorded one; a long recorded step is a gap."""
    directory, original = copy
    times = np.sort(np.concatenate([0.1 * np.arange(N + 1), 0.05 + 0.1 * np.arange(N)]))
    kept = [i for i, t in enumerate(times) if not 0.75 < t < 1.15]
    signals = original | {"u": np.append(original["u"], original["u"][:, -1:], axis=1)}
    dense = {name: np.repeat(signals[name][0], 2, axis=0)[: len(times)] for name in ("u", "y", "x")}
    write_run(directory / "runs" / "run-0.csv", *(dense[name][kept] for name in ("u", "y", "x")), times=times[kept])
    assert any("resample" in text for text in problems(write(directory, runs=1)))
    path = write(directory, REPLAY.replace("t: time", "t: time, resample: linear"), runs=1)
    plant = load_config(path).points[0].experiment.plant
    gap = np.zeros(N + 1, dtype=bool)
    gap[8:12] = True
    np.testing.assert_array_equal(np.isnan(plant.y[0, :, 0]), gap)
    np.testing.assert_allclose(plant.y[0, ~gap], original["y"][0, ~gap], **EXACT)
    np.testing.assert_allclose(plant.u.values[0, :8], original["u"][0, :8], **EXACT)


def test_an_edited_data_file_is_another_experiment(copy):
    directory, original = copy
    path = write(directory)
    before = load_config(path).hash
    assert load_config(path).hash == before
    write_run(directory / "runs" / "run-4.csv", original["u"][4], original["y"][4] + 1.0, original["x"][4])
    assert load_config(path).hash != before


def test_arrays_of_npz_files_have_numbered_columns(copy):
    directory, original = copy
    y, u, x = (original[name][0] for name in ("y", "u", "x"))
    np.savez(directory / "run.npz", y=y, u=np.append(u[:N], [[0.0]], axis=0), x=x)
    path = write(directory, "{data: run.npz, columns: {y: y, u: u, x: x}}", runs=1, metrics="[estimation_mse]")
    plant = load_config(path).points[0].experiment.plant
    np.testing.assert_array_equal(plant.x[0], original["x"][0])
