"""The plain twin of models/moving_slide_kernel.py: one run at a time, from vectors; a run is a dict of its numbers."""

import numpy as np
from scipy.linalg import expm

from rmpc_bench.models.moving_slide import MASSES, NUMBERS

CORNERS = ((1, 1), (-1, 1), (-1, -1), (1, -1))


def robot(mass=1.0, **changed):
    """Numbers of a robot, masses multiplied."""
    p = {**NUMBERS, **changed}
    return {name: value * mass if name in MASSES else value for name, value in p.items()}


def corner(p, y, i):
    """Vectors of arm i: the lever of the platform's corner, and the corner seen from the base joint."""
    sign = np.array(CORNERS[i], dtype=float)
    cos, sin = np.cos(y[2]), np.sin(y[2])
    lever = np.array([[cos, -sin], [sin, cos]]) @ (p["b"] * sign)
    return lever, y[:2] + lever - p["a"] * sign


def angles(p, y):
    """Angles of the arms and their lengths, nothing else being known of the geometry."""
    d = [corner(p, y, i)[1] for i in range(4)]
    return np.array([np.arctan2(each[1], each[0]) for each in d]), np.array([np.hypot(*each) for each in d])


def rows(p, x):
    """Of each arm: J, S, dJ/dt, W, dW/dt."""
    y, v = x[:3], x[3:]
    for i in range(4):
        lever, d = corner(p, y, i)
        length = np.linalg.norm(d)
        e = d / length
        n = np.array([-e[1], e[0]])
        W = np.array([[1.0, 0.0, -lever[1]], [0.0, 1.0, lever[0]]])
        dW = np.array([[0.0, 0.0, -v[2] * lever[0]], [0.0, 0.0, -v[2] * lever[1]]])
        J, S = n @ W / length, e @ W
        yield J, S, (-(J @ v) * S + n @ dW) / length - J * (S @ v) / length, W, dW


def matrices(p, x):
    """M and N of M v' + N v = J' tau, and J."""
    M, N, all_J = np.diag([p["m_p"], p["m_p"], p["I_p"]]), np.zeros((3, 3)), []
    for J, S, dJ, W, dW in rows(p, x):
        M = M + p["I_arm"] * np.outer(J, J) + p["m_s"] * W.T @ W
        N = N + p["I_arm"] * np.outer(J, dJ) + p["m_s"] * W.T @ dW
        N = N + p["d_rot"] * np.outer(J, J) + p["d_sl"] * np.outer(S, S)
        all_J.append(J)
    return M, N, np.array(all_J)


def slope(p, x, u):
    """Time derivative of the state."""
    M, N, J = matrices(p, x)
    return np.concatenate([x[3:], np.linalg.solve(M, J.T @ u - N @ x[3:])])


def step(p, x, u, Ts, substeps):
    """State after a sample by the classical method of Runge and Kutta."""
    h = Ts / substeps
    for _ in range(substeps):
        k1 = slope(p, x, u)
        k2 = slope(p, x + h / 2 * k1, u)
        k3 = slope(p, x + h / 2 * k2, u)
        k4 = slope(p, x + h * k3, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def frozen(p, x):
    """Continuous-time A and B at a state."""
    M, N, J = matrices(p, x)
    A, B = np.zeros((6, 6)), np.zeros((6, 4))
    A[:3, 3:], A[3:, 3:], B[3:] = np.eye(3), -np.linalg.solve(M, N), np.linalg.solve(M, J.T)
    return A, B


def pair(p, x, Ts):
    """Sampled A and B, by the exponential of the block matrix."""
    block = np.zeros((10, 10))
    block[:6, :6], block[:6, 6:] = frozen(p, x)
    E = expm(block * Ts)
    return E[:6, :6], E[:6, 6:]


def energy(p, x):
    """Kinetic energy [J], body by body."""
    y, v = x[:3], x[3:]
    total = 0.5 * p["m_p"] * (v[0] ** 2 + v[1] ** 2) + 0.5 * p["I_p"] * v[2] ** 2
    for i in range(4):
        lever, d = corner(p, y, i)
        velocity = v[:2] + v[2] * np.array([-lever[1], lever[0]])
        turn = (d[0] * velocity[1] - d[1] * velocity[0]) / (d @ d)
        total += 0.5 * p["m_s"] * velocity @ velocity + 0.5 * p["I_arm"] * turn**2
    return total


def lost(p, x):
    """Power that damping takes [W]."""
    return sum(p["d_rot"] * (J @ x[3:]) ** 2 + p["d_sl"] * (S @ x[3:]) ** 2 for J, S, *_ in rows(p, x))
