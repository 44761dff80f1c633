"""Compiled square-root recursion of least-squares tracking; tracking.py defines the problem.

Backwards over the horizon, the minimal cost to go is |S x - s|^2 plus a constant.  Every stage adds the rows
Q_yw (C x - w), which Householder reflections reduce to a triangle, and then eliminates the input.  No matrix is
squared.  `path_kernel` keeps the rows [R, G, g] of R u(j) = g - G x(j) of every stage and computes all inputs forwards.
"""

from __future__ import annotations

from math import copysign, inf, nan, sqrt
from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled

# Smallest pivot divided by the largest of its stage: rounding of the factorisation.
SMALLEST = 1e-13


@compiled(error_model="numpy")
def _reflect(T: Any, pivot: int, first: int, last: int, column: int, end: int, dots: Any) -> float:  # pragma: no cover
    """Turn the entries of a column in the rows first..last-1 into 0 and move their length to the pivot row."""
    # Columns up to ``end`` go along. Returns the size of the new pivot.
    below = 0.0
    for r in range(first, last):
        below += T[r, column] * T[r, column]
    top = T[pivot, column]
    if below == 0.0:
        return float(abs(top))
    size = sqrt(top * top + below)
    v = top + copysign(size, top)
    scale = 2.0 / (v * v + below)
    for m in range(column + 1, end):
        dots[m] = v * T[pivot, m]
    for r in range(first, last):
        entry = T[r, column]
        for m in range(column + 1, end):
            dots[m] += entry * T[r, m]
    for m in range(column + 1, end):
        dots[m] *= scale
        T[pivot, m] -= v * dots[m]
    for r in range(first, last):
        entry = T[r, column]
        for m in range(column + 1, end):
            T[r, m] -= entry * dots[m]
        T[r, column] = 0.0
    T[pivot, column] = -copysign(size, top)
    return size


@compiled(error_model="numpy")
def _fold(S: Any, rows: int, C: Any, Q_yw: Any, w: Any, dots: Any) -> tuple[int, float]:  # pragma: no cover
    """Add the rows Q_yw (C x - w) to the ``rows`` of [S, s] and fold what is more than the states into a triangle."""
    # Returns how many rows there are now, and what is lost.
    ny, nx = C.shape
    S[rows : rows + ny] = 0.0
    for i in range(ny):
        for m in range(ny):
            for n in range(nx):
                S[rows + i, n] += Q_yw[i, m] * C[m, n]
            S[rows + i, nx] += Q_yw[i, m] * w[m]
    rows, lost = rows + ny, 0.0
    if rows < nx:
        return rows, lost
    for i in range(nx):
        _reflect(S, i, i + 1, rows, i, nx + 1, dots)
    for i in range(nx, rows):
        lost += S[i, nx] * S[i, nx]
    return nx, lost


@compiled(error_model="numpy")
def _stack(S: Any, rows: int, A: Any, B: Any, f: Any, R_u: Any, T: Any) -> None:  # pragma: no cover
    """Write [R_u, 0, 0] above [S B, S A, s - S f]."""
    nx, nu = B.shape
    T[: nu + rows] = 0.0
    T[:nu, :nu] = R_u
    for i in range(rows):
        T[nu + i, nu + nx] = S[i, nx]
        for j in range(i if rows == nx else 0, nx):  # as many rows as states are a triangle
            entry = S[i, j]
            for m in range(nu):
                T[nu + i, m] += entry * B[j, m]
            for m in range(nx):
                T[nu + i, nu + m] += entry * A[j, m]
            T[nu + i, nu + nx] -= entry * f[j]


@compiled(error_model="numpy")
def _eliminate(T: Any, nu: int, rows: int, end: int, dots: Any) -> bool:  # pragma: no cover
    """Free the rows below the first nu of the inputs, whose columns come first; whether these are determined."""
    smallest, largest = inf, 0.0
    for i in range(nu):
        pivot = _reflect(T, i, nu, nu + rows, i, end, dots)
        smallest, largest = min(smallest, pivot), max(largest, pivot)
    return smallest > SMALLEST * largest


