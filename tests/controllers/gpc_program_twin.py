"""The constrained problem of predictive control in positional form: states and slacks as variables, and its KKT."""

from typing import NamedTuple

import cvxpy as cp
import numpy as np
from scipy.optimize import lsq_linear


class Problem(NamedTuple):
    """One problem of one run; the soft limits are those of one signal Z x + z_0."""

    A: np.ndarray
    B: np.ndarray
    f: np.ndarray
    C: np.ndarray
    Q_yw: np.ndarray
    Q_u: np.ndarray
    w: np.ndarray
    x: np.ndarray
    before: np.ndarray
    u: tuple
    du: tuple
    Z: np.ndarray
    z_0: np.ndarray
    z: tuple
    scale: np.ndarray
    linear: float
    quadratic: float
    steps: int


def by_clarabel(p):
    """(inputs, cost with slacks) by cvxpy; the model is a constraint."""
    N, nu = len(p.w), p.B.shape[1]
    x, u, eps = cp.Variable((N + 1, len(p.x))), cp.Variable((N, nu)), cp.Variable((p.steps, len(p.Z)), nonneg=True)
    cost = cp.sum_squares((x[1:] @ p.C.T - p.w) @ p.Q_yw.T) + cp.sum_squares(u @ p.Q_u.T)
    cost += p.linear * cp.sum(eps) + 0.5 * p.quadratic * cp.sum_squares(eps)
    every, step = np.ones((N, 1)), u - cp.vstack([p.before[None], u[:-1]])
    rules = [x[0] == p.x, x[1:] == x[:-1] @ p.A.T + u @ p.B.T + every * p.f]
    rules += [u >= every * p.u[0], u <= every * p.u[1], step >= p.du[0], step <= p.du[1]]
    z = x[1 : p.steps + 1] @ (p.Z / p.scale[:, None]).T + np.ones((p.steps, 1)) * (p.z_0 / p.scale)
    rules += [z >= p.z[0] / p.scale - eps, z <= p.z[1] / p.scale + eps]
    problem = cp.Problem(cp.Minimize(cost), rules)
    problem.solve(solver=cp.CLARABEL)
    return u.value, problem.value


def predicted(p, U):
    """States x(1)..x(N) and their derivatives by the inputs, entry by entry."""
    N, (nx, nu) = len(p.w), p.B.shape
    X, D = np.zeros((N, nx)), np.zeros((N, nx, N * nu))
    x, d = p.x, np.zeros((nx, N * nu))
    for j in range(N):
        x, d = p.A @ x + p.B @ U[j] + p.f, p.A @ d
        d[:, j * nu : (j + 1) * nu] = p.B
        X[j], D[j] = x, d
    return X, D


def cost_of(p, U):
    """Cost of inputs with the least slacks."""
    X, _ = predicted(p, U)
    cost = sum(np.sum((p.Q_yw @ (p.C @ x - w)) ** 2) for x, w in zip(X, p.w, strict=True))
    z = X[: p.steps] @ p.Z.T + p.z_0
    eps = np.maximum(0.0, np.maximum(z - p.z[1], p.z[0] - z)) / p.scale
    return cost + np.sum((U @ p.Q_u.T) ** 2) + p.linear * eps.sum() + 0.5 * p.quadratic * np.sum(eps**2)


def kkt_residual(p, U, near=1e-8):
    """Largest violated row, and the gradient that no allowed multipliers cancel, relative to that without limits.

    Multipliers of hard rows are not negative, those of soft ones without a slack lie in [0, linear], and those with a
    slack are linear + quadratic eps.
    """
    N, nu = U.shape
    X, D = predicted(p, U)
    gradient = sum(2.0 * (p.Q_yw @ p.C @ d).T @ p.Q_yw @ (p.C @ x - w) for x, d, w in zip(X, D, p.w, strict=True))
    gradient = gradient + 2.0 * (U @ p.Q_u.T @ p.Q_u).ravel()
    every, size = np.eye(N * nu), np.abs(gradient).max()
    step = every - np.eye(N * nu, k=-nu)
    moves = np.diff(np.vstack([p.before[None], U]), axis=0)
    rows, most, violated = [], [], 0.0
    for values, matrix, (low, high) in ((U, every, p.u), (moves, step, p.du)):
        for sign, bound in ((1.0, high), (-1.0, low)):
            beyond = (sign * (values - bound)).ravel()
            violated = max(violated, beyond.max())
            rows += [sign * matrix[i] for i in np.flatnonzero(beyond > -near)]
            most += [np.inf] * int(np.sum(beyond > -near))
    for j in range(p.steps):
        for i, row in enumerate(p.Z):
            z, derivative = row @ X[j] + p.z_0[i], row @ D[j] / p.scale[i]
            for sign, bound in ((1.0, p.z[1]), (-1.0, p.z[0])):
                beyond = sign * (z - bound) / p.scale[i]
                if beyond > near:
                    gradient = gradient + sign * derivative * (p.linear + p.quadratic * beyond)
                elif beyond > -near:
                    rows.append(sign * derivative)
                    most.append(p.linear)
    if not rows:
        return violated, np.abs(gradient).max() / max(size, 1e-300)
    found = lsq_linear(np.array(rows).T, -gradient, (0.0, np.array(most) + 1e-300), method="bvls", tol=1e-15)
    return violated, np.abs(found.fun).max() / max(size, np.abs(found.x).max())
