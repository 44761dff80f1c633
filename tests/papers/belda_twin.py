"""The experiment of belda2017 for one run, written a second time: plain loops, SciPy's linear programs, least squares.

Nothing here comes from the package.  The numbers of the robot are those of the plant's documentation.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog

PIVOT, CORNER = 0.30, 0.08
CORNERS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], dtype=float)
M_P, I_P, M_S, I_ARM, D_ROT, D_SL = 2.60, 0.040, 0.30, 0.030, 0.020, 0.50
C = np.eye(3, 6)


class Run(NamedTuple):
    """Trajectories of one run: true states k = 0..N, the rest k = 0..N-1."""

    x: np.ndarray
    x_hat: np.ndarray
    u: np.ndarray
    Q: np.ndarray


def dynamics(x):
    """M, N and J of M v' + N v = J' tau."""
    psi, v = x[2], x[3:]
    R = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
    M, N, J = np.diag([M_P, M_P, I_P]), np.zeros((3, 3)), np.zeros((4, 3))
    for i, corner in enumerate(CORNERS):
        p = R @ (CORNER * corner)
        d = x[:2] + p - PIVOT * corner
        length = np.hypot(*d)
        e = d / length
        n = np.array([-e[1], e[0]])
        W, dW = np.array([[1, 0, -p[1]], [0, 1, p[0]]]), np.array([[0, 0, -v[2] * p[0]], [0, 0, -v[2] * p[1]]])
        J[i], S = n @ W / length, e @ W
        dJ = (-(J[i] @ v) * S + n @ dW) / length - J[i] * (S @ v) / length
        M = M + I_ARM * np.outer(J[i], J[i]) + M_S * W.T @ W
        N += I_ARM * np.outer(J[i], dJ) + M_S * W.T @ dW + D_ROT * np.outer(J[i], J[i]) + D_SL * np.outer(S, S)
    return M, N, J


def pair(x, Ts):
    """The frozen pair, sampled by the exponential of the block matrix."""
    M, N, J = dynamics(x)
    block = np.zeros((10, 10))
    block[:3, 3:6] = np.eye(3)
    block[3:6, 3:6], block[3:6, 6:] = -np.linalg.solve(M, N), np.linalg.solve(M, J.T)
    E = expm(block * Ts)
    return E[:6, :6], E[:6, 6:]


def rate(x, u):
    """x' with the torques u."""
    M, N, J = dynamics(x)
    return np.concatenate([x[3:], np.linalg.solve(M, J.T @ u - N @ x[3:])])


def moved(x, u, Ts, substeps=2):
    """The state a sample later, by the classic scheme of order four."""
    h = Ts / substeps
    for _ in range(substeps):
        a = rate(x, u)
        b = rate(x + 0.5 * h * a, u)
        c = rate(x + 0.5 * h * b, u)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, u))
    return x


def path(t, T=8.0):
    """The S-shape, held at its end."""
    s = np.clip(t / T, 0, 1)
    g = 10 * s**3 - 15 * s**4 + 6 * s**5
    f = -np.pi / 8 + (np.pi + np.pi / 4) * g
    return np.stack([-0.08 * np.sin(2 * f), 0.10 * np.cos(f), 0.20 * np.sin(np.pi * g) ** 2], axis=-1)


def lp1(y, A, B, u):
    """(17)-(19) without a state before the window: x(k), with all states of the window, rho and r as unknowns."""
    n = len(y)
    size = 6 * n + 9
    left, right = [], []
    for sign in (1.0, -1.0):
        for j in range(1, n):
            row = np.zeros((6, size))
            row[:, 6 * j : 6 * j + 6], row[:, 6 * j - 6 : 6 * j] = sign * np.eye(6), -sign * A[j - 1]
            row[:, 6 * n : 6 * n + 6] = -np.eye(6)
            left.append(row), right.append(sign * B[j - 1] @ u[j - 1])
        for j in range(n):
            row = np.zeros((3, size))
            row[:, 6 * j : 6 * j + 6], row[:, 6 * n + 6 :] = -sign * C, -np.eye(3)
            left.append(row), right.append(-sign * y[j])
    cost, bounds = np.r_[np.zeros(6 * n), np.ones(9)], [(None, None)] * (6 * n) + [(0, None)] * 9
    found = linprog(cost, np.vstack(left), np.concatenate(right), bounds=bounds, method="highs")
    assert found.status == 0
    return found.x[6 * n - 6 : 6 * n]


