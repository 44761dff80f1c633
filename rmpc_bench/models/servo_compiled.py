"""The servomechanism as a compiled plant: its kernel with the coefficients of the runs; it loads numba."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.servo_kernel import WORK, servo_advance, servo_points
from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.numerics.linear_loop_kernel import ROWS, ready, rows_kernel
from rmpc_bench.types import Array, Statuses, StepFunction

TOLERANCE = 1e-15
"""Last terms of a Taylor series relative to its largest term: rounding, for a third more time than with 1e-9."""
NO_SIZES = np.zeros(1, dtype=np.int64)


def compiled_servo(coefficients: Float[Array, "runs 3 9"], Ts: float, tolerance: float = TOLERANCE) -> StepFunction:
    """Return the step for the compiled simulation; `tolerance` bounds the last terms of a Taylor series, relative."""
    return StepFunction(servo_advance, coefficients, np.array([[Ts, tolerance]]), NO_SIZES, WORK)


def servo_step(
    plant: StepFunction, x: Float[Array, "runs 5"], u: Float[Array, "runs 1"], w: Float[Array, "runs 4"]
) -> tuple[Float[Array, "runs 5"], Statuses]:
    """Return the states one sample later, for voltages u [V], and the statuses of the kernel."""
    x_next, status = np.empty(x.shape), np.zeros(len(x), np.int8)
    rows = ready(rows_kernel, ROWS)
    x, u, w, own, shared = map(as_compiled, (x, u, w, plant.own, plant.shared))
    rows(plant.advance, 0, x, u, w, own, shared, plant.sizes, np.zeros(plant.work), x_next, status)
    return x_next, status


def servo_flow(
    plant: StepFunction, x: Float[Array, "points 5"], u: Float[Array, "points 1"]
) -> tuple[Float[Array, "points 5"], Statuses]:
    """Do the same for the plant of one run at many points, without noise."""
    # No compiled function is passed to the kernel: finding its pointer costs as much as a hundred points.
    x_next, status = np.empty(x.shape), np.zeros(len(x), np.int8)
    x, u, own = map(as_compiled, (x, u, plant.own[0]))
    servo_points(x, u, np.zeros(4), own, plant.shared, plant.sizes, np.zeros(plant.work), x_next, status)
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
