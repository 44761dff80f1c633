"""The system of the outlier tests: a target of constant velocity whose position is measured, and laws of its noise."""

import numpy as np

from rmpc_bench.models.linear import LinearModel

STEPS, SCALE = 200, 10.0
X0, P0 = np.zeros(2), np.diag([100.0, 10.0])


def cv():
    """Constant velocity: position measured with a standard deviation of 10."""
    Q_w = [[1.0 / 3.0, 0.5], [0.5, 1.0]]
    return LinearModel([[1.0, 1.0], [0.0, 1.0]], [[0.0], [0.0]], [[1.0, 0.0]], Q_w, SCALE**2)


def gaussian(rng, shape):
    return SCALE * rng.standard_normal(shape)


def outliers(share):
    """A share of the samples is off by 10 standard deviations, up or down."""

    def law(rng, shape):
        sign = np.where(rng.random(shape) < 0.5, -1.0, 1.0)
        return gaussian(rng, shape) + np.where(rng.random(shape) < share, 10.0 * SCALE * sign, 0.0)

    return law


def student_t(rng, shape):
    """Student's t with 3 degrees of freedom and scale 10."""
    return SCALE * rng.standard_t(3.0, shape)


def two_modes():
    """The two states of sayed2001 without uncertainty; their sum is hardly measured."""
    Q_w = [[1.9608, 0.0195], [0.0195, 1.9605]]
    return LinearModel([[0.9802, 0.0196], [0.0, 0.9802]], [[0.0], [0.0]], [[1.0, -1.0]], Q_w, 1.0)


def large_outliers(rng, shape):
    """Standard normal, and 5 % of the samples off by 100."""
    sign = np.where(rng.random(shape) < 0.5, -1.0, 1.0)
    return rng.standard_normal(shape) + np.where(rng.random(shape) < 0.05, 100.0 * sign, 0.0)


def simulated(seed, n_runs, law, steps=STEPS, model=None):
    """States and measurements (runs, samples, ..) of a system, constant velocity unless given, with noise of a law."""
    rng, model = np.random.default_rng(seed), cv() if model is None else model
    root = np.linalg.cholesky(model.Q_w)
    x = X0 + rng.standard_normal((n_runs, 2)) * np.sqrt(np.diag(P0))
    v, w = law(rng, (n_runs, steps, 1)), rng.standard_normal((n_runs, steps, 2)) @ root.T
    states = []
    for k in range(steps):
        states.append(x)
        x = x @ model.A.T + w[:, k]
    states = np.stack(states, axis=1)
    return states, states @ model.C.T + v


def estimates(design, y):
    """Estimates (runs, samples, nx) of a filter."""
    state, found, u = design.init(len(y)), [], np.zeros((len(y), 1))
    for k in range(y.shape[1]):
        state, estimate = design.correct(k, state, y[:, k])
        found.append(estimate.x_hat)
        state = design.predict(k, state, u)
    return np.stack(found, axis=1)


def run_mse(design, x, y):
    """Mean square error of every run: of both states, averaged over them and over time."""
    return ((estimates(design, y) - x) ** 2).mean(axis=(1, 2))
