"""The system of ma2025, (72)-(77), and random ones with stochastic and bounded noises."""

import numpy as np
from conftest import random_psd

from rmpc_bench.models.mixed_noise import design

N = 100
X0, P0, M0 = np.array([60.0, -45.0]), 100.0 * np.eye(2), 400.0 * np.eye(2)
M_W, M_V = [[5.0, 2.0], [2.0, 5.0]], 5.0
A_0 = np.array([[0.6, 0.7], [0.25, 0.5]])
START = {"x0": X0, "P0": P0, "M0": M0, "use_y0": False}


def paper_model(**keys):
    """(72)-(75) with k in radians; keywords replace noises."""
    A = np.array([(1.0 + 0.1 * np.sin(k)) * A_0 for k in range(N + 1)])
    given = {"P_w": 0.25, "M_w": M_W, "P_v": 0.25, "M_v": M_V} | keys
    return design(N, A=A, B=[[1.0], [0.3]], C=[[0.2, 1.0]], **given)


def volume_and_trace(M):
    """Table I: mean determinant and trace of the corrected shapes over k = 1..100."""
    return np.linalg.det(M[1:]).mean(), np.trace(M[1:], axis1=1, axis2=2).mean()


def random_mixed(rng, nx, ny, n_steps=6, **keys):
    """Random system whose A and noises are others at every k; keywords replace noises."""
    over_time = {"A": rng.standard_normal((n_steps + 1, nx, nx)) / np.sqrt(nx)}
    for name, n in (("P_w", nx), ("M_w", nx), ("P_v", ny), ("M_v", ny)):
        over_time[name] = np.array([random_psd(rng, n) for _ in range(n_steps + 1)])
    B, C = rng.standard_normal((nx, 1)), rng.standard_normal((ny, nx))
    return design(n_steps, **{**over_time, "B": B, "C": C, **keys})


def in_ellipsoid(rng, M, runs, surface=False):
    """Points of E(0, M), (runs, n): uniform, or on its surface."""
    n = len(M)
    points = rng.standard_normal((runs, n))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    if not surface:
        points *= rng.random((runs, 1)) ** (1 / n)
    return points @ np.linalg.cholesky(M).T


def simulated(rng, model, runs, n_steps, x, *, stochastic=True, surface=False):
    """True states and measurements, (runs, samples, n), without input, from states x; noises as the model says."""
    xs, ys = [], []
    for k in range(n_steps + 1):
        now = model.at(k)
        xs.append(x)
        v = in_ellipsoid(rng, model.M_v(k), runs, surface)
        w = in_ellipsoid(rng, model.M_w(k), runs, surface)
        if stochastic:
            v = v + rng.multivariate_normal(np.zeros(now.ny), now.R_v, runs)
            w = w + rng.multivariate_normal(np.zeros(now.nx), now.Q_w, runs)
        ys.append(x @ now.C.T + now.d0 + v)
        x = x @ now.A.T + now.f0 + w
    return np.stack(xs, axis=1), np.stack(ys, axis=1)


def estimates(estimator, y, nu=1):
    """Estimates of a block without input, over time."""
    state, found = estimator.init(len(y)), []
    for k in range(y.shape[1]):
        state, estimate = estimator.correct(k, state, np.ascontiguousarray(y[:, k]))
        found.append(estimate)
        state = estimator.predict(k, state, np.zeros((len(y), nu)))
    return found
