"""LP1 as belda2017 prints it, (17)-(19): every state, rho and r unknown, by SciPy, and by cvxpy with Clarabel."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
WAYS = [(method, TIGHT | {"presolve": on}) for method in ("highs-ds", "highs-ipm") for on in (True, False)]


def program(c, A, b, bounds):
    """SciPy's optimum; on degenerate programs some of its ways end without an answer, and say so."""
    for method, options in WAYS:
        found = linprog(c, A, b, bounds=bounds, method=method, options=options)
        if found.status == 0:
            return found
    raise AssertionError(found.message)


class Data(NamedTuple):
    """One window: entry j of A and c leads to x(j), that of the first point (free: unused) from ``before``."""

    y: np.ndarray
    A: np.ndarray
    c: np.ndarray
    C: np.ndarray
    before: np.ndarray
    anchored: bool = False


def inequalities(data):
    """A_k, b_k of (18) over X = [x(first)..x(last), rho, r], two rows per equation and sign."""
    points, ny = data.y.shape
    nx = data.A.shape[1]
    rows, right, n = [], [], points * nx

    def bounded(coefficients, constant, place):
        for sign in (1.0, -1.0):
            row = np.zeros(n + nx + ny)
            row[:n], row[n + place] = sign * coefficients, -1.0
            rows.append(row)
            right.append(-sign * constant)

    for j in range(points):
        if j > 0 or data.anchored:
            for i in range(nx):
                coefficients, constant = np.zeros(n), -data.c[j, i]
                coefficients[j * nx + i] = 1.0
                if j > 0:
                    coefficients[(j - 1) * nx : j * nx] = -data.A[j, i]
                else:
                    constant -= data.A[j, i] @ data.before
                bounded(coefficients, constant, i)
        for o in range(ny):
            coefficients = np.zeros(n)
            coefficients[j * nx : (j + 1) * nx] = -data.C[j, o]
            bounded(coefficients, data.y[j, o], nx + o)
    return np.array(rows), np.array(right)


def transitions(A):
    """Maps from the first state to those of all points."""
    Phi = [np.eye(A.shape[1])]
    for j in range(1, len(A)):
        Phi.append(A[j] @ Phi[-1])
    return np.array(Phi)


def path(data):
    """States from the first one on without noise; the first one, or what leads to it, is ``before``."""
    x = [data.A[0] @ data.before + data.c[0] if data.anchored else data.before]
    for j in range(1, len(data.y)):
        x.append(data.A[j] @ x[-1] + data.c[j])
    return np.array(x)


def solve(data):
    """(objective, x(last), rho, r) by SciPy."""
    A, b = inequalities(data)
    points, ny = data.y.shape
    nx = data.A.shape[1]
    n = points * nx
    f = np.concatenate([np.zeros(n), np.ones(nx + ny)])
    found = program(f, A, b, [(None, None)] * n + [(0.0, None)] * (nx + ny))
    return found.fun, found.x[n - nx : n], found.x[n : n + nx], found.x[n + nx :]


def chosen(data, age, process):
    """Smallest and largest positions at the last point among the optima of (18) and then of the weighted noises.

    The noises are bounded by further unknowns, one per equation; each objective is held to 1e-7 of its optimum.
    """
    A, b = inequalities(data)
    (points, ny), nx = data.y.shape, data.A.shape[1]
    n, pairs = points * nx, len(A) // 2
    first = np.concatenate([np.zeros(n), np.ones(nx + ny), np.zeros(pairs)])
    own = np.kron(np.eye(pairs), np.ones((2, 1)))
    singly = np.hstack([A, -own])  # the residual alone: bounded by its own unknown instead of rho or r
    singly[:, n : n + nx + ny] = 0.0
    per_point = [ny if j == 0 and not data.anchored else nx + ny for j in range(points)]
    when = np.repeat(np.arange(points), per_point)
    is_state = np.concatenate([[i < count - ny for i in range(count)] for count in per_point])
    second = np.concatenate([np.zeros(n + nx + ny), age ** (points - 1.0 - when) * np.where(is_state, process, 1.0)])
    rows, right = np.vstack([np.hstack([A, 0.0 * own]), singly]), np.concatenate([b, b])
    bounds = [(None, None)] * n + [(0.0, None)] * (nx + ny + pairs)
    for objective in (first, second):
        best = program(objective, rows, right, bounds)
        rows, right = np.vstack([rows, objective]), np.append(right, best.fun + 1e-7)
    ends = np.empty((2, ny))
    for i in range(ny):
        e = np.zeros(len(first))
        e[n - nx + i] = 1.0
        ends[:, i] = [sign * program(sign * e, rows, right, bounds).fun for sign in (1.0, -1.0)]
    return ends


def solve_with_cvxpy(data):
    """(objective, x(last), rho, r) by an interior point method, written as the paper writes it."""
    import cvxpy as cp

    (points, ny), nx = data.y.shape, data.A.shape[1]
    x, rho, r = cp.Variable((points, nx)), cp.Variable(nx, nonneg=True), cp.Variable(ny, nonneg=True)
    constraints = []
    for j in range(points):
        constraints.append(cp.abs(data.y[j] - data.C[j] @ x[j]) <= r)
        if j > 0 or data.anchored:
            before = x[j - 1] if j > 0 else data.before
            constraints.append(cp.abs(x[j] - data.A[j] @ before - data.c[j]) <= rho)
    problem = cp.Problem(cp.Minimize(cp.sum(rho) + cp.sum(r)), constraints)
    problem.solve(solver="CLARABEL", tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    return problem.value, x.value[-1], rho.value, r.value
