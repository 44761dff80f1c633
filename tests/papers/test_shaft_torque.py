"""The torque of the shaft under a clipped input: digits of an independent study, and peaks between the samples."""

import numpy as np
import pytest

from rmpc_bench import load_config
from rmpc_bench.metrics.limits import Largest
from rmpc_bench.simulation.closed_loop import simulate, simulate_block

LIMIT = "25*pi"
NOMINAL = [
    "plant={kind: servo-linear}", "noise=none", "runs=1", "sweep=null", "claims=[]", "figures=[]",
    "record={runs: none}",
    "metrics=[mse, {kind: largest, of: shaft_torque}, {kind: largest, name: motor, of: motor_torque}]",
]  # fmt: skip
SHARES = [
    f"metrics=[mse, {{kind: violation, of: shaft_torque, limit: {LIMIT}}}, {{kind: largest, of: shaft_torque}},"
    f" {{kind: runaway}}, {{kind: violation, name: motor, of: motor_torque, limit: {LIMIT}}}]",
    "claims=[]", "figures=[]",
]  # fmt: skip
METHODS = {
    "S-MPC": (0.12088, 0.0292),
    "R-MPC1": (0.10645, 0.0291),
    "RS": (0.11454, 0.0292),
}
"""Method -> mean MSE and mean share of samples above 78.54 N m, of the specification."""


def test_largest_torque_of_the_nominal_loop():
    """Oracle: trajectory N1 of the specification, 142.169230 N m on the load side."""
    experiment = load_config("configs/zenere2018/sim1.yaml", overrides=NOMINAL).experiment
    _, torque, motor = simulate_block(experiment, experiment.method("S-MPC"), range(1)).metrics
    assert torque.item() == pytest.approx(142.169230, abs=5e-7)
    # A limit of 78.54 N m on the side of the motor is never met.
    assert motor.item() == pytest.approx(142.169230 / 20.0, abs=5e-8) and motor.item() < 7.2


@pytest.mark.parametrize("method", METHODS)
def test_share_of_samples_above_the_limit(method):
    """Oracle: the column `clip` of the specification's table on the plants of Fig. 7."""
    added = ["RS: {estimator: {kind: risk-sensitive, theta_from: {c: 1e-1}}}"]
    experiment = load_config("configs/zenere2018/fig7.yaml", overrides=SHARES, add_methods=added).experiment
    mse, share, largest, runaway, motor = simulate_block(experiment, experiment.method(method), range(200)).metrics
    assert mse.mean() == pytest.approx(METHODS[method][0], abs=6e-6)
    assert share.mean() == pytest.approx(METHODS[method][1], abs=5.1e-5)
    assert largest.max() == pytest.approx(271.0, abs=0.5)
    assert not runaway.any() and not motor.any()


def test_torque_peaks_between_the_samples():
    """Trap: between two samples the torque is larger than at them, in some plants by several percent."""
    experiment = load_config("configs/zenere2018/fig7.yaml", overrides=SHARES, runs=20).experiment
    draws = experiment.scenario.draw(experiment.plant, range(20), 40)
    r = experiment.scenario.reference.sample(60)
    record, status = simulate(experiment.plant, experiment.method("S-MPC"), draws, r, 40)
    assert not status.any()
    record = record._replace(experiment=experiment.metric_layout._replace(n_steps=40))
    naive, peak, finer = (Largest(of="shaft_torque", between=n).evaluate(record) for n in (0, 19, 39))
    excess = peak / naive - 1.0
    assert (excess >= 0.0).all() and np.median(excess) > 0.005
    assert 0.02 < excess.max() < 0.1
    np.testing.assert_allclose(finer, peak, rtol=1e-3)
