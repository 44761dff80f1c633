"""Compiled minimax fits by the simplex method on the dual; minimax.py defines the problem.

Phases
    1  scale the data by powers of two                       _scaled
    2  first basis: points chosen by elimination             _picked
    3  inverse of the basis, values and multipliers          _anew, _inverted
    4  simplex steps until no column improves the objective  _climbed, _exchanged, _entering, _leaving
    5  check of the duality gap                              _judged
    6  one problem; all rows                                 _fitted; minimax_kernel

Dual    Maximise sum d_i mu_i, F' mu = 0, sum over the points of group g of |mu_i| <= 1: one row per unknown and group.
        A column is a point with a sign s, (s F_i, e_g) of value |mu_i| and objective s d_i, or the slack (0, e_g) of a
        group.  The multipliers are (x, r), so that the point with the largest |d_i - F_i x| - r_g enters.
Start   The columns of F and d are divided by powers of two close to their sizes.  Elimination selects as many points as
        the rank of F, with mu = 0, in addition to the slacks; x interpolates these points.
Steps   If a point with mu = 0 would give a step of length zero, and the slack of its group is in the basis (r_g = 0),
        the sign of the point changes instead.  After many steps Bland's rule chooses the columns, which excludes
        cycles.
End     All quantities are recomputed from the last basis and the data.  Every feasible mu gives a lower bound of the
        optimum and every x an upper bound; their difference bounds the error of the result.
"""

from __future__ import annotations

from math import frexp, inf, ldexp
from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled

VALUE, DELTA, PI, GAIN, SIGN, SUM = 0, 1, 2, 3, 4, 5  # rows of V, one entry per column of the basis
UNIQUE, OPTIMAL, FAILED = 0, 1, 2
RANK = 1e-10  # remainder of a column of size 1 below which it depends on the others
NONE = 1e-14  # the same for a remainder that is rounding
PIVOT = 1e-9  # smallest pivot; smaller ones make the inverse inaccurate
OPEN = 1e-12  # residual beyond r that counts as zero, relative to d and to the terms F x
CLOSED = 1e-11  # largest difference of the two bounds at the end, relative to d and to the terms F x
SURE = 1e-6  # largest such difference relative to the optimum
ZERO = 1e-9  # a dual value below it counts as 0; dual values are of size 1


@compiled(error_model="numpy")
def _scaled(F: Any, d: Any, A: Any, b: Any, size: Any) -> bool:  # pragma: no cover
    """Divide columns and data by powers of two; the exponents are written to size, that of d last."""
    n, p = F.shape
    for j in range(p + 1):
        largest = 0.0
        for i in range(n):
            entry = abs(F[i, j]) if j < p else abs(d[i])
            if not entry < inf:
                return False
            largest = max(largest, entry)
        size[j] = frexp(largest)[1]
    for i in range(n):
        for j in range(p):
            A[i, j] = ldexp(F[i, j], -size[j])
        b[i] = ldexp(d[i], -size[p])
    return True


@compiled(error_model="numpy")
def _picked(A: Any, W: Any, basis: Any, n_columns: int) -> int:  # pragma: no cover
    """Select as many points as the rank of A for the basis; UNIQUE for full rank, FAILED if the rank is uncertain."""
    n, p = A.shape
    for j in range(p):
        basis[j] = -1
        for i in range(n):
            W[i, j] = A[i, j]
    for _ in range(p):
        row, column, largest = -1, -1, RANK
        for j in range(p):
            if basis[j] < 0:
                for i in range(n):
                    if abs(W[i, j]) > largest:
                        row, column, largest = i, j, abs(W[i, j])
        if row < 0:
            break
        basis[column] = row
        for i in range(n):
            if i != row:
                factor = W[i, column] / W[row, column]
                for j in range(p):
                    W[i, j] -= factor * W[row, j]
        for j in range(p):
            W[row, j] = 0.0
    rank = UNIQUE
    for j in range(p):
        if basis[j] < 0:  # an artificial column, which stays at 0
            basis[j] = n_columns + j
            rank = max(rank, OPTIMAL)
            for i in range(n):
                if abs(W[i, j]) > NONE:
                    rank = FAILED
    return rank


@compiled(error_model="numpy")
def _inverted(M: Any, W: Any, inverse: Any) -> bool:  # pragma: no cover
    """Invert M by elimination with row pivots; return whether M is regular."""
    m = len(M)
    for i in range(m):
        for j in range(m):
            W[i, j] = M[i, j]
            inverse[i, j] = 1.0 if i == j else 0.0
    for i in range(m):
        p = i
        for j in range(i + 1, m):
            if abs(W[j, i]) > abs(W[p, i]):
                p = j
        if not abs(W[p, i]) > 0.0:
            return False
        if p != i:
            for j in range(m):
                W[i, j], W[p, j] = W[p, j], W[i, j]
                inverse[i, j], inverse[p, j] = inverse[p, j], inverse[i, j]
        factor = 1.0 / W[i, i]
        for j in range(m):
            W[i, j] *= factor
            inverse[i, j] *= factor
        for k in range(m):
            if k != i and W[k, i] != 0.0:
                factor = W[k, i]
                for j in range(m):
                    W[k, j] -= factor * W[i, j]
                    inverse[k, j] -= factor * inverse[i, j]
    return True