@compiled(error_model="numpy")
def _track(
    A: Any, B: Any, f: Any, C: Any, Q_yw: Any, R_u: Any, w: Any, x: Any, u: Any, S: Any, T: Any, dots: Any, laws: Any
) -> float:  # pragma: no cover
    """Solve one problem: write its first input, NaN where it is not determined, and return the least cost."""
    # ``laws`` gets the rows of the inputs of all stages, unless it is empty; those of stage 0 without the state.
    nx, nu = B.shape
    rows, loss, determined = 0, 0.0, True
    for j in range(len(w) - 1, -1, -1):
        rows, lost = _fold(S, rows, C, Q_yw, w[j], dots)
        loss += lost
        _stack(S, rows, A, B, f, R_u, T)
        if j > 0:
            determined = _eliminate(T, nu, rows, nu + nx + 1, dots) and determined
            if len(laws) > 0:
                laws[j] = T[:nu]
            S[:rows] = T[nu : nu + rows, nu:]
    for i in range(nu, nu + rows):  # the state is known now
        total = T[i, nu + nx]
        for m in range(nx):
            total -= T[i, nu + m] * x[m]
        T[i, nu] = total
    determined = _eliminate(T, nu, rows, nu + 1, dots) and determined
    if len(laws) > 0:
        laws[0] = T[:nu]
    for i in range(nu, nu + rows):
        loss += T[i, nu] * T[i, nu]
    for i in range(nu - 1, -1, -1):
        total = T[i, nu]
        for m in range(i + 1, nu):
            total -= T[i, m] * u[m]
        u[i] = total / T[i, i]
    if not determined:
        u[:] = nan
    return loss


@compiled(error_model="numpy")
def tracking_kernel(
    A: Any, B: Any, f: Any, C: Any, Q_yw: Any, R_u: Any, w: Any, x: Any, u: Any, loss: Any
) -> None:  # pragma: no cover
    """Write first inputs and least costs of all rows of x, each by itself; A, B, Q_yw have one row for all or each."""
    nx, nu, ny = B.shape[1], B.shape[2], C.shape[0]
    S, T, dots = np.empty((nx + ny, nx + 1)), np.empty((nu + nx, nu + nx + 1)), np.empty(nu + nx + 1)
    nothing = np.empty((0, nu, nu + nx + 1))
    for row in range(len(x)):
        a, q = (row if len(A) > 1 else 0), (row if len(Q_yw) > 1 else 0)
        loss[row] = _track(A[a], B[a], f, C, Q_yw[q], R_u, w, x[row], u[row], S, T, dots, nothing)


@compiled(error_model="numpy")
def _forwards(A: Any, B: Any, f: Any, x: Any, laws: Any, U: Any, X: Any) -> None:  # pragma: no cover
    """Write the states X and, by the laws of their stages, the inputs after the first one, which is known."""
    nx, nu = B.shape
    for j in range(len(U)):
        before = x if j == 0 else X[j - 1]
        if j > 0:
            for i in range(nu - 1, -1, -1):
                total = laws[j, i, nu + nx]
                for m in range(nx):
                    total -= laws[j, i, nu + m] * before[m]
                for m in range(i + 1, nu):
                    total -= laws[j, i, m] * U[j, m]
                U[j, i] = total / laws[j, i, i]
        for i in range(nx):
            total = f[i]
            for m in range(nx):
                total += A[i, m] * before[m]
            for m in range(nu):
                total += B[i, m] * U[j, m]
            X[j, i] = total


@compiled(error_model="numpy")
def path_kernel(
    A: Any, B: Any, f: Any, C: Any, Q_yw: Any, R_u: Any, w: Any, x: Any, U: Any, X: Any, loss: Any, laws: Any
) -> None:  # pragma: no cover
    """Write all inputs, the states that they lead to and the least costs of all rows of x; otherwise as above."""
    nx, nu, ny = B.shape[1], B.shape[2], C.shape[0]
    S, T, dots = np.empty((nx + ny, nx + 1)), np.empty((nu + nx, nu + nx + 1)), np.empty(nu + nx + 1)
    for row in range(len(x)):
        a, q = (row if len(A) > 1 else 0), (row if len(Q_yw) > 1 else 0)
        loss[row] = _track(A[a], B[a], f, C, Q_yw[q], R_u, w, x[row], U[row, 0], S, T, dots, laws[row])
        _forwards(A[a], B[a], f, x[row], laws[row], U[row], X[row])
