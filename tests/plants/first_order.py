"""Two cheaper ways to integrate the servomechanism, compiled, for comparison: both take substeps of equal length.

`first_order`: the linear part by its exact exponential, the friction as an impulse that is implicit in the velocity at
the end of a substep (projected Gauss-Seidel).  It sticks exactly; its error is proportional to the substep.
`runge_kutta`: the classical method of order four on the equations as printed, friction times sgn(w).  It never sticks.
"""

from collections.abc import Callable, Mapping, Sequence
from math import exp
from typing import Any

import numba
import numpy as np

from rmpc_bench.models.servo import NONLINEAR, with_current
from rmpc_bench.numerics.linalg import discretise

FRICTION = [name for name in NONLINEAR if name.startswith("alpha")]
SWEEPS = 50  # Gauss-Seidel needs 2 to 5: the coupling of the bodies over a substep is a few per mille

Step = Callable[[Any, Any], Any]


def first_order(rows: Sequence[Mapping[str, float]], Ts: float, substep: float) -> Step:
    """Return (x, u) -> x after a sample, for runs with the given parameters."""
    n = round(Ts / substep)
    sampled = [discretise(*with_current(p), Ts / n) for p in rows]
    E, G = np.stack([E for E, _ in sampled]), np.stack([G for _, G in sampled])
    alpha = np.array([[p[name] for name in FRICTION] for p in rows])
    return lambda x, u: _first_order_kernel(x, u, E, G, alpha, n)


def runge_kutta(rows: Sequence[Mapping[str, float]], Ts: float, substep: float) -> Step:
    """Return (x, u) -> x after a sample, for runs with the given parameters."""
    n = round(Ts / substep)
    continuous = [with_current(p) for p in rows]
    A, B = np.stack([A for A, _ in continuous]), np.stack([B for _, B in continuous])
    alpha = np.array([[p[name] for name in FRICTION] for p in rows])
    return lambda x, u: _runge_kutta_kernel(x, u, A, B, alpha, Ts / n, n)


@numba.njit(cache=True)
def _level(w, a0, a1, a2):
    return a0 + a1 * exp(-a2 * abs(w))


@numba.njit(cache=True)
def _impulse(x, free, G, alpha):
    """Add the friction torques to the frictionless end of a substep: |tau| <= F at rest, else tau = F sign(w)."""
    F_l, F_m = _level(x[1], alpha[0], alpha[1], alpha[2]), _level(x[3], alpha[3], alpha[4], alpha[5])
    W_ll, W_lm, W_ml, W_mm = -G[1, 1], -G[1, 2], -G[3, 1], -G[3, 2]
    tau_l = tau_m = 0.0
    for _ in range(SWEEPS):
        before_l, before_m = tau_l, tau_m
        tau_l = max(-F_l, min(F_l, (free[1] - W_lm * tau_m) / W_ll))
        tau_m = max(-F_m, min(F_m, (free[3] - W_ml * tau_l) / W_mm))
        if tau_l == before_l and tau_m == before_m:
            break
    stuck_l, stuck_m = abs(tau_l) < F_l, abs(tau_m) < F_m
    if not (stuck_l and x[1] == 0.0):
        x[0] = free[0] + G[0, 1] * tau_l + G[0, 2] * tau_m
    if not (stuck_m and x[3] == 0.0):
        x[2] = free[2] + G[2, 1] * tau_l + G[2, 2] * tau_m
    x[1] = 0.0 if stuck_l else free[1] - W_ll * tau_l - W_lm * tau_m
    x[3] = 0.0 if stuck_m else free[3] - W_ml * tau_l - W_mm * tau_m
    x[4] = free[4] + G[4, 1] * tau_l + G[4, 2] * tau_m


@numba.njit(cache=True)
def _first_order_kernel(x, u, E, G, alpha, n):
    x_next, free = x.copy(), np.empty(5)
    for row in range(x.shape[0]):
        state = x_next[row]
        for _ in range(n):
            for i in range(5):
                total = G[row, i, 0] * u[row, 0]
                for j in range(5):
                    total += E[row, i, j] * state[j]
                free[i] = total
            _impulse(state, free, G[row], alpha[row])
    return x_next


@numba.njit(cache=True)
def _slope(x, u, A, B, alpha, out):
    T_l = _level(x[1], alpha[0], alpha[1], alpha[2]) * np.sign(x[1])
    T_m = _level(x[3], alpha[3], alpha[4], alpha[5]) * np.sign(x[3])
    for i in range(5):
        out[i] = B[i, 0] * u + B[i, 1] * T_l + B[i, 2] * T_m
        for j in range(5):
            out[i] += A[i, j] * x[j]


@numba.njit(cache=True)
def _runge_kutta_kernel(x, u, A, B, alpha, h, n):
    x_next, y, s, total = x.copy(), np.empty(5), np.empty(5), np.empty(5)
    shares, ahead = np.array([1.0, 2.0, 2.0, 1.0]) * h / 6, np.array([h / 2, h / 2, h, 0.0])
    for row in range(x.shape[0]):
        state = x_next[row]
        for _ in range(n):
            total[:] = state
            y[:] = state
            for stage in range(4):
                _slope(y, u[row, 0], A[row], B[row], alpha[row], s)
                for i in range(5):
                    total[i] += shares[stage] * s[i]
                    y[i] = state[i] + ahead[stage] * s[i]
            state[:] = total
    return x_next
