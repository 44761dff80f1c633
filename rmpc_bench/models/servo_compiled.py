"""The servomechanism with inductance and dry friction: its equations of motion, and its kernel as a compiled plant.

Model   That of the plant `servo` (plants/servo.py): models/servo.py with L > 0 and dry friction on load and motor.
        The state is [th_l, w_l, th_m, w_m, I].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.models.servo import continuous
from rmpc_bench.models.servo_kernel import WORK, servo_advance, servo_points
from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.numerics.linear_loop_kernel import ROWS, first_state, ready, rows_kernel
from rmpc_bench.types import Array, CompiledPlant, Statuses

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


NO_SIZES = np.zeros(1, dtype=np.int64)


def compiled_servo(
    linear: Float[Array, "runs 9"], friction: Float[Array, "runs 2 3"], Ts: float, tolerance: float, status: Statuses
) -> CompiledPlant:
    """Return the plant for the compiled simulation.

    Parameters
    ----------
    linear, friction : coefficients of every run, see `models.servo_equations.coefficients`
    Ts : sampling time [s]
    tolerance : bound of the last terms of a Taylor series relative to its largest term
    status : of every run, from its parameters
    """
    own = np.zeros((len(linear), 3, 9))
    own[:, 0], own[:, 1:, :3] = linear, friction
    return CompiledPlant(servo_advance, first_state, own, np.array([[Ts, tolerance]]), NO_SIZES, WORK, status)


def servo_step(
    plant: CompiledPlant, x: Float[Array, "runs 5"], u: Float[Array, "runs 1"], w: Float[Array, "runs 4"]
) -> tuple[Float[Array, "runs 5"], Statuses]:
    """Return the states one sample later and the statuses of the kernel.

    Parameters
    ----------
    plant : the plant with the coefficients of the runs
    x, u, w : states, voltages [V] and process noise
    """
    x_next, status = np.empty(x.shape), np.zeros(len(x), np.int8)
    rows = ready(rows_kernel, ROWS)
    arrays = (as_compiled(each) for each in (x, u, w, plant.own, plant.shared))
    x, u, w, own, shared = arrays
    rows(plant.advance, 0, x, u, w, own, shared, plant.sizes, np.zeros(plant.work), x_next, status)
    return x_next, status


def servo_flow(
    linear: Float[Array, " 9"],
    friction: Float[Array, "2 3"],
    Ts: float,
    tolerance: float,
    x: Float[Array, "points 5"],
    u: Float[Array, "points 1"],
) -> tuple[Float[Array, "points 5"], Statuses]:
    """Return the states of one plant one sample later without noise, and the statuses of the kernel.

    Parameters
    ----------
    linear, friction : coefficients of the plant, see `models.servo_equations.coefficients`
    Ts : sampling time [s]
    tolerance : bound of the last terms of a Taylor series relative to its largest term
    x, u : states and voltages [V]
    """
    # No compiled function is passed to the kernel: finding its pointer costs as much as a hundred points.
    own, x_next, status = np.zeros((3, 9)), np.empty(x.shape), np.zeros(len(x), np.int8)
    own[0], own[1:, :3] = linear, friction
    x, u, shared = as_compiled(x), as_compiled(u), np.array([[Ts, tolerance]])
    servo_points(x, u, np.zeros(4), own, shared, NO_SIZES, np.zeros(WORK), x_next, status)
    return x_next, status


def servo_between(
    plant: CompiledPlant, x: Float[Array, "runs steps 5"], u: Float[Array, "runs steps 1"], parts: int
) -> Float[Array, "runs steps parts 5"]:
    """Return the states at the ends of equal parts of every control period, without process noise.

    Parameters
    ----------
    plant : the plant whose sampling time is one part of a period
    x, u : states at the beginning of the periods, and voltages [V]
    parts : number of parts per period
    """
    states, w = np.empty((*x.shape[:2], parts, x.shape[2])), np.zeros((len(x), 4))
    for k in range(x.shape[1]):
        now = x[:, k]
        for part in range(parts):
            now, _ = servo_step(plant, now, u[:, k], w)
            states[:, k, part] = now
    return states