@compiled(error_model="numpy")
def _anew(A: Any, b: Any, group: Any, basis: Any, V: Any, M: Any, W: Any, inverse: Any) -> bool:  # pragma: no cover
    """Compute inverse, values and multipliers from the basis with one refinement; return whether it is regular."""
    n, p = A.shape
    m = len(M)
    for t in range(m):
        V[GAIN, t] = V[VALUE, t] = V[PI, t] = 0.0
        for j in range(m):
            M[j, t] = 0.0
        if basis[t] < n:
            i = basis[t]
            for j in range(p):
                M[j, t] = V[SIGN, t] * A[i, j]
            M[p + group[i], t] = 1.0
            V[GAIN, t] = V[SIGN, t] * b[i]
        elif basis[t] < n + m - p:
            M[p + basis[t] - n, t] = 1.0
        else:
            M[basis[t] - n - (m - p), t] = 1.0
    if not _inverted(M, W, inverse):
        return False
    for _ in range(2):
        for t in range(m):
            V[SUM, t] = 1.0 if t >= p else 0.0
            V[DELTA, t] = V[GAIN, t]
            for j in range(m):
                V[SUM, t] -= M[t, j] * V[VALUE, j]
                V[DELTA, t] -= M[j, t] * V[PI, j]
        for t in range(m):
            for j in range(m):
                V[VALUE, t] += inverse[t, j] * V[SUM, j]
                V[PI, t] += inverse[j, t] * V[DELTA, j]
    return True


@compiled(error_model="numpy")
def _entering(A: Any, b: Any, group: Any, V: Any, first: bool) -> tuple[int, float]:  # pragma: no cover
    """Return the column that improves the objective most (or the first that does), and its sign; -1 if none does."""
    n, p = A.shape
    size = 1.0
    for j in range(p):
        size += abs(V[PI, j])
    found, sign, largest = -1, 1.0, OPEN * size
    for i in range(n):
        e = b[i]
        for j in range(p):
            e -= A[i, j] * V[PI, j]
        if abs(e) - V[PI, p + group[i]] > largest:
            found, sign, largest = i, 1.0 if e > 0.0 else -1.0, abs(e) - V[PI, p + group[i]]
            if first:
                return found, sign
    for t in range(p, V.shape[1]):
        if -V[PI, t] > largest:
            found, sign, largest = n + t - p, 1.0, -V[PI, t]
            if first:
                return found, sign
    return found, sign


@compiled(error_model="numpy")
def _leaving(n: int, group: Any, basis: Any, V: Any, inverse: Any, first: bool) -> int:  # pragma: no cover
    """Return the place of the column that reaches 0 first; -1 if none does."""
    # Among ties the column with the largest pivot, or the first one.
    m = V.shape[1]
    if not first:
        for t in range(m):
            if basis[t] < n and V[VALUE, t] == 0.0 and V[DELTA, t] > 0.0:
                for slack in range(m):
                    if basis[slack] == n + group[basis[t]]:
                        V[DELTA, slack] += 2.0 * V[DELTA, t]
                        V[DELTA, t], V[SIGN, t], V[GAIN, t] = -V[DELTA, t], -V[SIGN, t], -V[GAIN, t]
                        for j in range(m):
                            inverse[slack, j] += 2.0 * inverse[t, j]
                            inverse[t, j] = -inverse[t, j]
    smallest, place = inf, -1
    for t in range(m):
        if V[DELTA, t] > PIVOT:
            smallest = min(smallest, V[VALUE, t] / V[DELTA, t])
    for t in range(m):
        if V[DELTA, t] > PIVOT and V[VALUE, t] <= (smallest + 1e-14) * V[DELTA, t]:
            if place < 0 or (basis[t] < basis[place] if first else V[DELTA, t] > V[DELTA, place]):
                place = t
    return place


@compiled(error_model="numpy")
def _exchanged(A: Any, b: Any, group: Any, basis: Any, V: Any, inverse: Any, first: bool) -> int:  # pragma: no cover
    """Exchange one column: return 1, or 0 if no column improves the objective, or -1 if no column can leave."""
    n, p = A.shape
    m = len(inverse)
    q, sign = _entering(A, b, group, V, first)
    if q < 0:
        return 0
    row = p + (group[q] if q < n else q - n)
    for t in range(m):
        V[DELTA, t] = inverse[t, row]
        if q < n:
            for j in range(p):
                V[DELTA, t] += sign * A[q, j] * inverse[t, j]
    place = _leaving(n, group, basis, V, inverse, first)
    if place < 0:
        return -1
    pivot = V[DELTA, place]
    step = max(V[VALUE, place] / pivot, 0.0)
    for j in range(m):
        inverse[place, j] /= pivot
    for t in range(m):
        if t != place:
            V[VALUE, t] = max(V[VALUE, t] - step * V[DELTA, t], 0.0)
            for j in range(m):
                inverse[t, j] -= V[DELTA, t] * inverse[place, j]
    basis[place], V[SIGN, place], V[VALUE, place] = q, sign, step
    V[GAIN, place] = sign * b[q] if q < n else 0.0
    for j in range(m):
        V[PI, j] = 0.0
    for t in range(m):
        for j in range(m):
            V[PI, j] += V[GAIN, t] * inverse[t, j]
    return 1


