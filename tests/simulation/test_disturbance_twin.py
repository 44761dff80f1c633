"""Closed loops with disturbances in the design model against a second program: NumPy, written from the equations.

The second program has the covariance form of the Kalman filter for [x; d], and predictive control by least squares over
simulated predictions.  Only the true plant is that of the package.
"""

import numpy as np
import pytest

from rmpc_bench import load_config
from rmpc_bench.simulation.closed_loop import simulate, simulate_block

CONFIG = """
version: 1
name: twin
seed: 5
runs: 2
time: {step: 0.5, duration: 15}
plant: {kind: linear, A: [[0.9, 0.2, 0], [-0.1, 0.8, 0.3], [0, 0.1, 0.7]], B: [[0.3, 0], [0, 0.5], [1, 0.2]],
        C: [[1, 0, 0], [0, 1, 0.5]]}
model: {kind: linear, A: [[0.92, 0.2, 0], [-0.1, 0.75, 0.3], [0, 0.15, 0.7]], B: [[0.3, 0], [0, 0.5], [0.8, 0.2]],
        C: [[1, 0, 0], [0, 1, 0.5]], P_w: 0.02, P_v: 0.05, w_mean: [0.1, -0.2, 0.05]}
noise: {process: {gaussian: {mean: 0.3, std: 0.1}}}
initial: {x: [1, -1, 0.5], x_hat: [0.2, 0, 0], P: [[0.5, 0.1, 0], [0.1, 0.4, 0], [0, 0, 0.3]]}
reference: {kind: constant, value: [1, 0.5]}
estimator: {kind: kalman}
controller: {kind: mpc, Hp: 6, Hu: 2, Q: 1, R: 0.1}
methods:
  input: {model: {disturbance: {at: input, drift: [0.3, 0.1]}}}
  output: {model: {disturbance: {at: output, drift: 0.2, D0: [3, 2]}}}
  gains: {model: {disturbance: {at: {B_d: [[1], [0], [2]], C_d: [[0.5], [0]]}, drift: 0.4}}}
  list: {model: {disturbance: {at: [{B_d: [[1], [0], [2]]}, {C_d: [[0], [1]]}], drift: [0.4, 0.2]}}}
metrics: [estimation_mse, nees]
"""
A = np.array([[0.92, 0.2, 0.0], [-0.1, 0.75, 0.3], [0.0, 0.15, 0.7]])
B, C = np.array([[0.3, 0.0], [0.0, 0.5], [0.8, 0.2]]), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.5]])
MEAN, P_0 = np.array([0.1, -0.2, 0.05]), np.array([[0.5, 0.1, 0.0], [0.1, 0.4, 0.0], [0.0, 0.0, 0.3]])
COLUMN = np.array([[1.0], [0.0], [2.0]])
PLACES = {
    "input": (B, np.zeros((2, 2)), [0.3, 0.1], [0.3, 0.1]),
    "output": (np.zeros((3, 2)), np.eye(2), [0.2, 0.2], [3.0, 2.0]),
    "gains": (COLUMN, np.array([[0.5], [0.0]]), [0.4], [0.4]),
    "list": (np.hstack([COLUMN, 0.0 * COLUMN]), np.array([[0.0, 0.0], [0.0, 1.0]]), [0.4, 0.2], [0.4, 0.2]),
}
"""Method -> B_d, C_d, drift and variance at k = 0."""
N, HP, HU, R = 30, 6, 2, np.array([1.0, 0.5])


def blocks(M, D):
    """[M 0; 0 D]."""
    return np.block([[M, np.zeros((len(M), len(D)))], [np.zeros((len(D), len(M))), D]])


def first_move(A, B, f, C, z, u):
    """First increment of the input, by least squares over the errors of simulated predictions."""

    def errors(moves):
        state, applied, found = z, u, []
        for j in range(HP):
            applied = applied + moves[2 * j : 2 * j + 2] if j < HU else applied
            state = A @ state + B @ applied + f
            found.append(C @ state - R)
        return np.concatenate([*found, np.sqrt(0.1) * moves])

    rest = errors(np.zeros(2 * HU))
    slopes = np.stack([errors(unit) - rest for unit in np.eye(2 * HU)], axis=1)
    return np.linalg.lstsq(slopes, -rest, rcond=None)[0][:2]


def followed(method, y):
    """Estimates of [x; d], covariances and inputs for the measurements of one run."""
    B_d, C_d, drift, D_0 = PLACES[method]
    nd = len(drift)
    Aa, Ba = np.block([[A, B_d], [np.zeros((nd, 3)), np.eye(nd)]]), np.vstack([B, np.zeros((nd, 2))])
    Ca, f, Q = np.hstack([C, C_d]), np.append(MEAN, np.zeros(nd)), blocks(0.02 * np.eye(3), np.diag(drift))
    z, P, u, found = np.append([0.2, 0.0, 0.0], np.zeros(nd)), blocks(P_0, np.diag(D_0)), np.zeros(2), []
    for measured in y:
        gain = P @ Ca.T @ np.linalg.inv(Ca @ P @ Ca.T + 0.05 * np.eye(2))
        z, P = z + gain @ (measured - Ca @ z), (np.eye(3 + nd) - gain @ Ca) @ P
        u = u + first_move(Aa, Ba, f, Ca, z, u)
        found.append((z, P, u))
        z, P = Aa @ z + Ba @ u + f, Aa @ P @ Aa.T + Q
    return [np.array(each) for each in zip(*found, strict=True)]


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    """The experiment."""
    path = tmp_path_factory.mktemp("twin") / "twin.yaml"
    path.write_text(CONFIG)
    return load_config(path).experiment


@pytest.mark.parametrize("method", PLACES)
def test_the_second_program_has_the_same_loop(experiment, method):
    """Oracle: estimates, inputs and metrics of the second program; the metrics compare x only."""
    draws = experiment.scenario.draw(experiment.plant, range(2), N)
    r = experiment.scenario.reference.sample(N + 1 + HP)
    pair = experiment.method(method)
    record, _ = simulate(experiment.plant, pair, draws, r, N, info={"d_hat"})
    errors, nees = simulate_block(experiment, pair, range(2)).metrics
    for run in range(2):
        z, P, u = followed(method, record.y[run])
        np.testing.assert_allclose(record.x_hat[run], z[:, :3], rtol=0, atol=1e-11)
        np.testing.assert_allclose(record.info["d_hat"][run], z[:, 3:], rtol=0, atol=1e-11)
        np.testing.assert_allclose(record.u[run], u[:N], rtol=0, atol=1e-11)
        e = (z[:, :3] - record.x[run])[:N]
        assert errors[run] == pytest.approx(np.mean(e * e), rel=1e-9)
        weighed = np.einsum("ki,kij,kj->k", e, np.linalg.inv(P[:N, :3, :3]), e)
        assert nees[run] == pytest.approx(weighed.mean() / 3, rel=1e-9)
