"""Long windows of moving-horizon on unstable plants in closed loop."""

import cvxpy as cp
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from rmpc_bench.estimators import kalman, moving_horizon
from rmpc_bench.models.linear import LinearModel

PLANT = np.array([[1.5, 0.1], [0.0, 0.9]]), np.array([[1.0], [0.1]]), np.array([[1.0, 0.0]])


def closed_loop(A, B, C, window, n, bounds, noise=0.01, seed=0):
    """Estimates and states of moving-horizon and of kalman, whose estimate is fed back, and the data."""
    (nx, nu), ny, rng = B.shape, len(C), np.random.default_rng(seed)
    model = LinearModel(A, B, C, noise * np.eye(nx), noise * np.eye(ny))
    P = solve_discrete_are(A, B, np.eye(nx), np.eye(nu))
    K = np.linalg.solve(np.eye(nu) + B.T @ P @ B, B.T @ P @ A)
    start = {"x0": np.zeros(nx), "P0": np.eye(nx)}
    designs = moving_horizon.design(model, n, **start, window=window, **bounds), kalman.design(model, n, **start)
    states, x, found = [each.init(2) for each in designs], rng.standard_normal((2, nx)), []
    for k in range(n):
        y = x @ C.T + np.sqrt(noise) * rng.standard_normal((2, ny))
        both = [each.correct(k, state, y) for each, state in zip(designs, states, strict=True)]
        u = -both[1][1].x_hat @ K.T
        found.append((y, u, both[0][0], both[0][1], both[1][1]))
        states = [each.predict(k, state, u) for each, (state, _) in zip(designs, both, strict=True)]
        x = x @ A.T + u @ B.T + np.sqrt(noise) * rng.standard_normal((2, nx))
    return model, found


def distance(found):
    """Largest difference of the estimates, relative to the largest estimate."""
    ours, theirs = (np.array([each[i].x_hat for each in found]) for i in (3, 4))
    return np.abs(ours - theirs).max() / np.abs(theirs).max()


@pytest.mark.parametrize("window", [5, 40, 60, pytest.param(200, marks=pytest.mark.slow)])
def test_without_active_bounds_every_window_is_kalman(window):
    """Oracle: kalman; condensed powers of A gave 2e-5 at window 40 and 1e11 at 80."""
    _, found = closed_loop(*PLANT, window, window + 20, {"w": (-1e3, 1e3)})
    assert distance(found) < 1e-12


@pytest.mark.parametrize("count", [6, pytest.param(60, marks=pytest.mark.slow)])
def test_random_plants(count, rng):
    """Oracle: kalman; spectral radius 0.9 to 2, bounds of w, of v, and of x."""
    for number in range(count):
        nx, ny = int(rng.integers(1, 5)), int(rng.integers(1, 3))
        A = rng.standard_normal((nx, nx))
        A *= rng.uniform(0.9, 2.0) / np.abs(np.linalg.eigvals(A)).max()
        bounds = ({"w": (-1e3, 1e3)}, {"v": (-1e3, 1e3)}, {"x": (-1e6, 1e6)})[number % 3]
        _, found = closed_loop(A, np.eye(nx), rng.standard_normal((ny, nx)), 20 if number % 2 else 40, 50, bounds)
        assert distance(found) < 1e-9


def test_active_bounds_over_a_long_window():
    """Oracle: cvxpy with the states and the noises of the window as unknowns, the model as a constraint."""
    model, found = closed_loop(*PLANT, 25, 40, {"w": (-0.08, 0.08)}, seed=3)
    compared = 0
    for k in (30, 35, 39):
        state, estimate = found[k][2:4]
        for run in np.flatnonzero(estimate.info["solved"]):
            x, w = cp.Variable((26, 2)), cp.Variable((25, 2))
            root = state.roots[run, 0]
            cost = cp.sum_squares(np.linalg.inv(root) @ (x[0] - state.x_pred[run, 0])) + cp.sum_squares(w) / 0.01
            cost += cp.sum_squares(state.y[run] - x @ model.C.T) / 0.01
            rules = [x[1:] == x[:-1] @ model.A.T + state.c[run] + w, cp.abs(w) <= 0.08]
            tight = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12}
            cp.Problem(cp.Minimize(cost), rules).solve(solver=cp.CLARABEL, **tight)
            np.testing.assert_allclose(estimate.x_hat[run], x.value[-1], rtol=0, atol=1e-6)
            compared += 1
    assert compared >= 3
