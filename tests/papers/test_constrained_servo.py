"""Limits as constraints on the plants of sim. 2 and Fig. 7 of zenere2018: digits of constrained-mpc.md, section 9."""

from __future__ import annotations

import numpy as np
import pytest
from loaded_configs import loaded

from rmpc_bench.controllers.limits import Limits, SoftLimit
from rmpc_bench.controllers.mpc import Scale, design
from rmpc_bench.models.servo import ServoNoise
from rmpc_bench.models.servo import design as servo
from rmpc_bench.simulation.closed_loop import simulate

PI = np.pi


def record_of(name, method, runs, n_steps, enforce, linear=None):
    """Simulate a method of a configuration under limits, and a limit of the shaft torque with the given weight."""
    experiment = loaded(f"zenere2018/{name}").experiment
    soft = None if linear is None else {"shaft_torque": SoftLimit((-25 * PI, 25 * PI), linear)}
    limits, scale = Limits(u=(-220.0, 220.0), enforce=enforce), Scale(u=440.0, y=2.0 * PI)
    model = servo(0.1, noise=ServoNoise(1.0, 1.0))
    law = design(model, Hp=10, Hu=3, Q=0.1, R=0.1, scale=scale, limits=limits, soft=soft)
    draws = experiment.scenario.draw(experiment.plant, range(runs), n_steps)
    r = experiment.scenario.reference.sample(n_steps + 20)
    made = experiment.method(method)._replace(controller=law)
    record, status = simulate(experiment.plant, made, draws, r, n_steps, info={"qp"})
    assert not status.any()
    return record


def test_the_trajectory_of_sim_2_comes_out():
    """Oracle: P2, from another program; all printed digits."""
    record = record_of("sim2", "R-MPC", 1, 25, "qp")
    inputs = [95.51931, 157.35306, 196.34559, 216.58330, 220.0, 220.0]
    np.testing.assert_allclose(record.u[0, :6, 0], inputs, rtol=0, atol=5.1e-6)
    outputs = [0.02707007, 0.19699805, 0.57842396, 0.72141170, 1.39742343]
    np.testing.assert_allclose(record.y[0, [3, 5, 8, 10, 20], 0], outputs, rtol=0, atol=5.1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "enforce", "linear", "mse", "runaways"),
    [
        ("S-MPC", "clip", None, 0.12088, 0),
        ("S-MPC", "qp", None, 0.12264, 0),
        ("S-MPC", "qp", 0.001, 0.11826, 0),
        ("S-MPC", "qp", 0.03, 2.09, 30),
        ("R-MPC1", "qp", None, 0.10823, 0),
        ("R-MPC1", "qp", 0.001, 0.10280, 0),
        ("R-MPC1", "qp", 0.03, 1.33, 60),
    ],
)
def test_means_and_runaways_over_fig7(method, enforce, linear, mse, runaways):
    """Oracle: the table of section 9; no program fails, so that only the plant shows that a load turns past 2 r."""
    record = record_of("fig7", method, 200, 200, enforce, linear)
    y = record.y[:, :, 0]
    np.testing.assert_allclose(((y[:, :200] - PI / 2) ** 2).mean(), mse, rtol=0, atol=5.1e-6 if mse < 1 else 5.1e-3)
    assert (np.abs(y).max(axis=1) > PI).sum() == runaways
    if enforce == "qp":
        assert record.info["qp"].max() <= 2.0
    if enforce == "qp" and linear is None:
        np.testing.assert_allclose((record.info["qp"] == 0.0).mean(), 0.955, rtol=0, atol=5.1e-4)
