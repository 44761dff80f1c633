"""Equations of motion of the servomechanism with inductance and dry friction, as the compiled kernel takes them.

Model   That of the plant `servo` (plants/servo.py): models/servo.py with L > 0 and dry friction on load and motor.
        The state is [th_l, w_l, th_m, w_m, I].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.models.servo import continuous
from rmpc_bench.types import Array

TOLERANCE = 1e-15
"""Last terms of a Taylor series relative to its largest term: rounding, for a third more time than with 1e-9."""
MOST_RATE = 20_000.0
"""Largest |eigenvalue| Ts of the linear part: about 5000 Taylor series, 10 ms per run and sample."""
INDUCTANCE = 0.8
"""Nominal armature inductance [H]."""
FRICTION: Mapping[str, float] = {
    "alpha_l0": 0.5,
    "alpha_l1": 10.0,
    "alpha_l2": 0.5,
    "alpha_m0": 0.1,
    "alpha_m1": 2.0,
    "alpha_m2": 0.5,
}
"""Nominal friction of load (l) and motor (m): torques [N m] and decay rates [s/rad]."""


def coefficients(p: Mapping[str, Any]) -> tuple[Float[Array, "*runs 9"], Float[Array, "*runs 2 3"]]:
    """Coefficients of the equations of motion in the order of the kernel, torques divided by inertias.

    The parameters are numbers, or arrays with one number per run.

    First array: twist th_m / rho - th_l, load (twist, w_l), motor (twist, w_m, I), current (I, w_m, V).  Second array:
    friction, rows load and motor, columns alpha_0 to alpha_2.
    """
    load, motor, current = p["J_l"], p["J_m"], p["L"]
    linear = [1.0 / p["rho"], p["k_theta"] / load, p["beta_l"] / load]
    linear += [p["k_theta"] / p["rho"] / motor, p["beta_m"] / motor, p["K_t"] / motor]
    linear += [p["R"] / current, p["K_t"] / current, 1.0 / current]
    friction = [[p[f"alpha_{b}0"] / J, p[f"alpha_{b}1"] / J, p[f"alpha_{b}2"]] for b, J in (("l", load), ("m", motor))]
    return np.stack(linear, axis=-1), np.stack([np.stack(row, axis=-1) for row in friction], axis=-2)


def with_current(p: Mapping[str, float]) -> tuple[Float[Array, "5 5"], Float[Array, "5 3"]]:
    """Continuous-time matrices of the linear part with inductance; inputs [V, T_fl, T_fm]."""
    A, B = np.zeros((5, 5)), np.zeros((5, 3))
    A[:4, :4] = continuous(p)[0]
    A[3, 3] = -p["beta_m"] / p["J_m"]
    A[3, 4] = p["K_t"] / p["J_m"]
    A[4, 3], A[4, 4] = -p["K_t"] / p["L"], -p["R"] / p["L"]
    B[4, 0], B[1, 1], B[3, 2] = 1.0 / p["L"], -1.0 / p["J_l"], -1.0 / p["J_m"]
    return A, B


def surely_slow_enough(linear: Float[Array, "runs 9"], Ts: float) -> Bool[Array, " runs"]:
    """Whether a bound of the fastest mode, the largest sum of a row of the matrix, is half the limit or less.

    Parameters
    ----------
    linear : first array of `coefficients`
    Ts : sampling time [s]
    """
    l_0, l_1, l_2, m_3, m_4, m_5, i_6, i_7, _ = linear.T
    sums = [np.ones_like(l_0), l_1 * (1.0 + l_0) + l_2, m_3 * (1.0 + l_0) + m_4 + m_5, i_6 + i_7]
    # False for NaN.
    return np.asarray(np.max(sums, axis=0) * Ts <= 0.5 * MOST_RATE)


def slow_enough(rows: Sequence[Mapping[str, float]], Ts: float) -> Bool[Array, " runs"]:
    """Whether the fastest mode of the linear part of each run is within the range of the kernel.

    Parameters
    ----------
    rows : parameters of every run
    Ts : sampling time [s]
    """
    if not rows:
        return np.ones(0, dtype=bool)
    A = np.stack([with_current(p)[0] for p in rows])
    finite = np.isfinite(A).all(axis=(1, 2))
    rates = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], A, 0.0))).max(axis=1)
    return np.asarray(finite & (rates * Ts <= MOST_RATE))
