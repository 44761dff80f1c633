"""Compiled evaluation of tables of the soft-constrained linear-quadratic game; lq_game.py computes them.

At the boundary of the domain the solution of a run depends only on x_hat and s.  A table therefore contains functions
of s: Chebyshev series in z = (offset - middle) / half, where offset is s minus its optimum for x_hat = 0.  Rows of a
table (1 + 3 n^2, nodes): the slope D of a state (1 constant, n^2 of a quadratic form), times exp(2 offset), so that it
is nearly constant; e' M^-1 e (n^2 of a quadratic form); ``first`` (n^2 of a matrix).

Imported at the first step only, as game_kernel.py, and for the same reason without calls into another file.
"""

from __future__ import annotations

from math import log, nan
from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled

MOST_STEPS = 30  # four to five are usual
# Largest ratio of the terms of the slope to the slope: beyond it three digits are lost by cancellation.
CANCELLED = 1e3
# Share of the half width in which a table is valid; the last node is at 0.9994.
REACH = 0.999


@compiled(error_model="numpy")
def _series(c: Any, z: float) -> float:  # pragma: no cover
    """Evaluate a Chebyshev series at z by Clenshaw's recursion."""
    a, b = 0.0, 0.0
    for j in range(len(c) - 1, 0, -1):
        a, b = 2.0 * z * a - b + c[j], a
    return float(z * a - b + c[0])


@compiled(error_model="numpy")
def _looked_up(table: Any, middle: float, half: float, x: Any, first: Any, c: Any) -> bool:  # pragma: no cover
    """Solve one problem; return whether the result is valid: s in the table, tau_1 on the boundary of the domain."""
    n, offset, last_offset, last = len(x), 0.0, nan, nan
    for m in range(len(c)):  # loops: operations with whole arrays take seconds to compile
        c[m] = table[0, m]
    for i in range(n):
        for j in range(n):
            for m in range(len(c)):
                c[m] += x[i] * x[j] * table[1 + n * i + j, m]
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


@compiled(error_model="numpy")
def lookup_kernel(table: Any, middle: float, half: float, x: Any, first: Any, holds: Any) -> None:  # pragma: no cover
    """Write ``first`` for every row of x, and whether it is valid."""
    c = np.empty(table.shape[1])
    for row in range(len(x)):
        holds[row] = _looked_up(table, middle, half, x[row], first[row], c)
