"""Design of the Wasserstein filter: 1000 steps on a system with two states and one output that does not vary.

The plain program solves every saddle point from the nominal covariance by Frank-Wolfe, with functions of SciPy for the
secular equation and for the step, and does not stop when the filter is steady.  Both return tr P of some steps.
"""

import numpy as np

from perf.row import Row
from rmpc_bench.estimators import wasserstein_kalman
from rmpc_bench.models.linear import LinearModel

STEPS, RADIUS = 1000, 0.1
SHORT = 200
"""Steps of the plain program, which takes as long for each of them."""
MODEL = LinearModel(
    [[0.9802, 0.0196], [0.0, 0.9802]], np.zeros((2, 1)), [[1.0, -1.0]], [[1.9608, 0.0195], [0.0195, 1.9605]], [[1.0]]
)


def ours():
    """Return the design of the bench."""

    def work():
        made = wasserstein_kalman.design(MODEL, STEPS, x0=np.zeros(2), P0=np.eye(2), radius=RADIUS)
        return np.trace(made.P, axis1=1, axis2=2)[:SHORT:4]

    return work, STEPS + 1


def plain():
    """Return the same design as a script."""
    from scipy.optimize import brentq, minimize_scalar

    A, C, Q, R, exact = MODEL.A, MODEL.C, MODEL.Q_w, MODEL.R_v, {"xatol": 1e-12}

    def value(S):
        return np.trace(S[:2, :2] - S[:2, 2:] @ np.linalg.solve(S[2:, 2:], S[2:, :2]))

    def saddle_point(Sigma):
        S = Sigma
        for _ in range(100):
            T = np.hstack([np.eye(2), -S[:2, 2:] @ np.linalg.inv(S[2:, 2:])])
            d, U = np.linalg.eigh(T.T @ T)
            s, top = np.einsum("ij,ik,kj->j", U, Sigma, U), d[-1]
            low, high = (top * (1.0 + np.sqrt(each) / RADIUS) for each in (s[-1], np.trace(Sigma)))
            gamma = brentq(lambda g, d=d, s=s: np.sum(s * (d / (g - d)) ** 2) - RADIUS**2, low, high, xtol=1e-13 * top)
            M = (U * (gamma / (gamma - d))) @ U.T
            D = M @ Sigma @ M - S
            if np.trace(T @ D @ T.T) <= 1e-12 * value(S):
                break
            found = minimize_scalar(
                lambda t, S=S, D=D: -value(S + t * D), bounds=(0.0, 1.0), method="bounded", options=exact
            )
            S = S + found.x * D
        return S

    def work():
        P_pred, traces = np.eye(2), []
        for _ in range(SHORT):
            cross = P_pred @ C.T
            S = saddle_point(np.block([[P_pred, cross], [cross.T, C @ cross + R]]))
            P = S[:2, :2] - S[:2, 2:] @ np.linalg.solve(S[2:, 2:], S[2:, :2])
            P_pred = A @ P @ A.T + Q
            traces.append(np.trace(P))
        return np.array(traces)[::4]

    return work, SHORT


ROWS = [
    # Each side is exact to the root of its duality gap, 1e-10 and 1e-12.
    Row("Wasserstein filter, design", "step", ours, plain, "NumPy and SciPy, step by step", tolerance=1e-5),
]
