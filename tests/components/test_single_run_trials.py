"""Experiments with components of one run from a file: the same bytes for any number of workers and any block."""

import csv

import numpy as np
import pytest
from conftest import ROUND
from small_experiment import ran, write

OWN = '''
import numpy as np
from rmpc_bench import single_run

A, B = np.array([[1, 0.1], [0, 0.9]]), np.array([0, 0.1])


@single_run
class Particles:
    """A particle filter with its own random numbers."""

    def __init__(self, model, rng, n: int = 30):
        self.m, self.rng, self.n = model.at(0), rng, n

    def start(self, x0, P0):
        self.x = x0 + self.rng.standard_normal((self.n, 2)) @ np.linalg.cholesky(P0).T

    def update(self, y, u_previous):
        if u_previous is not None:
            self.x = self.x @ self.m.A.T + self.m.B @ u_previous + 0.3 * self.rng.standard_normal((self.n, 2))
        weight = np.exp(-0.5 * (y[0] - self.x[:, 0]) ** 2 / self.m.R_v[0, 0]) + 1e-12
        x_hat = weight @ self.x / weight.sum()
        self.x = self.x[self.rng.choice(self.n, self.n, p=weight / weight.sum())]
        return x_hat


@single_run
class Textbook:
    """A Kalman filter."""

    def __init__(self, model):
        self.m = model.at(0)

    def start(self, x0, P0):
        self.x, self.P = x0, P0

    def update(self, y, u_previous):
        m = self.m
        if u_previous is not None:
            self.x, self.P = m.A @ self.x + m.B @ u_previous, m.A @ self.P @ m.A.T + m.Q_w
        L = self.P @ m.C.T @ np.linalg.inv(m.C @ self.P @ m.C.T + m.R_v)
        self.x = self.x + L @ (y - m.C @ self.x)
        self.P = (np.eye(2) - L @ m.C) @ self.P @ (np.eye(2) - L @ m.C).T + L @ m.R_v @ L.T
        return self.x, self.P


@single_run
class Simulator:
    """A plant with a memory and its own random numbers."""

    nx, nu, ny = 2, 1, 1
    nominal = {"gain": 1.0}

    def start(self, p, x0, rng):
        self.x, self.gain, self.rng, self.total = x0, p.gain, rng, 0.0

    def step(self, u, w):
        self.total += u[0]
        self.x[:] = A @ self.x + self.gain * B * u + w + 0.01 * self.rng.standard_normal(2) + 0.001 * self.total
        return self.x

    def output(self, x):
        return x[:1]


@single_run
def law(x_hat, r, K: float = 1.0):
    """Proportional control of the first state, with damping."""
    return K * (r - x_hat[:1]) - 0.5 * x_hat[1:]


@single_run
def top(y):
    """Largest output."""
    return y.max()
'''
KEYS = {
    "runs": "7",
    "plant": "{file: own.py:Simulator, perturb: {gain: 1 + eps}}",
    "model": "{kind: linear, A: [[1, 0.1], [0, 0.9]], B: [[0], [0.1]], C: [[1, 0]], P_w: 0.1, P_v: 0.1}",
    "noise": "{process: {gaussian: {std: 0.05}}, measurement: {gaussian: {std: 0.1}}}",
    "initial": "{x: [0.5, 0], x_hat: 0, P: 1}",
    "controller": "{file: own.py:law, K: 2}",
    "methods": "{Particles: {estimator: {file: own.py:Particles, n: 20}}, Kalman: {estimator: {kind: kalman}}, "
    "Textbook: {estimator: {file: own.py:Textbook}}, Same: {estimator: {file: own.py:Particles, n: 20}, "
    "controller: {K: 2.0}}}",
    "metrics": "[mse, estimation_mse, {file: own.py:top}]",
}


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """Run the experiment in one worker with whole blocks and in two with blocks of three."""
    directory = tmp_path_factory.mktemp("own")
    (directory / "own.py").write_text(OWN, encoding="utf-8")
    path = write(directory, **KEYS)
    whole = ran(path, directory / "whole", "-s", "execution.block=7")
    parts = ran(path, directory / "parts", "-s", "execution.block=3", jobs=2)
    return whole, parts


def test_trials_have_the_same_bytes(tables):
    """Oracle: each other; own random numbers and a plant with a memory are in them."""
    assert tables[0] == tables[1]


def test_equal_methods_have_equal_trials_and_the_textbook_filter_is_kalman(tables):
    """Oracle: rows of one method against the other; `kalman` to 1e-12."""
    rows = list(csv.DictReader(tables[0].decode().splitlines()))
    values = {
        name: np.array(
            [[float(row[key]) for key in ("mse", "estimation_mse", "top")] for row in rows if row["method"] == name]
        )
        for name in ("Particles", "Kalman", "Textbook", "Same")
    }
    assert {row["status"] for row in rows} == {"ok"} and values["Kalman"].shape == (7, 3)
    np.testing.assert_array_equal(values["Same"], values["Particles"])
    np.testing.assert_allclose(values["Textbook"], values["Kalman"], **ROUND)
