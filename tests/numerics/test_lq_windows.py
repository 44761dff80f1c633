"""Linear-quadratic control over windows, against SciPy's Riccati equation and big matrices."""

import numpy as np
import pytest
from conftest import ROUND
from controllers import minimax_oracles as oracles
from scipy.linalg import solve_discrete_are

from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.lq_windows import Stages, game_gains, smallest_multipliers, window_law


def big_plan(stages, f, x):
    """All controls of min sum x(t+1)' Q x(t+1) + u' R u for x(t+1) = A x + B u + f, by one big linear system."""
    N, n = stages.A.shape[:2]
    big = oracles.matrices(stages)
    return -np.linalg.solve(big.B, big.b @ x + big.D[:, n:] @ f.reshape(N * n))


def test_every_window_equals_the_big_linear_system():
    """Oracle: (50)-(55) of ma2025 without an error, the known vector in the place of the noise."""
    rng = np.random.default_rng(5)
    N, stages = 6, oracles.random_stages(rng, 3, 2, 14)
    F = rng.standard_normal((14, 3, 2))
    law, x, d = window_law(stages, N, F), rng.standard_normal(3), rng.standard_normal(2)
    assert len(law.K) == 9
    for k in range(9):
        part = Stages(*(each[k : k + N] for each in stages))
        expected = big_plan(part, F[k : k + N] @ d, x)
        np.testing.assert_allclose(
            -law.K[k] @ x - law.K_d[k] @ d, expected[:2], rtol=1e-10
        )  # condition of the big system


def test_the_least_cost_is_a_quadratic_form():
    """Oracle: the cost of the big linear system's controls, added up by simulation."""
    rng = np.random.default_rng(6)
    stages = oracles.random_stages(rng, 3, 1, 5)
    x = rng.standard_normal(3)
    S = window_law(stages, 5, np.zeros((5, 3, 1))).S[0]
    U, now, cost = big_plan(stages, np.zeros((5, 3)), x).reshape(5, 1), x, 0.0
    for t in range(5):
        now = stages.A[t] @ now + stages.B[t] @ U[t]
        cost += now @ stages.Q[t] @ now + U[t] @ stages.R[t] @ U[t]
    np.testing.assert_allclose(x @ S @ x, cost, **ROUND)


@pytest.mark.parametrize("nu", [1, 2])
def test_a_long_horizon_is_stationary(nu):
    """Oracle: scipy.linalg.solve_discrete_are; x(k) itself is not weighed, so that S = P - Q."""
    rng = np.random.default_rng(7)
    one = oracles.random_stages(rng, 3, nu, 1)
    stages = Stages(*(np.broadcast_to(each, (400, *each.shape[1:])) for each in one))
    A, B, Q, R = (each[0] for each in one)
    P = solve_discrete_are(A, B, Q, R)
    law = window_law(stages, 400, np.zeros((400, 3, 1)))
    np.testing.assert_allclose(law.K[0], np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A), rtol=1e-9)  # of the solver
    np.testing.assert_allclose(law.S[0] + Q, P, rtol=1e-9)  # likewise


def test_the_smallest_price_of_a_game_is_an_h_infinity_norm():
    """Oracle: full-information H-infinity control: the bounded-real form of the closed loop of the stationary gain.

    Just above the smallest price of a long horizon, the gain that it leads to has a loop from noise to cost whose
    largest gain over frequencies is that price, and no more.
    """
    A, B, Q, R = np.array([[0.9, 0.3], [-0.2, 0.7]]), np.array([[0.0], [1.0]]), np.diag([2.0, 1.0]), 0.5 * np.eye(1)
    G = np.linalg.cholesky(np.array([[0.5, 0.1], [0.1, 0.2]]))
    stages = Stages(*(np.broadcast_to(each, (300, *each.shape)) for each in (A, B, Q, R)))
    wide = np.broadcast_to(G, (300, 2, 2))
    price = smallest_multipliers(stages, wide, 300)
    L = game_gains(stages, wide, 300, 1.000001 * price)[0]
    loop, size = A - B @ L, 0.0
    for angle in np.linspace(0.0, np.pi, 2000):
        x = np.linalg.solve(np.exp(1j * angle) * np.eye(2) - loop, G)  # from noise to x(t); u(t) = -L x(t)
        cost = x.conj().T @ (Q + L.T @ R @ L) @ x
        size = max(size, np.linalg.eigvalsh(cost)[-1])
    np.testing.assert_allclose(size, price[0], rtol=1e-4)  # a grid of frequencies


def test_every_window_has_its_own_price():
    """Oracle: the window by itself; at 0.999 times its price the game is refused."""
    rng = np.random.default_rng(11)
    stages, (_, M_w) = oracles.random_stages(rng, 2, 1, 9), oracles.random_sets(rng, 2, 9)
    G = psd_sqrt(M_w)
    prices = smallest_multipliers(stages, G, 5)
    for k in range(5):
        part = Stages(*(each[k : k + 5] for each in stages))
        np.testing.assert_allclose(
            smallest_multipliers(part, G[k : k + 5], 5)[0], prices[k], rtol=1e-11
        )  # of the halving
        with pytest.raises(ValueError, match="below"):
            game_gains(part, G[k : k + 5], 5, 0.999 * prices[k : k + 1])


def test_a_price_where_noise_is_seen_late():
    """Oracle: the maximum over w before the minimum over u, stage by stage; Q does not see what w enters at once."""
    A, B, Q, R = np.array([[0.9, 0.5], [0.0, 0.8]]), np.array([[1.0], [0.0]]), np.diag([1.0, 0.0]), np.eye(1)
    stages = Stages(*(np.broadcast_to(each, (5, *each.shape)) for each in (A, B, Q, R)))
    G = np.broadcast_to(np.diag([0.0, 1.0]), (5, 2, 2))
    price = smallest_multipliers(stages, G, 5)[0]
    low, high = 1e-6, 100.0  # the same by hand: the price at which the noise of no stage is free
    for _ in range(60):
        middle, X = 0.5 * (low + high), Q
        for t in range(5):
            if middle <= X[1, 1]:
                break
            P = X + np.outer(X[:, 1], X[1]) / (middle - X[1, 1])
            K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
            X = A.T @ P @ (A - B @ K) + (Q if t < 4 else 0.0)
        else:
            high = middle
            continue
        low = middle
    np.testing.assert_allclose(price, high, rtol=1e-9)  # halving, two ways to write the same inequality
    np.testing.assert_allclose(price, 0.978439, atol=1e-6)  # the digits of an independent computation
