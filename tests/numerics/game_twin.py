"""The plain twin of numerics/game_kernel.py: the same game with inverses, by searches instead of derivatives."""

import numpy as np
from scipy.optimize import minimize_scalar


def recursion(stages, M_w, price, *, alone=False):
    """Pi_0 of the game, or Y_0 of the maximiser alone; None where the price is too low."""
    N, n = stages.B.shape[:2]
    X = stages.Q[N - 1]
    for t in range(N - 1, -1, -1):
        if np.linalg.eigvals(M_w[t] @ X).real.max() >= price and alone:
            return None
        S_B = np.zeros((n, n)) if alone else stages.B[t] @ np.linalg.solve(stages.R[t], stages.B[t].T)
        Z = S_B - M_w[t] / price
        first = X @ np.linalg.inv(np.eye(n) + Z @ X)
        X = stages.A[t].T @ first @ stages.A[t] + (stages.Q[t - 1] if t else 0.0)
    return X


def bound(stages, M, M_w, x, price):
    """(least rho, tau_1) at one price of noise; inf outside the domain."""
    Y = recursion(stages, M_w, price, alone=True)
    if Y is None:
        return np.inf, np.nan
    S = recursion(stages, 0.0 * np.asarray(M_w), 1.0)
    Pi = recursion(stages, M_w, price)
    edge = np.linalg.eigvals(M @ Y).real.max()

    def cost(tau_1):
        K = Pi @ np.linalg.inv(np.eye(len(x)) - M @ Pi / tau_1)
        return tau_1 + price + x @ (K - S) @ x

    found = minimize_scalar(lambda log: cost(edge + np.exp(log)), bounds=(-40.0, 40.0), method="bounded",
                            options={"xatol": 1e-10})  # fmt: skip
    inside = edge + np.exp(found.x)
    return min((cost(edge * (1.0 + 1e-12)), edge), (cost(inside), inside))


def smallest_multiplier(stages, M_w):
    """Price at which the maximiser alone becomes unbounded, by halving."""
    low, high = 0.0, 1.0
    while recursion(stages, M_w, high, alone=True) is None:
        high *= 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if recursion(stages, M_w, middle, alone=True) is None else (low, middle)
    return high


def solve(stages, M, M_w, x):
    """(rho, tau_1, tau_2) by search over the price."""
    smallest = smallest_multiplier(stages, M_w)
    found = minimize_scalar(
        lambda s: bound(stages, M, M_w, x, smallest * (1.0 + np.exp(s)))[0],
        bounds=(-12.0, 12.0), method="bounded", options={"xatol": 1e-9},
    )  # fmt: skip
    price = smallest * (1.0 + np.exp(found.x))
    rho, tau_1 = bound(stages, M, M_w, x, price)
    return rho, tau_1, price
