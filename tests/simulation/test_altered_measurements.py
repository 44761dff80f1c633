"""Rounded and missing measurements in the loop: by hand, block by block, and in everything that runs a loop."""

import numpy as np
import pytest
from conftest import ROUND
from small_experiment import write
from uncertain_experiment import write_estimation

from rmpc_bench import load_config
from rmpc_bench.simulation.closed_loop import simulate, simulate_block
from rmpc_bench.simulation.episode import Episode
from rmpc_bench.simulation.random_streams import stream

NOISE = (
    "{process: {gaussian: {cov: 0.1}}, measurement: {sum: [{quantised: {step: 0.5}}, {gaussian: {cov: 1}}, "
    "{missing: {probability: 30%}}]}}"
)
LINEAR = {
    "plant": "{kind: linear, A: [[0.9, 0.2], [0, 0.7]], C: [[1, 0], [0, 1]]}",
    "model": "{from: plant, P_w: 0.1, P_v: 1}",
    "noise": NOISE,
    "initial": "{x: 1, x_hat: 0, P: 1}",
    "methods": "{KF: {estimator: {kind: kalman}}, RKF: {estimator: {kind: robust-kalman, c: 0.1}}}",
    "metrics": "[estimation_mse, nis, innovation_mse, nees]",
    "runs": "7",
}


@pytest.fixture
def experiment(tmp_path):
    """Return a function that loads an experiment with some keys replaced."""
    return lambda **keys: load_config(write_estimation(tmp_path, **(LINEAR | keys))).experiment


def recorded(experiment, name, runs):
    """Trajectories of some runs, with what the estimator reports."""
    draws = experiment.scenario.draw(experiment.plant, runs, experiment.n_steps)
    r = experiment.scenario.reference.sample(experiment.n_steps + 1)
    record, status = simulate(experiment.plant, experiment.method(name), draws, r, experiment.n_steps, info=("e",))
    assert not status.any()
    return record, draws


def measured(experiment, run, x):
    """Measurements of a run by hand: C x + v with the stream v/1, rounded, then omitted by the stream v/2."""
    n = experiment.n_steps + 1
    v = stream(7, run, "v/1").standard_normal((n, 2))
    y = 0.5 * np.rint((x + v) / 0.5)
    y[stream(7, run, "v/2").random((n, 1))[:, 0] < 0.3] = np.nan
    return y


def test_a_kalman_filter_on_what_is_measured(experiment):
    """Oracle: the filter by hand, without a correction where y is missing, with P of its own."""
    made = experiment()
    record, _ = recorded(made, "KF", range(7))
    A = np.array([[0.9, 0.2], [0.0, 0.7]])
    lost = 0
    for run in range(7):
        y = measured(made, run, record.x[run])
        x_hat, P = np.zeros(2), np.eye(2)
        for k in range(made.n_steps + 1):
            lost += np.isnan(y[k, 0])
            np.testing.assert_allclose(record.info["e"][run, k], y[k] - x_hat, rtol=1e-9, atol=1e-12)  # other recursion
            if not np.isnan(y[k, 0]):
                L = P @ np.linalg.inv(P + np.eye(2))
                x_hat, P = x_hat + L @ (y[k] - x_hat), P - L @ P
            np.testing.assert_allclose(record.x_hat[run, k], x_hat, rtol=1e-9)  # another form of the recursion
            x_hat, P = A @ x_hat, A @ P @ A.T + 0.1 * np.eye(2)
    assert lost > 10
    np.testing.assert_array_equal(record.y, record.x)  # without noise and without gaps


def test_metrics_leave_missing_samples_out(experiment):
    """Oracle: the mean over the innovations that are numbers, by hand."""
    made = experiment()
    record, _ = recorded(made, "KF", range(7))
    block = simulate_block(made, made.method("KF"), range(7))
    e = record.info["e"]
    by_hand = [np.mean(each[~np.isnan(each)] ** 2) for each in e]
    np.testing.assert_allclose(block.metrics[2], by_hand, **ROUND)
    assert np.isnan(e).any() and np.isfinite(block.metrics).all()


@pytest.mark.parametrize("name", ["KF", "RKF"])
@pytest.mark.parametrize("probability", ["30%", "2%"])
def test_a_row_of_a_block_is_a_run_alone(experiment, name, probability):
    """Oracle: blocks of one run, bit for bit, also of runs without any gap."""
    made = experiment(noise=NOISE.replace("30%", probability))
    whole = simulate_block(made, made.method(name), range(7))
    for run in range(7):
        alone = simulate_block(made, made.method(name), range(run, run + 1))
        np.testing.assert_array_equal(alone.metrics[:, 0], whole.metrics[:, run])


