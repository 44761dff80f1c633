"""Plain corrections of one run, in the space of the states and with inverses, against which the kernels are tested."""

import numpy as np
from numpy.linalg import cholesky, inv


def whitener(R):
    """T with T R T' = I."""
    return inv(cholesky(R))


def reweighted(x, P, C, R, e, w, v=None):
    """Kalman correction in information form with the weights w of T e, and v of the whitened x - x_pred."""
    T, T_x = whitener(R), whitener(P)
    v = np.ones(len(x)) if v is None else v
    information = T_x.T @ np.diag(v) @ T_x + C.T @ T.T @ np.diag(w) @ T @ C
    P_hat = inv(information)
    return x + P_hat @ C.T @ T.T @ np.diag(w) @ T @ e, P_hat


def student(x, P, C, R, e, dof, iterations):
    """x_hat, P and lam as the recursion is printed."""
    lam = 1.0
    for step in range(iterations):
        S = C @ P @ C.T + R / lam
        L = P @ C.T @ inv(S)
        x_hat, P_hat = x + L @ e, P - L @ S @ L.T
        r = e - C @ (x_hat - x)
        if step < iterations - 1:
            lam = (dof + len(e)) / (dof + np.trace(inv(R) @ (np.outer(r, r) + C @ P_hat @ C.T)))
    return x_hat, P_hat, lam


def huber_weight(r, k):
    return np.minimum(1.0, k / np.maximum(np.abs(r), 1e-300))


def correntropy_weight(r, sigma):
    return np.exp(-0.5 * (r / sigma) ** 2)


def iterated(x, P, C, R, e, weight, both, start, steps=20000):
    """x_hat, P and weights by plain reweighting, from the weights of the `kalman` correction or of the `prediction`."""
    T, T_x = whitener(R), whitener(P)
    w, v = np.ones(len(e)), np.ones(len(x))
    x_hat = x if start == "prediction" else reweighted(x, P, C, R, e, w, v)[0]
    for _ in range(steps):
        before = x_hat
        w = weight(T @ (e - C @ (x_hat - x)))
        v = weight(T_x @ (x_hat - x)) if both else v
        x_hat, P_hat = reweighted(x, P, C, R, e, w, v)
        if np.abs(x_hat - before).max() < 1e-15 * np.abs(x_hat).max():
            break
    return x_hat, P_hat, w


def gated(x, P, C, R, e, gate):
    """x_hat and P."""
    S = C @ P @ C.T + R
    if e @ inv(S) @ e > gate:
        return x, P, np.zeros(len(e))
    return *reweighted(x, P, C, R, e, np.ones(len(e))), np.ones(len(e))


def clipped(x, P, C, R, e, k, kept):
    """x_hat, P and weights of the clipped innovation."""
    S = C @ P @ C.T + R
    T = whitener(S)
    x_hat = x + P @ C.T @ T.T @ np.clip(T @ e, -k, k)
    return x_hat, P - kept * P @ C.T @ inv(S) @ C @ P, huber_weight(T @ e, k)


def filtered(model, x0, P0, y, u, correction):
    """Estimates and covariances of one run with a correction as above; ``correction(x, P, C, R, e)``."""
    x, P, found = x0, P0, []
    for k in range(len(y)):
        now = model.at(k)
        x, P, *_ = correction(x, P, now.C, now.R_v, y[k] - now.C @ x - now.d0)
        found.append((x, P))
        x, P = now.A @ x + now.B @ u[k] + now.f0, now.A @ P @ now.A.T + now.Q_w
    return tuple(np.array(each) for each in zip(*found, strict=True))
