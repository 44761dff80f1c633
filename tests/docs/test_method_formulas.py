"""The formulas of docs/methods, written as they stand there, against the functions that the pages name."""

import numpy as np
import pytest
from conftest import ROUND, SOLVER, random_psd
from controllers import minimax_oracles
from numpy.linalg import eigvalsh, inv, matrix_power
from scipy.linalg import block_diag, sqrtm

from rmpc_bench.controllers.mpc import design as mpc
from rmpc_bench.controllers.noise_tuning import Triangle, covariance, precision
from rmpc_bench.controllers.state_feedback import game_of
from rmpc_bench.estimators.kalman_predictor import design as predictor
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.divergence import inflate, inflate_to_radius
from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.lq_game import plan, solve
from rmpc_bench.numerics.mixed_step import Prior, mixed_step
from rmpc_bench.numerics.norm_bound import Excess, NoiseChannel, NoisePair
from rmpc_bench.numerics.riccati import filter_step
from rmpc_bench.numerics.robust_step import ParameterRules, RobustStep


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_zenere2018_gains(rng):
    """(13)-(16), with the covariance form of (15)."""
    A, C = rng.standard_normal((3, 3)), rng.standard_normal((1, 3))
    P, Q_w, R_v, c = random_psd(rng, 3), random_psd(rng, 3), np.array([[0.7]]), 0.3
    found = inflate_to_radius(psd_sqrt(P), c)
    V, theta = found.V, found.theta
    np.testing.assert_allclose(V, inv(inv(P) - theta * np.eye(3)), rtol=1e-10)  # a product of two inverses
    left = np.log(np.linalg.det(np.eye(3) - theta * P)) + np.trace(inv(np.eye(3) - theta * P) - np.eye(3))
    np.testing.assert_allclose(left, c, rtol=1e-10)
    s = 1.0 / (1.0 - theta * eigvalsh(P))
    np.testing.assert_allclose((s - 1.0 - np.log(s)).sum(), c, **ROUND)
    found = filter_step(A, C, Q_w, R_v, psd_sqrt(V))
    L = V @ C.T @ inv(C @ V @ C.T + R_v)
    K = A @ L
    np.testing.assert_allclose(found.L, L, **ROUND)
    np.testing.assert_allclose(found.P_next, A @ V @ A.T - K @ (C @ V @ C.T + R_v) @ K.T + Q_w, rtol=1e-10)


@pytest.mark.parametrize("tau", [0.3, 0.8])
def test_zenere2018_divergences_between_the_two(rng, tau):
    P, theta = random_psd(rng, 3), 0.1
    lam = eigvalsh(P)
    s = (1.0 - (1.0 - tau) * theta * lam) ** (-1.0 / (1.0 - tau))
    np.testing.assert_allclose(eigvalsh(inflate(psd_sqrt(P), theta, tau).V), s * lam, rtol=1e-11)


def test_zenere2018_control_law(rng):
    """The minimiser as on the page, for a system without scales."""
    A, B, C = 0.6 * rng.standard_normal((2, 2)), rng.standard_normal((2, 1)), np.array([[1.0, 0.5]])
    Hp, Hu, Q, R = 6, 2, 1.5, 0.3
    step = [C @ sum(matrix_power(A, i) for i in range(j)) @ B for j in range(1, Hp + 1)]
    Psi = np.vstack([C @ matrix_power(A, j) for j in range(1, Hp + 1)])
    Upsilon = np.vstack(step)
    Theta = np.column_stack([[0.0] * m + [step[j].item() for j in range(Hp - m)] for m in range(Hu)])
    first = (inv(Theta.T @ (Q * Theta) + R * np.eye(Hu)) @ Theta.T * Q)[:1]
    law = mpc(LinearModel(A, B, C, np.eye(2), np.eye(1)), Hp=Hp, Hu=Hu, Q=Q, R=R)
    np.testing.assert_allclose(law.K_r, first, rtol=1e-9)
    np.testing.assert_allclose(law.K_x, first @ Psi, rtol=1e-9)
    np.testing.assert_allclose(law.K_u, first @ Upsilon, rtol=1e-9)


