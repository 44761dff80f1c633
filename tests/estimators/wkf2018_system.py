"""The plant wkf2018 with a white uncertain entry of A, and the exact error of a filter on it."""

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

WKF = {"A": [[0.9802, 0.0196], [0, 0.9802]], "C": [[1, -1]], "H_A": [[0.99], [0]], "G_x": [[0, 1]],
       "Bw": np.eye(2), "Dv": [[1.0]], "W": [[1.9608, 0.0195], [0.0195, 1.9605]], "V": 1.0}  # fmt: skip
"""Plant wkf2018 with a white d in [-1, 1]."""


def stationary_error(filter_, coefficient):
    """Mean square error of x_hat on wkf2018 with a white d of variance 1/3: one linear equation for [x; x_hat - x]."""
    A, C, W = np.array(WKF["A"]), np.array(WKF["C"]), np.array(WKF["W"])
    L, N = filter_.L[-1], np.array([[0.0, coefficient], [0.0, 0.0]])
    T = np.eye(2) - L @ C
    # x+ = (A + d N) x + w, error e = x_hat - x: e+ = T A e - d T N x - T w + L v.
    map_0 = np.block([[A, np.zeros((2, 2))], [np.zeros((2, 2)), T @ A]])
    map_d = np.block([[N, np.zeros((2, 2))], [-T @ N, np.zeros((2, 2))]])
    enters = np.vstack([np.eye(2), -T])
    Q = enters @ W @ enters.T
    Q[2:, 2:] += L @ L.T
    both = np.kron(map_0, map_0) + np.kron(map_d, map_d) / 3.0
    X = np.linalg.solve(np.eye(16) - both, Q.ravel()).reshape(4, 4)
    np.testing.assert_allclose(X, map_0 @ X @ map_0.T + map_d @ X @ map_d.T / 3.0 + Q, rtol=1e-9)
    if coefficient == 0.0:
        np.testing.assert_allclose(X[:2, :2], solve_discrete_lyapunov(A, W), rtol=1e-9)
    return np.trace(X[2:, 2:])
