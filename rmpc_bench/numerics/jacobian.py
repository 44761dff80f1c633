"""Jacobians of functions written by a user, by central differences.

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
