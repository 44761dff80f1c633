"""Zeros of a function inside bounds, by a damped Newton method; used for steady states.

Method  x <- x + t p with the step of least norm that solves J p = -f in the least-squares sense.  A coordinate on
        which f does not depend keeps its first value.  p ends at the bounds; t = 1, 1/2, 1/4, .. until f is finite and
        smaller.  Equations are weighted by the size of their terms, |f_i| + sum_j |J_ij| |x_j|.
Fails   `converged` is False where no step makes f smaller although it is not yet of the size of rounding errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.jacobian import Function, jacobian, sizes_of_coordinates
from rmpc_bench.types import Array

ITERATIONS = 200
HALVINGS = 40
INSIDE = 0.9
"""Largest part of the way to a bound that one step may go; at the bound the function may have no derivative."""
POLISHING = 3
"""Steps that are taken after the residual has become small, while they make it smaller."""
SMALL = 1e-12
"""Residual relative to the terms of its equation that counts as zero."""
RANK = 1e-12
"""Singular values below this, relative to the largest one, count as 0."""


class Zero(NamedTuple):
    """A zero of a function, or the best point that was found."""

    x: Float[Array, " n"]
    residual: float  # largest |f_i|
    converged: bool
    iterations: int


def find_zero(function: Function, x: Float[Array, " n"], low: Float[Array, " n"], high: Float[Array, " n"]) -> Zero:
    """Find a zero of a function inside bounds.

    The function may be NaN outside of its domain, but not at the first point, which is inside the bounds.
    """
    x, f, polished = x.copy(), np.array(function(x.copy()), dtype=float), 0
    for count in range(ITERATIONS):
        J = jacobian(function, x)
        if not (np.isfinite(f).all() and np.isfinite(J).all()):
            return Zero(x, _largest(f), False, count)
        terms = np.abs(f) + np.abs(J) @ sizes_of_coordinates(x)
        weight = 1.0 / np.where(terms > 0.0, terms, 1.0)
        small = bool((np.abs(f) * weight <= SMALL).all())
        polished += small
        size = sizes_of_coordinates(x)
        step = size * np.linalg.lstsq(weight[:, None] * J * size, -weight * f, rcond=RANK)[0]
        moved = _shorter(function, x, step * _part_inside(x, step, low, high), weight, f)
        if moved is None or polished > POLISHING or not np.isfinite(step).all():
            return Zero(x, _largest(f), small, count)
        x, f = moved
    return Zero(x, _largest(f), False, ITERATIONS)


def _shorter(
    function: Function, x: Array, step: Array, weight: Array, f: Array
) -> tuple[Float[Array, " n"], Float[Array, " m"]] | None:
    """Return the first point on the way at which f is smaller, and f; None where there is none."""
    before = float(np.linalg.norm(weight * f))
    for halving in range(HALVINGS):
        point = x + 0.5**halving * step
        if np.array_equal(point, x):
            return None
        now = np.array(function(point.copy()), dtype=float)
        if np.isfinite(now).all() and float(np.linalg.norm(weight * now)) < before:
            return point, now
    return None


def _part_inside(x: Array, step: Array, low: Array, high: Array) -> float:
    """Return the largest part of a step, 1 at most, that stays inside the bounds."""
    room = np.where(step > 0.0, high - x, x - low)
    length = np.abs(step)
    ends = INSIDE * room < length
    return float(min(1.0, (INSIDE * room[ends] / length[ends]).min(initial=1.0)))


def _largest(f: Array) -> float:
    return float(np.abs(f).max(initial=0.0))
