"""Compiled loops over windows of bounded noises; bounded_window.py defines the quantities.

Axis 0 is the run.  A window has places for the largest number of points; those before ``first`` are not used.
"""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled

# Rounding of an output relative to the sum of its terms, about 2e-16 per term.
ROUNDING = 4e-15


@compiled(error_model="numpy")
def path_kernel(
    y: Any, A: Any, c: Any, start: Any, C: Any, first: int, anchored: bool, path: Any, d: Any
) -> None:  # pragma: no cover
    """Write the states that follow from the first one without noise, and the differences of the outputs."""
    runs, points, ny = y.shape
    nx, last = c.shape[2], len(C) - 1
    for run in range(runs):
        for j in range(first, points):
            place = j - first
            for i in range(nx):
                if j == first and not anchored:  # the estimate that the next pair starts from
                    total = start[run, first + 1, i]
                else:
                    total = c[run, j, i]
                    for m in range(nx):
                        before = start[run, first, m] if j == first else path[run, place - 1, m]
                        total += A[run, j, i, m] * before
                path[run, place, i] = total
            for o in range(ny):
                total, size = y[run, j, o], abs(y[run, j, o])
                for m in range(nx):
                    term = C[min(place, last), o, m] * path[run, place, m]
                    total -= term
                    size += abs(term)
                d[run, place * ny + o] = 0.0 if abs(total) <= ROUNDING * size < inf else total


@compiled(error_model="numpy")
def reduced_kernel(A: Any, C: Any, first: int, F: Any, moved: Any) -> None:  # pragma: no cover
    """Write outputs per first state, F, and last state per first state, for a window without process noise."""
    runs, points, nx = A.shape[:3]
    ny, last = C.shape[1], len(C) - 1
    now, then = np.empty((nx, nx)), np.empty((nx, nx))
    for run in range(runs):
        for i in range(nx):
            for m in range(nx):
                now[i, m] = 1.0 if i == m else 0.0
        for j in range(first, points):
            place = j - first
            if place > 0:
                for i in range(nx):
                    for m in range(nx):
                        then[i, m] = 0.0
                        for s in range(nx):
                            then[i, m] += A[run, j, i, s] * now[s, m]
                for i in range(nx):
                    for m in range(nx):
                        now[i, m] = then[i, m]
            for o in range(ny):
                for m in range(nx):
                    F[run, place * ny + o, m] = 0.0
                    for s in range(nx):
                        F[run, place * ny + o, m] += C[min(place, last), o, s] * now[s, m]
        for i in range(nx):
            for m in range(nx):
                moved[run, i, m] = now[i, m]


@compiled(error_model="numpy")
def multiplier_kernel(A: Any, C: Any, first: int, mu: Any, price: Any) -> None:  # pragma: no cover
    """Write the sums over the window of |lam_i|."""
    runs, points, nx = A.shape[:3]
    ny, last = C.shape[1], len(C) - 1
    lam, then = np.empty(nx), np.empty(nx)
    for run in range(runs):
        for i in range(nx):
            price[run, i] = lam[i] = 0.0
        for j in range(points - 1, first, -1):
            place = j - first
            for i in range(nx):
                then[i] = 0.0
                if j < points - 1:
                    for m in range(nx):
                        then[i] += A[run, j + 1, m, i] * lam[m]
                for o in range(ny):
                    then[i] += C[min(place, last), o, i] * mu[run, place * ny + o]
            for i in range(nx):
                lam[i] = then[i]
                price[run, i] += abs(lam[i])