def test_souto2011_one_step(rng):
    """Steps 1 to 5, and the sum of positive semidefinite terms."""
    nx, ny = 3, 2
    A, C, H_A, H_C, G_x = (rng.standard_normal(s) for s in ((nx, nx), (ny, nx), (nx, 2), (ny, 2), (1, nx)))
    H_A, H_C, G_x = H_A[:, :1], H_C[:, :1], 0.3 * G_x
    B_w, D_w, H_Bw, H_Dw, G_w = (rng.standard_normal(s) for s in ((nx, 2), (ny, 2), (nx, 1), (ny, 1), (1, 2)))
    B_v, D_v, H_Bv, H_Dv, G_v = (rng.standard_normal(s) for s in ((nx, 2), (ny, 2), (nx, 1), (ny, 1), (1, 2)))
    P, W, V, eps = random_psd(rng, nx), random_psd(rng, 2), random_psd(rng, 2), 0.1

    def widened(S, G, a):
        return S + S @ G.T @ inv(a * np.eye(len(G)) - G @ S @ G.T) @ G @ S

    a_x, a_w, a_v = (np.linalg.svd(G @ S @ G.T, compute_uv=False)[0] + eps for G, S in ((G_x, P), (G_w, W), (G_v, V)))
    rows = [(a_x, H_A, H_C), (a_w, H_Bw, H_Dw), (a_v, H_Bv, H_Dv)]
    Delta_1, Delta_2 = sum(a * h @ g.T for a, h, g in rows), sum(a * g @ g.T for a, h, g in rows)
    Delta_3 = sum(a * h @ h.T for a, h, g in rows)
    P_c, U_c = widened(P, G_x, a_x), block_diag(widened(W, G_w, a_w), widened(V, G_v, a_v))
    B, D = np.hstack([B_w, B_v]), np.hstack([D_w, D_v])
    Psi_1, Psi_2 = B @ U_c @ D.T + Delta_1, D @ U_c @ D.T + Delta_2
    N, S = A @ P_c @ C.T + Psi_1, C @ P_c @ C.T + Psi_2
    K = N @ np.linalg.pinv(S)
    Phi = A + (A - K @ C) @ P @ G_x.T @ inv(a_x * np.eye(1) - G_x @ P @ G_x.T) @ G_x
    after = A @ P_c @ A.T + B @ U_c @ B.T + Delta_3 - N @ np.linalg.pinv(S) @ N.T
    rest, mixed = A - K @ C, B - K @ D
    joseph = rest @ P_c @ rest.T + mixed @ U_c @ mixed.T
    joseph += sum(a * (h - K @ g) @ (h - K @ g).T for a, h, g in rows)

    pair = NoisePair(
        NoiseChannel(np.vstack([B_w, D_w]), np.vstack([H_Bw, H_Dw]), G_w, W),
        NoiseChannel(np.vstack([B_v, D_v]), np.vstack([H_Bv, H_Dv]), G_v, V),
    )
    rules = ParameterRules(Excess(eps=eps), Excess(eps=eps), Excess(eps=eps), False, False, False)
    step = RobustStep(A, C, np.vstack([H_A, H_C]), G_x, pair, rules)
    found = step.step(psd_sqrt(P), P, step.first_noises())
    np.testing.assert_allclose(found.a, (a_x, a_w, a_v), **ROUND)
    for ours, printed in ((found.K, K), (found.Phi, Phi), (found.P_next, after), (found.P_next, joseph)):
        np.testing.assert_allclose(ours, printed, rtol=1e-8, atol=1e-10)  # inverses of a random system


def test_souto2011_state_bound(rng):
    """(51), (59): with rule: state."""
    A, H, G, Bw, C = 0.5 * np.eye(2), np.array([[0.0], [0.3]]), np.array([[0.2, 0.1]]), np.eye(2), np.array([[1.0, 0]])
    X, eps = random_psd(rng, 2), 0.1
    none = NoiseChannel(np.vstack([np.zeros((2, 1)), [[1.0]]]), np.zeros((3, 1)), np.zeros((1, 1)), np.eye(1))
    pair = NoisePair(
        NoiseChannel(np.vstack([Bw, np.zeros((1, 2))]), np.zeros((3, 1)), np.zeros((1, 2)), np.eye(2)), none
    )
    rules = ParameterRules(Excess(eps=eps), Excess(eps=eps), Excess(eps=eps), True, False, False)
    step = RobustStep(A, C, np.vstack([H, [[0.0]]]), G, pair, rules)
    found = step.step(psd_sqrt(0.5 * X), X, step.first_noises())
    a_x = (G @ X @ G.T).item() + eps
    inner = X + X @ G.T @ inv(a_x * np.eye(1) - G @ X @ G.T) @ G @ X
    np.testing.assert_allclose(found.X_next, A @ inner @ A.T + Bw @ Bw.T + a_x * H @ H.T, rtol=1e-10)


