"""The compiled inner loop of the servomechanism: rows of a block over the substeps of one sample.

The module is imported at the first step only, because it brings numba along.
"""

from __future__ import annotations

from math import exp
from typing import Any

import numba
import numpy as np

_SWEEPS = 50  # Gauss-Seidel needs 2 to 5; the coupling of the two bodies over a substep is a few per mille


@numba.njit(cache=True)
def _friction_level(w: float, a0: float, a1: float, a2: float) -> float:  # pragma: no cover
    """Largest friction torque at velocity w, the peak of (20), (21); at rest the bound of the sticking torque."""
    return a0 + a1 * exp(-a2 * abs(w))


@numba.njit(cache=True)
def _clip(value: float, bound: float) -> float:  # pragma: no cover
    return max(-bound, min(bound, value))


@numba.njit(cache=True)
def _substep(x: Any, free: Any, G: Any, alpha: Any) -> None:  # pragma: no cover
    """Add the friction torques to the frictionless end ``free`` of a substep and write the end state into ``x``.

    The torques tau are constant over the substep, lie in [-F, F] and are complementary to the velocities at its end:
    a body either ends at rest with |tau| <= F or slips with tau = F sign(w).
    """
    F_l = _friction_level(x[1], alpha[0], alpha[1], alpha[2])
    F_m = _friction_level(x[3], alpha[3], alpha[4], alpha[5])
    W_ll, W_lm, W_ml, W_mm = -G[1, 1], -G[1, 2], -G[3, 1], -G[3, 2]
    tau_l = tau_m = 0.0
    for _ in range(_SWEEPS):
        before_l, before_m = tau_l, tau_m
        tau_l = _clip((free[1] - W_lm * tau_m) / W_ll, F_l)
        tau_m = _clip((free[3] - W_ml * tau_l) / W_mm, F_m)
        if tau_l == before_l and tau_m == before_m:
            break
    stuck_l, stuck_m = abs(tau_l) < F_l, abs(tau_m) < F_m
    held_l, held_m = stuck_l and x[1] == 0.0, stuck_m and x[3] == 0.0
    if not held_l:  # a body at rest at both ends has not moved in between
        x[0] = free[0] + G[0, 1] * tau_l + G[0, 2] * tau_m
    if not held_m:
        x[2] = free[2] + G[2, 1] * tau_l + G[2, 2] * tau_m
    x[1] = 0.0 if stuck_l else free[1] - W_ll * tau_l - W_lm * tau_m
    x[3] = 0.0 if stuck_m else free[3] - W_ml * tau_l - W_mm * tau_m
    x[4] = free[4] + G[4, 1] * tau_l + G[4, 2] * tau_m


@numba.njit(cache=True)
def servo_step_kernel(x: Any, u: Any, E: Any, G: Any, alpha: Any, n_substeps: int) -> Any:  # pragma: no cover
    """Move every row of ``x`` (runs, 5) over one sample with the voltage ``u`` (runs, 1) held.

    ``E`` (runs, 5, 5) and ``G`` (runs, 5, 3) sample the linear part over a substep; the columns of ``G`` are the
    voltage and the two friction torques.  ``alpha`` (runs, 6) holds the friction parameters.
    """
    x_next = x.copy()
    free = np.empty(5)
    for row in range(x.shape[0]):
        state = x_next[row]
        for _ in range(n_substeps):
            for i in range(5):
                total = G[row, i, 0] * u[row, 0]
                for j in range(5):
                    total += E[row, i, j] * state[j]
                free[i] = total
            _substep(state, free, G[row], alpha[row])
    return x_next