def minimax(d, F):
    """Least r with |d - F p| <= r, and p."""
    n, m = F.shape
    left = np.block([[-F, -np.ones((n, 1))], [F, -np.ones((n, 1))]])
    bounds = [(None, None)] * m + [(0, None)]
    found = linprog(np.r_[np.zeros(m), 1.0], left, np.r_[-d, d], bounds=bounds, method="highs")
    assert found.status == 0
    return found.x[:m], found.x[m]


def penalty(y, x_hat, kp=1e-7, bounds=(0.5, 4.0)):
    """Q_yw = kp C_y^-1 of (28), with 1/3, from the output rows of (24)."""
    y, e = np.array(y), np.array(y) - np.array(x_hat)[:, :3]
    P, r = np.eye(3), np.zeros(3)
    for i in range(3):
        P[i, i + 1 :], r[i] = minimax(e[:, i], -y[:, i + 1 :])
    inverse = np.linalg.inv(P)
    Q = kp * np.linalg.inv(inverse @ np.diag(np.maximum(r, 1e-6) ** 2) @ inverse.T / 3.0)
    return np.where(np.eye(3, dtype=bool), np.clip(Q, *bounds), np.clip(Q, -bounds[1], bounds[1]))


def gpc(A, B, x_hat, w, Q, Q_u=1e-2):
    """(3)-(15) with the whole stack."""
    Np = len(w)
    F, G, power = np.zeros((3 * Np, 6)), np.zeros((3 * Np, 4 * Np)), np.eye(6)
    for i in range(Np):
        for j in range(i, Np):
            G[3 * j : 3 * j + 3, 4 * (j - i) : 4 * (j - i) + 4] = C @ power @ B
        power = A @ power
        F[3 * i : 3 * i + 3] = C @ power
    QY = np.kron(np.eye(Np), Q)
    stack = np.vstack([QY @ G, Q_u * np.eye(4 * Np)])
    return np.linalg.lstsq(stack, np.r_[QY @ (w.ravel() - F @ x_hat), np.zeros(4 * Np)], rcond=None)[0][:4]


def simulate(noise, *, tuned, Ne=3, Ne2=14, Np=10, Ts=0.01):
    """One run, measured with a noise (samples, 3); its length says how many periods there are."""
    n_steps = len(noise)
    w = path(Ts * np.arange(n_steps + Np + 1))
    x = x_hat = np.r_[w[0], np.zeros(3)]
    ys, As, Bs, us, x_hats, Qs, xs, Q = [], [], [], [], [], [], [x], np.eye(3)
    for k in range(n_steps):
        ys.append(x[:3] + noise[k])
        A, B = pair(x_hat, Ts)  # of the estimate before
        if k > 0:
            As.append(A), Bs.append(B)
            predicted, n = A @ x_hat + B @ us[-1], min(k, Ne) + 1
            halfway = predicted + np.r_[0.5 * (ys[-1] - predicted[:3]), np.zeros(3)]
            x_hat = halfway if n < 3 else lp1(ys[-n:], As[1 - n :], Bs[1 - n :], us[1 - n :])
        x_hats.append(x_hat)
        if tuned and k >= Ne + Ne2:
            Q = penalty(ys[-Ne2 - 1 :], x_hats[-Ne2 - 1 :])
        u = gpc(A, B, x_hat, w[k + 1 : k + 1 + Np], Q)
        x = moved(x, u, Ts)
        Qs.append(Q), us.append(u), xs.append(x)
    return Run(np.array(xs), np.array(x_hats), np.array(us), np.array(Qs))