def test_souto2011_limit_named_on_the_page():
    """Without uncertainty the recursion is that of the Kalman predictor."""
    model = LinearModel([[0.9, 0.1], [0.0, 0.8]], [[0.0], [1.0]], [[1.0, 0.0]], 0.1, 0.5)
    gains = predictor(model, 3, x0=np.zeros(2), P0=np.eye(2))
    A, C, P = model.A, model.C, np.eye(2)
    for k in range(3):
        K = A @ P @ C.T @ inv(C @ P @ C.T + model.R_v)
        np.testing.assert_allclose(gains.K[k], K, rtol=1e-10)
        P = A @ P @ A.T + model.Q_w - K @ (C @ P @ C.T + model.R_v) @ K.T


def test_ma2025_correction(rng):
    """(20)-(22), (24): gain and weight satisfy each other's equation."""
    prior = Prior(rng.standard_normal((2, 3)), *(psd_sqrt(random_psd(rng, n)) for n in (3, 3, 2, 2)))
    found = mixed_step(prior)
    H, q, L = prior.C, found.q, found.L
    T = np.eye(3) - L @ H
    P, M, P_v, M_v = (each @ each.T for each in prior[1:])
    V, R = P + (1 / q + 1) * M, P_v + (q + 1) * M_v
    np.testing.assert_allclose(L, V @ H.T @ inv(H @ V @ H.T + R), **SOLVER)
    np.testing.assert_allclose(q, np.sqrt(np.trace(T @ M @ T.T) / np.trace(L @ M_v @ L.T)), **SOLVER)
    np.testing.assert_allclose(found.P, T @ P @ T.T + L @ P_v @ L.T, rtol=1e-10)
    np.testing.assert_allclose(found.M, (1 / q + 1) * T @ M @ T.T + (q + 1) * L @ M_v @ L.T, **SOLVER)


@pytest.mark.parametrize("x", [(60.0, -45.0), (3.0, -2.0)])
def test_ma2025_game(x):
    """rho of the multipliers, their domain and the input, as on the page."""
    N, x = 8, np.array(x)
    stages = minimax_oracles.paper_stages(20, N)
    M, M_w = np.array([[28.0, -9.0], [-9.0, 12.0]]), np.array([[5.0, 2.0], [2.0, 5.0]])
    game = game_of(stages, psd_sqrt(np.broadcast_to(M_w, (N, 2, 2))))
    found = solve(game, psd_sqrt(M[None])[0], x)
    tau_1, tau_2 = found.tau_1, found.tau[0]

    def values(M_w, with_input=True):
        Pi = [np.array(stages.Q[N - 1])]
        for t in reversed(range(N)):
            S = stages.B[t] @ inv(stages.R[t]) @ stages.B[t].T if with_input else np.zeros((2, 2))
            now = stages.A[t].T @ Pi[0] @ inv(np.eye(2) + (S - M_w) @ Pi[0]) @ stages.A[t]
            Pi.insert(0, now + (stages.Q[t - 1] if t > 0 else 0.0))
        return Pi

    Pi, Y, free = values(M_w / tau_2), values(M_w / tau_2, with_input=False), values(np.zeros((2, 2)))
    worst = inv(np.eye(2) - M @ Pi[0] / tau_1) @ x
    np.testing.assert_allclose(found.rho, tau_1 + tau_2 + x @ Pi[0] @ worst - x @ free[0] @ x, rtol=1e-8)
    assert tau_1 >= max(eigvalsh(sqrtm(M).real @ Y[0] @ sqrtm(M).real)) * (1 - 1e-9)
    assert all(tau_2 > max(np.linalg.eigvals(M_w @ Y[t + 1]).real) for t in range(N))
    S = stages.B[0] @ inv(stages.R[0]) @ stages.B[0].T
    gain = inv(stages.R[0]) @ stages.B[0].T @ Pi[1] @ inv(np.eye(2) + (S - M_w / tau_2) @ Pi[1]) @ stages.A[0]
    U = plan(game, np.linalg.solve(stages.R, stages.B.mT), found)
    np.testing.assert_allclose(U[0], -gain @ worst, rtol=1e-8)


def test_belda2017_weight():
    """(28) and (16): k_p = 1."""
    T = np.array([[1.0, 0.2, -0.1], [0.0, 1.0, 0.4], [0.0, 0.0, 1.0]])
    r = np.array([0.5, 0.2, 0.1])
    box = Triangle(T[None], r[None])
    C_y = inv(T) @ np.diag(r**2) @ inv(T).T / 3.0
    np.testing.assert_allclose(covariance(box, 1.0 / 3.0)[0], C_y, rtol=1e-11)
    np.testing.assert_allclose(precision(box, 1.0 / 3.0)[0], 3.0 * T.T @ np.diag(r**-2.0) @ T, rtol=1e-11)
