"""The servomechanism as a compiled plant: its kernel with the coefficients of the runs.

The module is imported at the first step only, as it loads numba.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.servo_kernel import WORK, servo_advance, servo_points
from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.numerics.linear_loop_kernel import ROWS, ready, rows_kernel
from rmpc_bench.types import Array, Statuses, StepFunction

NO_SIZES = np.zeros(1, dtype=np.int64)


def compiled_servo(
    linear: Float[Array, "runs 9"], friction: Float[Array, "runs 2 3"], Ts: float, tolerance: float
) -> StepFunction:
    """Return the step for the compiled simulation; `tolerance` bounds the last terms of a Taylor series, relative."""
    own = np.zeros((len(linear), 3, 9))
    own[:, 0], own[:, 1:, :3] = linear, friction
    return StepFunction(servo_advance, own, np.array([[Ts, tolerance]]), NO_SIZES, WORK)


def servo_step(
    plant: StepFunction, x: Float[Array, "runs 5"], u: Float[Array, "runs 1"], w: Float[Array, "runs 4"]
) -> tuple[Float[Array, "runs 5"], Statuses]:
    """Return the states one sample later, for voltages u [V], and the statuses of the kernel."""
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

    `tolerance` bounds the last terms of a Taylor series relative to its largest term; inputs are voltages [V].
    """
    # No compiled function is passed to the kernel: finding its pointer costs as much as a hundred points.
    own, x_next, status = np.zeros((3, 9)), np.empty(x.shape), np.zeros(len(x), np.int8)
    own[0], own[1:, :3] = linear, friction
    x, u, shared = as_compiled(x), as_compiled(u), np.array([[Ts, tolerance]])
    servo_points(x, u, np.zeros(4), own, shared, NO_SIZES, np.zeros(WORK), x_next, status)
    return x_next, status


def servo_between(
    plant: StepFunction, x: Float[Array, "runs steps 5"], u: Float[Array, "runs steps 1"], parts: int
) -> Float[Array, "runs steps parts 5"]:
    """Return the states at the ends of equal parts, the steps of `plant`, of every period, without process noise."""
    states, w = np.empty((*x.shape[:2], parts, x.shape[2])), np.zeros((len(x), 4))
    for k in range(x.shape[1]):
        now = x[:, k]
        for part in range(parts):
            now, _ = servo_step(plant, now, u[:, k], w)
            states[:, k, part] = now
    return states
