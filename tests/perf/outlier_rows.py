"""Filters for outliers on a block of 50 runs, beside the same arithmetic in plain NumPy for the whole block.

A unit is a correction and a prediction of a run.  The baseline of one output has the closed forms, that of two outputs
repeats Kalman corrections as the equations are printed.  Both have the data of 5 % outliers, and return the last
estimates.
"""

import numpy as np

from perf.row import Row
from rmpc_bench.models.linear import LinearModel

RUNS, STEPS, DOF, K, ITERATIONS = 50, 200, 4.0, 1.345, 10


def system(outputs):
    """Return a model of two states for one output, and of four for two."""
    block = np.array([[1.0, 1.0], [0.0, 1.0]])
    Q_w = np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
    eye = np.eye(outputs)
    A, Q, C = np.kron(eye, block), np.kron(eye, Q_w), np.kron(eye, [[1.0, 0.0]])
    R = 100.0 * (eye + 0.3 * (1.0 - eye))
    return LinearModel(A, np.ones((2 * outputs, 1)), C, Q, R), {"x0": np.zeros(2 * outputs), "P0": 10.0 * Q}


def signals(outputs):
    """Return measurements and inputs over time."""
    rng = np.random.default_rng(3)
    y = 10.0 * rng.standard_normal((STEPS, RUNS, outputs))
    return y + 100.0 * (rng.random(y.shape) < 0.05), rng.standard_normal((STEPS, RUNS, 1))


def ours(kind, outputs):
    """Run the filter of the package."""
    from rmpc_bench.estimators import huber_kalman, student_kalman

    model, start = system(outputs)
    keys = {"dof": DOF, "iterations": ITERATIONS} if kind == "student" else {"k": K}
    filter_ = (student_kalman if kind == "student" else huber_kalman).design(model, STEPS, **start, **keys)
    y, u = signals(outputs)

    def work():
        state, x_hat = filter_.init(RUNS), start["x0"]
        for k in range(STEPS):
            state, estimate = filter_.correct(k, state, y[k])
            x_hat = estimate.x_hat
            state = filter_.predict(k, state, u[k])
        return x_hat

    return work, RUNS * STEPS


def corrected(model, x, P, e, variances):
    """Return the Kalman correction of all runs, with a covariance of the measurement noise of every run."""
    CP = np.einsum("ij,rjk->rik", model.C, P)
    L = np.linalg.solve(np.einsum("rij,kj->rik", CP, model.C) + variances, CP).swapaxes(1, 2)
    return x + np.einsum("rij,rj->ri", L, e), P - np.einsum("rij,rjk->rik", L, CP)


def student(model, x, P, e):
    """Return estimates and covariances after a fixed number of corrections."""
    R, lam, inverse = model.R_v, np.ones(len(x)), np.linalg.inv(model.R_v)
    for step in range(ITERATIONS):
        x_hat, P_hat = corrected(model, x, P, e, R / lam[:, None, None])
        if step < ITERATIONS - 1:
            r = e - np.einsum("ij,rj->ri", model.C, x_hat - x)
            spread = np.einsum("ij,rjk,lk->ril", model.C, P_hat, model.C)
            total = np.einsum("ri,ij,rj->r", r, inverse, r) + np.einsum("ij,rji->r", inverse, spread)
            lam = (DOF + e.shape[1]) / (DOF + total)
    return x_hat, P_hat


def huber(model, x, P, e):
    """Return the minimum: clipped for one output, by reweighting until no run changes for more."""
    T = np.linalg.inv(np.linalg.cholesky(model.R_v))
    back = np.linalg.inv(T)
    if e.shape[1] == 1:
        G, R = np.einsum("ij,rjk,lk->ril", model.C, P, model.C)[:, :, 0], model.R_v.item()
        factor = np.clip(e / (G + R), -K / np.sqrt(R), K / np.sqrt(R))
        w = np.minimum(1.0, K / np.maximum(np.abs(e - G * factor) / np.sqrt(R), 1e-300))
        return corrected(model, x, P, e, (R / w)[:, :, None])
    w, x_hat = np.ones_like(e), x
    for _ in range(500):
        before = x_hat
        x_hat, P_hat = corrected(model, x, P, e, np.einsum("ij,rj,kj->rik", back, 1.0 / w, back))
        if np.abs(x_hat - before).max() < 1e-10:
            break
        r = np.einsum("ij,rj->ri", T, e - np.einsum("ij,rj->ri", model.C, x_hat - x))
        w = np.minimum(1.0, K / np.maximum(np.abs(r), 1e-300))
    return x_hat, P_hat


def plain(kind, outputs):
    """Run the filter in NumPy."""
    (model, start), (y, u) = system(outputs), signals(outputs)
    correct = {"student": student, "huber": huber}[kind]

    def work():
        x, P = np.tile(start["x0"], (RUNS, 1)), np.tile(start["P0"], (RUNS, 1, 1))
        for k in range(STEPS):
            x_hat, P = correct(model, x, P, y[k] - np.einsum("ij,rj->ri", model.C, x))
            x = np.einsum("ij,rj->ri", model.A, x_hat) + np.einsum("ij,rj->ri", model.B, u[k])
            P = np.einsum("ij,rjk,lk->ril", model.A, P, model.A) + model.Q_w
        return x_hat

    return work, RUNS * STEPS


def row(kind, outputs):
    """Return the row of a filter."""
    states = f"{2 * outputs} states, {outputs} output{'s' if outputs > 1 else ''}"
    name = f"{kind}-kalman, {states}"
    return Row(name, "run-step", lambda: ours(kind, outputs), lambda: plain(kind, outputs), "NumPy, all runs at once")


ROWS = [row(kind, outputs) for outputs in (1, 2) for kind in ("student", "huber")]