def test_laws_act_in_the_order_of_the_list(experiment):
    """Oracle: two grids by hand; the first is rounded again by the second."""
    laws = ("quantised: {step: 1}", "quantised: {step: 3}")
    y = np.array([[1.4, 0.0], [1.6, 5.6], [4.4, -1.6]])
    for order, expected in ((laws, 3 * np.rint(np.rint(y) / 3)), (laws[::-1], np.rint(3 * np.rint(y / 3)))):
        made = experiment(noise="{measurement: {sum: [" + ", ".join(f"{{{law}}}" for law in order) + "]}}")
        drawn = made.scenario.draw(made.plant, range(3), made.n_steps)
        np.testing.assert_array_equal(drawn.altered(2, y), expected)


def test_outputs_that_are_missing_by_themselves(experiment):
    """Oracle: one Kalman filter per sample with the rows of C that are there; the other output still corrects."""
    made = experiment(
        noise="{measurement: {sum: [{gaussian: {cov: 1}}, {missing: {probability: 0.5, outputs: each}}]}}"
    )
    record, _ = recorded(made, "KF", range(4))
    A, one = np.array([[0.9, 0.2], [0.0, 0.7]]), 0
    for run in range(4):
        lost = np.isnan(record.info["e"][run])
        n = made.n_steps + 1
        np.testing.assert_array_equal(lost, stream(7, run, "v/1").random((n, 2)) < 0.5)
        y = record.x[run] + stream(7, run, "v/0").standard_normal((n, 2))
        x_hat, P = np.zeros(2), np.eye(2)
        for k in range(n):
            C = np.eye(2)[~lost[k]]
            one += len(C) == 1
            L = P @ C.T @ np.linalg.inv(C @ P @ C.T + np.eye(len(C)))
            x_hat, P = x_hat + L @ (y[k, ~lost[k]] - C @ x_hat), P - L @ C @ P
            np.testing.assert_allclose(record.x_hat[run, k], x_hat, rtol=1e-9)  # another form of the recursion
            x_hat, P = A @ x_hat, A @ P @ A.T + 0.1 * np.eye(2)
    assert one > 5


def test_an_episode_is_the_run(experiment):
    """Oracle: the estimates of the loop, bit for bit; y of a sample is what is measured."""
    made = experiment()
    record, _ = recorded(made, "KF", range(2, 3))
    episode = Episode(made, 2, made.method("KF"))
    samples = [episode.sample]
    while not episode.is_over:
        samples.append(episode.step(np.zeros(made.plant.nu)))
    np.testing.assert_array_equal([each.x_hat for each in samples], record.x_hat[0])
    np.testing.assert_allclose([each.y for each in samples], measured(made, 2, record.x[0]), **ROUND)


@pytest.mark.parametrize(
    "controller",
    [
        "{kind: pid, Kp: 0.5, Ki: 0.1, on: y}",
        "{kind: mpc, Hp: 10, Hu: 3, Q: 0.1, R: 0.1, scale: {u: 440, y: 2*pi}}",
    ],
)
def test_closed_loops_with_rounded_and_missing_measurements(tmp_path, controller):
    """Oracle: no run fails, every method has the same measurements, and the loop is another one than without."""
    noise = "{measurement: {sum: [{gaussian: {std: 0.01}}, {quantised: {step: 0.05}}, {missing: {probability: 0.2}}]}}"
    made = load_config(write(tmp_path, controller=controller, noise=noise)).experiment
    plain = load_config(write(tmp_path, controller=controller)).experiment
    for name in ("S-MPC", "R-MPC"):
        found, before = (simulate_block(each, each.method(name), range(6)) for each in (made, plain))
        assert not found.status.any() and np.isfinite(found.metrics).all()
        assert (found.metrics != before.metrics).any()


def test_other_laws_keep_their_streams(experiment):
    """Oracle: the noise without the laws that alter the measurement, which stand behind it in the list."""
    plain = experiment(noise="{measurement: {gaussian: {cov: 1}}}")
    made = experiment(noise="{measurement: {sum: [{gaussian: {cov: 1}}, {quantised: {step: 1}}]}}")
    one, two = (each.scenario.draw(each.plant, range(3), 12).v for each in (plain, made))
    np.testing.assert_array_equal(one, two)
