"""Compiled lookup in tables of the soft-constrained linear-quadratic game; game_table.py makes them.

On the edge of the domain the optimum depends on the run by x_hat alone, and all else by s: so functions of s stand in a
table, Chebyshev series in z = (offset - middle) / half, where offset is s less its optimum for x_hat = 0.  Rows of a
table (1 + 3 n^2, nodes): what makes the slope D of a state (1, then n^2 of a quadratic form), times exp(2 offset), so
that it is nearly constant; e' M^-1 e (n^2); ``first`` (n^2, a matrix).

Imported at the first step only, as game_kernel.py is, and for the same reason without calls into another file.
"""

from __future__ import annotations

from math import log, nan
from typing import Any

import numba
import numpy as np

MOST_STEPS = 30  # four to five are usual
CANCELLED = 1e3  # times the slope; where its terms are larger it has lost three digits
REACH = 0.999  # of a window: beyond its last node, at 0.9994, nothing has been looked at


@numba.njit(cache=True, error_model="numpy")
def _series(c: Any, z: float) -> float:  # pragma: no cover
    """Sum a Chebyshev series at z."""
    a, b = 0.0, 0.0
    for j in range(len(c) - 1, 0, -1):
        a, b = 2.0 * z * a - b + c[j], a
    return float(z * a - b + c[0])


@numba.njit(cache=True, error_model="numpy")
def _looked_up(table: Any, middle: float, half: float, x: Any, first: Any, c: Any) -> bool:  # pragma: no cover
    """Solve one problem; whether the answer holds: found inside the window, with tau_1 on the edge of the domain."""
    n, offset, last_offset, last = len(x), 0.0, nan, nan
    c[:] = table[0]
    for i in range(n):
        for j in range(n):
            c += x[i] * x[j] * table[1 + n * i + j]
    for number in range(MOST_STEPS):
        slope = _series(c, (offset - middle) / half)
        if not slope > 0.0:
            return False
        value = log(slope) - 2.0 * offset
        step = 0.5 * value if number == 0 else -value * (offset - last_offset) / (value - last)
        last_offset, last, offset = offset, value, offset + step
        if not abs(offset - middle) <= REACH * half:
            return False
        if abs(step) <= 1e-12:
            break
    z, size, terms = (offset - middle) / half, 0.0, _series(table[0], (offset - middle) / half)
    for i in range(n):
        first[i] = 0.0
        for j in range(n):
            terms += abs(x[i] * x[j] * _series(table[1 + n * i + j], z))
            size += x[i] * x[j] * _series(table[1 + n * n + n * i + j], z)
            first[i] += _series(table[1 + 2 * n * n + n * i + j], z) * x[j]
    return size <= 1.0 and terms <= CANCELLED * _series(c, z)


@numba.njit(cache=True, error_model="numpy")
def lookup_kernel(table: Any, middle: float, half: float, x: Any, first: Any, holds: Any) -> None:  # pragma: no cover
    """Write ``first`` for every row of x, and whether it holds."""
    c = np.empty(table.shape[1])
    for row in range(len(x)):
        holds[row] = _looked_up(table, middle, half, x[row], first[row], c)
