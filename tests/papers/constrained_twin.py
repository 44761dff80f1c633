"""A second program for the constrained servomechanism: NumPy and quadprog, written from the equations.

Only the true plant and its draws are those of the package.  Model, filter, prediction and quadratic program are made
here: slacks are variables of their own, every program is solved in physical states and scaled moves, and nothing is
skipped but steps where the unconstrained minimiser is feasible.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import quadprog
from scipy.linalg import expm

TS, HP, HU = 0.1, 10, 3
U_SPAN, Y_SPAN, TORQUE_SPAN = 440.0, 2 * np.pi, 50 * np.pi
U_MAX, TORQUE_MAX = 220.0, 25 * np.pi
QUADRATIC = 1e-3
REFERENCE = np.pi / 2
J_M, BETA_M, R, K_T, RHO, K_THETA, J_L, BETA_L = 0.5, 0.1, 20.0, 10.0, 20.0, 1280.2, 25.0, 25.0


class Model(NamedTuple):
    """x(k+1) = A x(k) + B u(k) + w(k), y(k) = C x(k) + v(k), shaft torque Z x."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    Z: np.ndarray
    Q_w: np.ndarray


def _continuous():
    """Balance of torques of load and motor; the shaft is on the side of the load."""
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[1] = np.array([-K_THETA, -BETA_L, K_THETA / RHO, 0.0]) / J_L
    A[3] = np.array([K_THETA / RHO, 0.0, -K_THETA / RHO**2, -BETA_M - K_T**2 / R]) / J_M
    return A, np.array([[0.0], [0.0], [0.0], [K_T / (R * J_M)]])


def _sampled(A, B):
    n, m = B.shape
    power = expm(TS * np.block([[A, B], [np.zeros((m, n + m))]]))
    return power[:n, :n], power[:n, n:]


def _noise(A, n_points=2000):
    """Integral of e^(A t) e^(A' t) over a sample, by the midpoint rule with an extrapolation."""

    def midpoint(n):
        times = (np.arange(n) + 0.5) * TS / n
        return sum((power := expm(A * t)) @ power.T for t in times) * TS / n

    return (4 * midpoint(n_points) - midpoint(n_points // 2)) / 3


def model(at=None, drift=0.0):
    """Return the design model, with a disturbance at `input` or `load`."""
    A_c, B_c = _continuous()
    A, B = _sampled(A_c, B_c)
    C, Z = np.array([1.0, 0.0, 0.0, 0.0]), np.array([-K_THETA, 0.0, K_THETA / RHO, 0.0])
    Q_w = _noise(A_c, 200)
    if at is None:
        return Model(A, B[:, 0], C, Z, Q_w)
    B_d = B if at == "input" else _sampled(A_c, np.array([[0.0], [1.0 / J_L], [0.0], [0.0]]))[1]
    A = np.block([[A, B_d], [np.zeros((1, 4)), np.eye(1)]])
    wide = np.zeros((5, 5))
    wide[:4, :4], wide[4, 4] = Q_w, drift
    return Model(A, np.append(B[:, 0], 0.0), np.append(C, 0.0), np.append(Z, 0.0), wide)


def kalman_gains(m, n_steps):
    """Return the correction gains of k = 0..N, with P(0) = Q_w and R_v = 1."""
    P, gains = m.Q_w, []
    for _ in range(n_steps + 1):
        L = P @ m.C / (m.C @ P @ m.C + 1.0)
        gains.append(L)
        P = m.A @ (P - np.outer(L, m.C @ P)) @ m.A.T + m.Q_w
    return gains


class Law:
    """The constrained control law of one run.

    Parameters
    ----------
    m : prediction model
    linear : linear penalty of the torque; None without a torque limit, infinity for a hard limit
    """

    def __init__(self, m, linear=None):
        self.linear, self.multiplier = linear, 0.0
        self.free, self.held, self.moves = self._prediction(m, m.C)
        self.free_z, self.held_z, self.moves_z = self._prediction(m, m.Z)
        self.H = 2 * (0.1 * (U_SPAN / Y_SPAN) ** 2 * self.moves.T @ self.moves + 0.1 * np.eye(HU))

    @staticmethod
    def _prediction(m, row):
        """Response of a signal to x, to a held input and to every move, at 1..HP samples."""
        free, held, power, state = [], [0.0], np.eye(len(m.A)), np.zeros(len(m.A))
        for _ in range(HP):
            power, state = m.A @ power, m.A @ state + m.B
            free.append(row @ power)
            held.append(row @ state)
        moves = np.array([[held[max(j - i, 0)] for i in range(HU)] for j in range(1, HP + 1)])
        return np.array(free), np.array(held[1:]), moves

    def first_move(self, x, u):
        """Return the first increment of the input."""
        f = 0.2 * U_SPAN / Y_SPAN**2 * self.moves.T @ (self.free @ x + self.held * u - REFERENCE)
        L, n_slack = np.tril(np.ones((HU, HU))), 0
        rows, low = [L, -L], [np.full(HU, (-U_MAX - u) / U_SPAN), np.full(HU, (u - U_MAX) / U_SPAN)]
        if self.linear is not None:
            Z, z = self.moves_z * U_SPAN / TORQUE_SPAN, (self.free_z @ x + self.held_z * u) / TORQUE_SPAN
            rows, low = [*rows, Z, -Z], [*low, -0.5 - z, z - 0.5]
            n_slack = HP if np.isfinite(self.linear) else 0
        A, b = np.vstack(rows), np.concatenate(low)
        unconstrained = -np.linalg.solve(self.H, f)
        if (A @ unconstrained >= b).all():
            return U_SPAN * unconstrained[0]
        H = np.zeros((HU + n_slack, HU + n_slack))
        H[:HU, :HU], H[HU:, HU:] = self.H, QUADRATIC * np.eye(n_slack)
        if n_slack:
            f = np.append(f, np.full(HP, self.linear))
            A = np.block([[A, np.vstack([np.zeros((2 * HU, HP)), np.eye(HP), np.eye(HP)])]])
            A, b = np.vstack([A, np.eye(HP, HU + HP, HU)]), np.append(b, np.zeros(HP))
        solution = quadprog.solve_qp(H, -f, A.T.copy(), b)
        self.multiplier = max(self.multiplier, solution[4][2 * HU : 2 * (HU + HP)].max(initial=0.0))
        return U_SPAN * solution[0][0]


class Run(NamedTuple):
    """One closed loop."""

    y: np.ndarray
    u: np.ndarray


def simulate(plant_step, x, m, law, n_steps):
    """Simulate one run.

    Parameters
    ----------
    plant_step : function of the true state and the input
    x : true state at k = 0, whose first entry is measured
    m, law : design model and control law
    n_steps : number of control periods
    """
    gains, x_pred, u, y, inputs = kalman_gains(m, n_steps), np.zeros(len(m.A)), 0.0, [x[0]], []
    for k in range(n_steps):
        x_hat = x_pred + gains[k] * (x[0] - m.C @ x_pred)
        u = float(np.clip(u + law.first_move(x_hat, u), -U_MAX, U_MAX))
        x = plant_step(x, u)
        x_pred = m.A @ x_hat + m.B * u
        y.append(x[0])
        inputs.append(u)
    return Run(np.array(y), np.array(inputs))
