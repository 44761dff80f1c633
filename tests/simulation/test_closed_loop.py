"""The simulation loop against a run by hand; failures stay in their row; blocks do not matter."""

import numpy as np
import pytest
from conftest import ROUND, servo_model
from simulation.toy import Delta, Halfway, Proportional, Walk, by_hand

from rmpc_bench.controllers import mpc
from rmpc_bench.estimators import robust_kalman
from rmpc_bench.metrics.input import InputPower
from rmpc_bench.metrics.tracking import Mae, Mse, Rmse, SettlingTime, SteadyStateError
from rmpc_bench.noise.distributions import Uniform
from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.plants import servo
from rmpc_bench.simulation.closed_loop import simulate, simulate_block
from rmpc_bench.simulation.reference import constant
from rmpc_bench.simulation.scenario import Draws, Experiment, Scenario
from rmpc_bench.types import Method, Status

TOY = Method("toy", Halfway(), Proportional())
STEPS, RUNS = 12, 5
ALL_METRICS = (Mse(), Mae(), Rmse(), InputPower(), SettlingTime(), SteadyStateError())


def toy_draws(rng, a=None):
    """Five runs of the toy plant with noise and their own parameter."""
    a = rng.uniform(0.5, 1.1, RUNS) if a is None else np.asarray(a)
    status = np.where(a >= 0.0, Status.OK, Status.OUT_OF_RANGE).astype(np.int8)
    shapes = ((RUNS, 1), (RUNS, STEPS, 1), (RUNS, STEPS + 1, 1))
    return Draws(Delta(a, status), *(rng.standard_normal(shape) for shape in shapes))


@pytest.fixture
def r(rng):
    """Return a reference that changes at every sample."""
    return rng.standard_normal((STEPS + 2, 1))


def test_the_loop_measures_corrects_controls_moves_and_predicts(rng, r):
    """Oracle: the same loop in plain Python floats, run by run."""
    draws = toy_draws(rng)
    record, status = simulate(Walk(), TOY, draws, r, STEPS)
    np.testing.assert_array_equal(status, np.zeros(RUNS, dtype=np.int8))
    for i in range(RUNS):
        scalars = (draws.delta.a[i], draws.x0[i, 0], draws.w[i, :, 0], draws.v[i, :, 0], r[:, 0])
        x, x_hat, u = by_hand(*scalars, STEPS)
        np.testing.assert_allclose(record.x[i, :, 0], x, atol=1e-13)
        np.testing.assert_allclose(record.x_hat[i, :, 0], x_hat, atol=1e-13)
        np.testing.assert_allclose(record.u[i, :, 0], u, atol=1e-13)


def test_the_record_holds_the_true_output_of_all_samples(rng, r):
    """Oracle: y = x of the toy plant, without v; there is no input at k = N."""
    record, _ = simulate(Walk(), TOY, toy_draws(rng), r, STEPS)
    np.testing.assert_array_equal(record.y, record.x)
    assert (record.x.shape, record.u.shape) == ((RUNS, STEPS + 1, 1), (RUNS, STEPS, 1))
    np.testing.assert_array_equal(record.r, r[: STEPS + 1])
    assert all(part.flags.c_contiguous for part in record[1:5])


def others_unchanged(record, expected, row):
    """Assert that all rows but one have the same bits."""
    for ours, theirs in zip(record[1:5], expected[1:5], strict=True):
        np.testing.assert_array_equal(np.delete(ours, row, axis=0), np.delete(theirs, row, axis=0))


def test_a_run_that_diverges_stands_still_and_the_others_do_not_notice(rng, r):
    """Oracle: the same block with a tame run in row 2; 1e5 per sample passes 1e6 at k = 2."""
    draws = toy_draws(rng, [0.9] * RUNS)
    wild = draws._replace(delta=Delta(np.array([0.9, 0.9, 1e5, 0.9, 0.9]), draws.delta.status))
    record, status = simulate(Walk(), TOY, wild, r, STEPS)
    expected, _ = simulate(Walk(), TOY, draws, r, STEPS)
    np.testing.assert_array_equal(status, [Status.OK, Status.OK, Status.DIVERGED, Status.OK, Status.OK])
    others_unchanged(record, expected, 2)
    x = record.x[2, :, 0]
    assert 1e4 < abs(x[1]) < 1e6
    np.testing.assert_array_equal(x[1:], np.full(STEPS, x[1]))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_one_bad_measurement_fails_its_run_only(value, rng, r):
    """Oracle: the same block without it, bit for bit; the run stands still from k = 5 on."""
    draws = toy_draws(rng, [0.9] * RUNS)
    expected, _ = simulate(Walk(), TOY, draws, r, STEPS)
    v = draws.v.copy()
    v[1, 5] = value
    record, status = simulate(Walk(), TOY, draws._replace(v=v), r, STEPS)
    np.testing.assert_array_equal(status, [Status.OK, Status.DIVERGED, Status.OK, Status.OK, Status.OK])
    others_unchanged(record, expected, 1)
    np.testing.assert_array_equal(record.x[1, :6], expected.x[1, :6])
    np.testing.assert_array_equal(record.x[1, 5:, 0], np.full(STEPS - 4, expected.x[1, 5, 0]))


def test_a_bad_last_measurement_counts(rng, r):
    """Oracle: k = N is corrected, too, although nothing follows."""
    draws = toy_draws(rng, [0.9] * RUNS)
    draws.v[3, STEPS] = np.nan
    _, status = simulate(Walk(), TOY, draws, r, STEPS)
    np.testing.assert_array_equal(status, [Status.OK, Status.OK, Status.OK, Status.DIVERGED, Status.OK])


