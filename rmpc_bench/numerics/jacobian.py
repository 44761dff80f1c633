"""Jacobians of functions written by a user, by central differences, and zeros of such functions.

Method  D(h) = (f(x + h) - f(x - h)) / (2 h) for every coordinate, and one Richardson step (4 D(h) - D(2 h)) / 3, whose
        error is of fourth order in h; h is proportional to |x_i|.  Functions are called with real numbers only, so that
        abs, norms, interpolation tables, `float` and branches are differentiated as they are; a complex step gives
        wrong derivatives of these without a word.
Kinks   One-sided differences of second order, from the left and from the right, are compared.  They differ where the
        function has a kink or a jump.  Where they agree, but not with D, the second derivative has a jump, as that of
        x |x| at 0, or a kink is near: their mean is the derivative where this changes little in the function.
Fails   The Jacobian is NaN where the function is not finite within the steps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array

Function: TypeAlias = Callable[[Array], Array]

STEP = float(np.finfo(float).eps) ** 0.2
"""Relative step: rounding, eps / h, and truncation, h^4, are of the same size."""
ONE_SIDED = 1e-5
"""Relative step of the one-sided differences; their truncation error is about its square."""
DIFFERS = 1e-4
"""Relative difference of the one-sided derivatives that counts as a kink."""
NEGLIGIBLE = 1e-8
"""Coordinates smaller than this have no size of their own."""
ROUNDING = 1e-14
"""So have coordinates smaller than this relative to the largest one.  It is no larger than what rounding leaves of a
coordinate that is 0: states have different units, such as a pressure of 1e5 Pa and a flow of 1e-4 m^3/s."""
BEND = 1e-2
"""Difference of the central and the one-sided derivatives, relative to the terms of the function, up to which the
one-sided ones are taken."""
NOISE = 100.0
"""Rounding error of a function, in units of the rounding of its largest term."""


class Derivative(NamedTuple):
    """The Jacobian of a function at a point."""

    J: Float[Array, "m n"]
    kinks: tuple[int, ...]  # coordinates in whose direction the derivatives from the left and from the right differ


def sizes_of_coordinates(x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return |x_i|, to which steps are proportional; 1 for a coordinate of about 0."""
    size = np.abs(x)
    negligible = size <= max(NEGLIGIBLE, ROUNDING * float(size.max(initial=0.0)))
    return np.where(negligible, 1.0, size)


def jacobian(function: Function, x: Float[Array, " n"]) -> Float[Array, "m n"]:
    """Return the Jacobian at x, by 4 n calls with arrays of their own."""
    h = STEP * sizes_of_coordinates(x)
    columns = [
        (4.0 * _central(function, x, i, h[i]) - _central(function, x, i, 2.0 * h[i])) / 3.0 for i in range(len(x))
    ]
    return np.stack(columns, axis=1) if columns else np.zeros((len(_at(function, x)), 0))


def derivative(function: Function, x: Float[Array, " n"]) -> Derivative:
    """Return the Jacobian at x and the coordinates in whose direction there is a kink at x, by 8 n + 1 calls."""
    J = jacobian(function, x)
    size, f = sizes_of_coordinates(x), _at(function, x)
    # Terms that cancel at a steady state leave their rounding error.
    terms = np.abs(f) + np.nansum(np.abs(J) * size, axis=1)
    kinks = []
    for i in range(len(x)):
        h = ONE_SIDED * size[i]
        right, left = _one_sided(function, x, f, i, h), _one_sided(function, x, f, i, -h)
        mean = 0.5 * (left + right)
        same = DIFFERS * np.maximum(np.abs(left), np.abs(right)) + NOISE * np.finfo(float).eps * terms / h
        # The central difference has wider steps, so that it also meets a kink that is near.
        bent, off = np.abs(right - left) > same, np.abs(J[:, i] - mean)
        if (bent | ((off > same) & (off * size[i] > BEND * terms))).any():
            kinks.append(i)
        else:
            J[:, i] = np.where(off > same, mean, J[:, i])
    return Derivative(J, tuple(kinks))


def _at(function: Function, x: Float[Array, " n"]) -> Float[Array, " m"]:
    return np.array(function(x.copy()), dtype=float).reshape(-1)


def _moved(function: Function, x: Float[Array, " n"], i: int, step: float) -> Float[Array, " m"]:
    moved = x.copy()
    moved[i] += step
    return _at(function, moved)


def _central(function: Function, x: Float[Array, " n"], i: int, h: float) -> Float[Array, " m"]:
    # The difference of the points as they are stored, which is not exactly 2 h.
    span = float((x[i] + h) - (x[i] - h))
    difference: Array = _moved(function, x, i, h) - _moved(function, x, i, -h)
    return difference / span


def _one_sided(
    function: Function, x: Float[Array, " n"], f: Float[Array, " m"], i: int, h: float
) -> Float[Array, " m"]:
    """Return the derivative on the side of the sign of h."""
    return (4.0 * _moved(function, x, i, h) - _moved(function, x, i, 2.0 * h) - 3.0 * f) / (2.0 * h)


# Zeros of a function inside bounds, by a damped Newton method; used for steady states.
#
# Method  x <- x + t p with the step of least norm that solves J p = -f in the least-squares sense.  A coordinate on
#         which f does not depend keeps its first value.  p ends at the bounds; t = 1, 1/2, 1/4, .. until f is finite
#         and smaller.  Equations are weighted by the size of their terms, |f_i| + sum_j |J_ij| |x_j|.
# Fails   `converged` is False where no step makes f smaller although it is not yet of the size of rounding errors.

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