@compiled(error_model="numpy")
def _judged(A: Any, b: Any, group: Any, basis: Any, V: Any, r: Any, mu: Any) -> int:  # pragma: no cover
    """Write r and mu and compare the two bounds."""
    n, p = A.shape
    size, upper, lower = 1.0, 0.0, 0.0
    for j in range(p):
        size += abs(V[PI, j])
    for g in range(len(r)):
        r[g] = 0.0
    for i in range(n):
        mu[i], e = 0.0, b[i]
        for j in range(p):
            e -= A[i, j] * V[PI, j]
        r[group[i]] = max(r[group[i]], abs(e))
    outcome = UNIQUE
    for t in range(len(basis)):
        V[SUM, t] = 0.0
        if not V[VALUE, t] > ZERO:
            outcome = OPTIMAL
        if basis[t] < n:
            mu[basis[t]] += V[SIGN, t] * max(V[VALUE, t], 0.0)  # a point may be there with both signs
            lower += V[GAIN, t] * max(V[VALUE, t], 0.0)
    for i in range(n):
        V[SUM, p + group[i]] += abs(mu[i])
        for j in range(p):
            V[SUM, j] += mu[i] * A[i, j]
    for j in range(p):
        if not abs(V[SUM, j]) <= CLOSED:
            return FAILED
    for g in range(len(r)):
        upper += r[g]
        if not V[SUM, p + g] <= 1.0 + CLOSED:
            return FAILED
    if not upper - lower <= CLOSED * size:
        return FAILED
    if upper <= CLOSED * size:
        return (
            UNIQUE if CLOSED * size <= SURE else FAILED
        )  # no residuals, unless x is so large that they would not show
    return outcome if CLOSED * size <= SURE * upper else FAILED


@compiled(error_model="numpy")
def _climbed(A: Any, b: Any, group: Any, basis: Any, V: Any, inverse: Any) -> int:  # pragma: no cover
    """Exchange columns until none improves the objective; return their number, -1 without convergence."""
    size = len(A) + len(inverse)
    for number in range(40 * size):
        going = _exchanged(A, b, group, basis, V, inverse, number > 4 * size)
        if going <= 0:
            return number if going == 0 else -1
    return -1


@compiled(error_model="numpy")
def _fitted(F: Any, d: Any, group: Any, x: Any, r: Any, mu: Any, work: Any) -> int:  # pragma: no cover
    """Solve one problem; return its outcome."""
    A, b, size, basis, V, M, W, inverse, rest = work
    n, p = F.shape
    m = len(basis)
    if not _scaled(F, d, A, b, size):
        return FAILED
    rank = _picked(A, rest, basis, n + m - p)
    if rank == FAILED:
        return FAILED
    for t in range(m):
        V[SIGN, t] = 1.0
        if t >= p:
            basis[t] = n + t - p
    outcome, number = FAILED, 0
    # More than two turns are needed only if the inverse is inaccurate.
    for _ in range(5):
        if not _anew(A, b, group, basis, V, M, W, inverse):
            return FAILED
        number = _climbed(A, b, group, basis, V, inverse)
        if number <= 0:
            break
    if number == 0:
        outcome = _judged(A, b, group, basis, V, r, mu)
    for j in range(p):
        x[j] = ldexp(V[PI, j], size[p] - size[j])
    for g in range(m - p):
        r[g] = ldexp(r[g], size[p])
    return max(outcome, rank)


@compiled(error_model="numpy")
def minimax_kernel(F: Any, d: Any, group: Any, x: Any, r: Any, mu: Any, outcome: Any) -> None:  # pragma: no cover
    """Solve the problem of every row; NaN if it failed."""
    n, p = F.shape[1:]
    m = p + r.shape[1]
    square = (m, m)
    work = (
        np.empty((n, p)), np.empty(n), np.empty(p + 1, np.int64), np.empty(m, np.int64), np.empty((6, m)),
        np.empty(square), np.empty(square), np.empty(square), np.empty((n, p)),
    )  # fmt: skip
    for row in range(len(F)):
        outcome[row] = _fitted(F[row], d[row], group, x[row], r[row], mu[row], work)
        if outcome[row] == FAILED:
            for i in range(n):
                mu[row, i] = np.nan
            for j in range(p):
                x[row, j] = np.nan
            for g in range(m - p):
                r[row, g] = np.nan
