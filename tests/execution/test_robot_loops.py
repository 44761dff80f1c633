"""Closed loops of the parallel robot in bad situations: what is lost, and that nothing else is."""

import numpy as np
import pytest

from rmpc_bench import load_config
from rmpc_bench.numerics import bounded_window
from rmpc_bench.simulation.closed_loop import simulate
from rmpc_bench.types import Status

CONFIG = "configs/benchmarks/moving-slide.yaml"
INFO = ("Q_yw", "fallback", "r_breve")


def loop(name, *overrides, runs=2, steps=200, spoiled=None):
    """Record, statuses and draws of some runs; ``spoiled(v)`` changes the measurement noise."""
    experiment = load_config(CONFIG, overrides=overrides).experiment
    method, draws = experiment.method(name), experiment.scenario.draw(experiment.plant, range(runs), steps)
    if spoiled:
        draws = draws._replace(v=spoiled(draws.v.copy()))
    r = experiment.scenario.reference.sample(steps + 1 + method.controller.preview)
    return *simulate(experiment.plant, method, draws, r, steps, info=INFO), draws


def rms(record):
    """Root mean square of the error of x and y, run by run [m]."""
    return np.sqrt(((record.y - record.r)[:, :, :2] ** 2).mean(axis=(1, 2)))


@pytest.mark.parametrize("name", ["constant", "tuned"])
@pytest.mark.long
def test_missing_measurements_cost_a_few_estimates(name):
    """Oracle: by hand; each costs itself and the three windows behind, five in a row cost eight; other runs no bit.

    A fallback is as far off as the noise at most, and few are: errors change by less than half of its half-width 5e-4.
    """

    def spoiled(v):
        v[1, 60, 0], v[1, 120:125] = np.nan, np.nan
        return v

    clean, _, _ = loop(name)
    record, status, _ = loop(name, spoiled=spoiled)
    assert not status.any()
    np.testing.assert_array_equal(np.flatnonzero(record.info["fallback"][1]), [60, 61, 62, 63, *range(120, 128)])
    assert not record.info["fallback"][0].any()
    np.testing.assert_array_equal(record.x[0], clean.x[0])
    assert abs(rms(record)[1] - rms(clean)[1]) < 2.5e-4


def test_penalties_are_kept_while_measurements_are_missing():
    """Oracle: by hand; the window of 15 samples holds the missing one for 15."""

    def spoiled(v):
        v[0, 60] = np.nan
        return v

    Q = loop("tuned", spoiled=spoiled)[0].info["Q_yw"][0]
    np.testing.assert_array_equal(Q[60:75], np.tile(Q[59], (15, 1)))
    assert (Q[75] != Q[74]).any()


def test_without_noise_penalties_are_at_their_bound():
    """Oracle: the floor of the bounds makes them 3e-7 / 1e-12; the error is what is left of the lag with 4 I."""
    record, status, _ = loop("tuned", "noise=none")
    assert not status.any() and not record.info["fallback"].any()
    np.testing.assert_array_equal(record.info["Q_yw"][:, 17:, [0, 4, 8]], 4.0)
    assert (rms(record) < 1e-4).all()
    np.testing.assert_allclose(record.x_hat[:, 20:], record.x[:, 20:], atol=1e-4)  # the model is frozen for a sample


@pytest.mark.parametrize("name", ["constant", "tuned"])
def test_forty_times_the_noise_loses_no_run(name):
    """Oracle: runs reach their end, errors are of the size of the noise; tuned penalties are at the lower bound."""
    record, status, draws = loop(name, "noise.measurement.uniform.radius=2e-2")
    assert not status.any() and (rms(record) < 2e-2).all()
    if name == "tuned":
        np.testing.assert_array_equal(record.info["Q_yw"][:, 30:, [0, 4, 8]], 0.5)


def test_near_a_singular_pose_inputs_stay_small():
    """Oracle: at 74.5 degrees no torque turns the platform; with sigma_3 of 0.1 the law does not divide by it."""
    start = "[0, 0, 68*pi/180, 0, 0, 0]"
    keys = [f"initial.x={start}", f"initial.x_hat={start}", "reference={kind: constant, value: [0, 0, 68*pi/180]}"]
    record, status, _ = loop("constant", *keys)
    assert not status.any() and np.abs(record.u).max() < 10.0


def test_a_singular_pose_stops_a_run_and_no_other():
    """Oracle: a run that starts there has the status at once and stands still; the other one keeps its bits."""
    experiment = load_config(CONFIG).experiment
    method, draws = experiment.method("tuned"), experiment.scenario.draw(experiment.plant, range(2), 100)
    r = experiment.scenario.reference.sample(101 + method.controller.preview)
    clean, _ = simulate(experiment.plant, method, draws, r, 100)
    x0 = draws.x0.copy()
    x0[1] = [0.0, 0.0, np.arccos(0.08 / 0.30), 0.0, 0.0, 0.0]
    record, status = simulate(experiment.plant, method, draws._replace(x0=x0), r, 100)
    np.testing.assert_array_equal(status, [Status.OK, Status.SINGULAR])
    np.testing.assert_array_equal(record.x[0], clean.x[0])
    np.testing.assert_array_equal(record.x[1], np.tile(x0[1], (101, 1)))


@pytest.mark.parametrize("name", ["constant", "tuned"])
def test_a_solver_that_always_fails_ends_all_runs(name, monkeypatch):
    """Oracle: by hand; an anchored window is full at k = 3, the 51st estimate in a row without a fit is that of 53."""
    monkeypatch.setattr(bounded_window, "least_noise_fit", lambda *_: None)
    record, status, _ = loop(name, "estimator.start=anchored", steps=60)
    np.testing.assert_array_equal(status, np.full(2, Status.DIVERGED))
    np.testing.assert_array_equal(record.info["fallback"][:, :, 0], np.tile(np.arange(61) >= 3, (2, 1)))
    moved = (np.diff(record.x, axis=1) != 0.0).any(axis=2)
    np.testing.assert_array_equal(moved, np.tile(np.arange(60) < 53, (2, 1)))
    assert all(np.isfinite(signal).all() for signal in (record.x, record.x_hat, record.u))