def test_a_parameter_out_of_range_marks_its_run(rng, r):
    """Oracle: the toy plant has no meaning for a < 0; the first failure is kept."""
    _, status = simulate(Walk(), TOY, toy_draws(rng, [0.9, -0.5, 0.9, -1e200, 0.9]), r, STEPS)
    np.testing.assert_array_equal(status[[1, 3]], [Status.OUT_OF_RANGE] * 2)
    np.testing.assert_array_equal(status[[0, 2, 4]], [Status.OK] * 3)


def experiment(plant, method, scenario, n_runs, n_steps):
    """All metrics of a method on a plant."""
    return Experiment(plant, (method,), scenario, ALL_METRICS, n_runs, n_steps)


def toy_experiment(parameter):
    """Eight runs of the toy plant whose parameter is a function of the named value p in 0..1."""
    noise = (gaussian(1, std=0.1),)
    parts = {"x0": np.ones(1), "x0_noise": (), "process": noise, "measurement": noise}
    law, names = {"p": Uniform(0.0, 1.0)}, {"a": lambda values: parameter(values["p"])}
    scenario = Scenario(seed=1, uncertainty=law, parameters=names, reference=constant(1, value=2.0), **parts)
    return experiment(Walk(), TOY, scenario, 8, 40)


def test_metrics_of_failed_runs_are_missing_and_nothing_warns():
    """Oracle: status per run from its own draw; pytest turns a warning of an overflowing metric into an error."""
    some = toy_experiment(lambda p: 1e30 if p > 0.5 else 0.9)
    wild = np.array([some.scenario.named_values(run)["p"] > 0.5 for run in range(8)])
    assert 0 < wild.sum() < 8
    block = simulate_block(some, TOY, range(8))
    np.testing.assert_array_equal(block.status == Status.DIVERGED, wild)
    np.testing.assert_array_equal(np.isnan(block.metrics), np.tile(wild, (len(ALL_METRICS), 1)))
    tame = simulate_block(toy_experiment(lambda p: 0.9), TOY, range(8))
    np.testing.assert_array_equal(block.metrics[:, ~wild], tame.metrics[:, ~wild])


@pytest.fixture(scope="module")
def servo_experiment():
    """Return 50 runs of the perturbed servomechanism with noise, robust filter and clipped MPC, 30 samples."""
    model, plant = servo_model(), servo.design(0.1)
    nominal = plant.nominal
    scenario = Scenario(
        seed=20180418,
        uncertainty={"eps_max": Uniform(-0.2, 0.2), "eps_jl": Uniform(-0.8, 0.8)},
        parameters={
            "J_l": lambda values: nominal["J_l"] * (1.0 + values["eps_jl"]),
            "K_t": lambda values: nominal["K_t"] * (1.0 + values["eps_max"]),
        },
        x0=np.zeros(5),
        x0_noise=(),
        process=(gaussian(4, std=0.01),),
        measurement=(gaussian(1, std=0.01),),
        reference=constant(1, value=np.pi / 2),
    )
    filter_ = robust_kalman.design(model, 30, x0=np.zeros(4), P0=model.Q_w, c=0.1)
    scale, limits = mpc.Scale(u=440.0, y=2 * np.pi), mpc.Limits(u=(-220.0, 220.0))
    law = mpc.design(model, Hp=10, Hu=3, Q=0.1, R=0.1, scale=scale, limits=limits)
    return experiment(plant, Method("R", filter_, law), scenario, 50, 30)


@pytest.mark.parametrize("size", [1, 7])
def test_the_block_size_does_not_change_a_byte(servo_experiment, size):
    """Oracle: one block of 50 runs, byte for byte."""
    method = servo_experiment.method("R")
    whole = simulate_block(servo_experiment, method, range(50))
    parts = [simulate_block(servo_experiment, method, range(50)[i : i + size]) for i in range(0, 50, size)]
    assert np.concatenate([part.metrics for part in parts], axis=1).tobytes() == whole.metrics.tobytes()
    np.testing.assert_array_equal(np.concatenate([part.status for part in parts]), whole.status)
    assert (whole.status == Status.OK).all() and np.isfinite(whole.metrics[:4]).all()


def test_a_block_is_the_record_reduced(servo_experiment):
    """Oracle: the mean square error and the power from the trajectories by NumPy."""
    method, scenario = servo_experiment.method("R"), servo_experiment.scenario
    draws = scenario.draw(servo_experiment.plant, range(10, 20), 30)
    record, _ = simulate(servo_experiment.plant, method, draws, np.full((41, 1), np.pi / 2), 30)
    block = simulate_block(servo_experiment, method, range(10, 20))
    mse = ((record.y[:, :30, 0] - np.pi / 2) ** 2).mean(axis=1)
    np.testing.assert_allclose(block.metrics[ALL_METRICS.index(Mse())], mse, **ROUND)
    power = (record.u[:, :, 0] ** 2).mean(axis=1)
    np.testing.assert_allclose(block.metrics[ALL_METRICS.index(InputPower())], power, **ROUND)


def test_an_experiment_without_metrics_gives_statuses():
    """Oracle: shape (0, runs)."""
    some = toy_experiment(lambda p: 0.9)
    bare = Experiment(some.plant, some.methods, some.scenario, (), 8, 40)
    assert simulate_block(bare, TOY, range(8)).metrics.shape == (0, 8)
