"""A plant, an estimator and a controller of one state each, simple enough to simulate by hand."""

from typing import NamedTuple

import numpy as np

from rmpc_bench.types import Command, Controller, Estimate, Estimator, Motion, Plant, Status


class Delta(NamedTuple):
    """The uncertain parameter of every run, and whether it makes sense."""

    a: np.ndarray
    status: np.ndarray


class Walk(Plant):
    """x(k+1) = a x(k) + u(k) + w(k), y = x + v; a must not be negative."""

    nx = nu = ny = nw = nv = 1
    Ts, y_unit, u_unit = 0.5, "m", "V"

    def __init__(self, a=0.9):
        self.nominal = {"a": a}

    def draw(self, parameters, rngs, n_steps):
        """Keep the parameter; the generators are for what has no name."""
        status = np.where(parameters["a"] >= 0.0, Status.OK, Status.OUT_OF_RANGE).astype(np.int8)
        return Delta(parameters["a"], status)

    def step(self, k, delta, x, u, w):
        """Move."""
        return Motion(delta.a[:, None] * x + u + w, delta.status)

    def output(self, k, delta, x, v):
        """Measure."""
        return x + v


class Seen(NamedTuple):
    """State of the filter: its prediction."""

    x_pred: np.ndarray


class Halfway(Estimator):
    """An estimator: x_hat is the mean of the prediction and the measurement; the prediction is 0.9 x_hat + u."""

    def init(self, n_runs):
        """Start at 1."""
        return Seen(np.ones((n_runs, 1)))

    def correct(self, k, state, y):
        """Meet halfway."""
        x_hat = 0.5 * (state.x_pred + y)
        return Seen(x_hat), Estimate(x_hat, None, None, np.zeros(len(y), dtype=np.int8), {})

    def predict(self, k, state, u):
        """Move by the nominal model."""
        return Seen(0.9 * state.x_pred + u)


class Proportional(Controller):
    """A controller: u = gain (r(k+1) - x_hat), plus 1 V at k = 0 only."""

    preview = 2

    def __init__(self, gain=0.4):
        self.gain = gain

    def init(self, n_runs):
        """Nothing to remember."""
        return None

    def control(self, k, state, y, estimate, r):
        """Act on the next reference."""
        u = self.gain * (r[1] - estimate.x_hat) + (1.0 if k == 0 else 0.0)
        return None, Command(u, np.zeros(len(u), dtype=np.int8), {})


def by_hand(a, x, w, v, r, n_steps, gain=0.4):
    """Trajectories (x, x_hat, u) of one run in plain Python floats."""
    x_pred, xs, x_hats, us = 1.0, [], [], []
    for k in range(n_steps + 1):
        x_hat = 0.5 * (x_pred + (x + v[k]))
        xs.append(x)
        x_hats.append(x_hat)
        if k < n_steps:
            u = gain * (r[k + 1] - x_hat) + (1.0 if k == 0 else 0.0)
            us.append(u)
            x, x_pred = a * x + u + w[k], 0.9 * x_hat + u
    return xs, x_hats, us
