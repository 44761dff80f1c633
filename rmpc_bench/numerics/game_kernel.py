"""Compiled solution of the soft-constrained linear-quadratic game; lq_game.py defines the problem.

Phases
    1  small dense matrices: products, solve, Cholesky factor    _mul, _tmul, _symmetric, _solve, _cholesky
    2  smallest multiplier for which the maximiser is bounded    smallest_multiplier_kernel, _fits, _alone
    3  backward recursion for given multipliers                  backward_kernel, _carry
    4  worst error of the first state, with its multiplier       first_error_kernel
    5  optimal multiplier of the noise (scalar root)             optimum_kernel
    6  evaluation of the tables of lq_game.py                    lookup_kernel, _looked_up, _series

A problem is (A, S_B, Q, G, M_root).  Axis 0 of the first four is the stage t = 0..N-1: A is the transition matrix,
S_B = B R^-1 B', Q the weight of the next state, G G' = M_w the set of the noise.  M_root is the root of the set of the
error of the first state.  Every matrix is n x n.  The Lagrange multipliers of the noise are tau_t > 0 (``price`` in the
code); the scalar form has the same one at all stages.

Compilation
    The caller combines the entry points, because a kernel that calls another one compiles it again.  Matrices are
    copied and added by loops: assignments of whole arrays bring the code of their error messages.
"""

from __future__ import annotations

from math import exp, inf, log, nan, sqrt
from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled

PI, DELTA, Y, D_PI, D_Y, FIRST = 0, 1, 2, 3, 4, 5  # indices of the results of a backward pass
# Range of s = log(tau / tau_min - 1); exp(-30) is a few hundred roundings.
NEAREST, FARTHEST = -30.0, 60.0
MOST_STEPS = 100  # of a root search; four to six are usual


@compiled(error_model="numpy")
def _mul(a: Any, b: Any, out: Any) -> None:  # pragma: no cover
    """Write a b."""
    n = len(a)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for m in range(n):
                total += a[i, m] * b[m, j]
            out[i, j] = total


@compiled(error_model="numpy")
def _tmul(a: Any, b: Any, out: Any) -> None:  # pragma: no cover
    """Write a' b."""
    n = len(a)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for m in range(n):
                total += a[m, i] * b[m, j]
            out[i, j] = total


@compiled(error_model="numpy")
def _put(a: Any, out: Any) -> None:  # pragma: no cover
    """Write a."""
    for i in range(len(a)):
        for j in range(len(a)):
            out[i, j] = a[i, j]


@compiled(error_model="numpy")
def _add(a: Any, b: Any, out: Any) -> None:  # pragma: no cover
    """Write a + b."""
    for i in range(len(a)):
        for j in range(len(a)):
            out[i, j] = a[i, j] + b[i, j]


@compiled(error_model="numpy")
def _symmetric(a: Any) -> None:  # pragma: no cover
    """Symmetrise a."""
    for i in range(len(a)):
        for j in range(i):
            a[i, j] = a[j, i] = 0.5 * (a[i, j] + a[j, i])


@compiled(error_model="numpy")
def _solve(F: Any, b: Any, out: Any) -> None:  # pragma: no cover
    """Write F^-1 b by elimination with row pivots; F is destroyed."""
    n = len(F)
    _put(b, out)
    for i in range(n):
        p = i
        for j in range(i + 1, n):
            if abs(F[j, i]) > abs(F[p, i]):
                p = j
        if p != i:
            for m in range(n):
                F[i, m], F[p, m] = F[p, m], F[i, m]
                out[i, m], out[p, m] = out[p, m], out[i, m]
        for j in range(i + 1, n):
            factor = F[j, i] / F[i, i]
            for m in range(i, n):
                F[j, m] -= factor * F[i, m]
            for m in range(n):
                out[j, m] -= factor * out[i, m]
    for i in range(n - 1, -1, -1):
        for m in range(n):
            total = out[i, m]
            for j in range(i + 1, n):
                total -= F[i, j] * out[j, m]
            out[i, m] = total / F[i, i]


@compiled(error_model="numpy")
def _cholesky(W: Any) -> bool:  # pragma: no cover
    """Replace the lower triangle of W by its Cholesky factor; return whether W is positive definite."""
    n = len(W)
    for i in range(n):
        for j in range(i + 1):
            total = W[i, j]
            for m in range(j):
                total -= W[i, m] * W[j, m]
            if i > j:
                W[i, j] = total / W[j, j]
            elif total > 0.0:
                W[i, i] = sqrt(total)
            else:
                return False
    return True


@compiled(error_model="numpy")
def _alone(A: Any, G: Any, tau: float, X: Any, new: Any, T: Any, p: Any, s: Any) -> bool:  # pragma: no cover
    """One stage without control: A' X (I - M_w X / tau)^-1 A, T = (I - M_w X / tau)^-1 A and p = G' X T."""
    # Returns whether tau is large enough for the stage. This form keeps symmetry and sign close to the boundary.
    n = len(A)
    XA, GXA, W, XG = s[0], s[1], s[2], s[3]
    _mul(X, A, XA)
    _tmul(G, XA, GXA)
    _mul(X, G, XG)
    _tmul(G, XG, W)
    for i in range(n):
        for j in range(n):
            W[i, j] = (1.0 if i == j else 0.0) - W[i, j] / tau
    if not _cholesky(W):
        return False
    for m in range(n):  # GXA becomes V = L^-1 G' X A
        for i in range(n):
            total = GXA[i, m]
            for j in range(i):
                total -= W[i, j] * GXA[j, m]
            GXA[i, m] = total / W[i, i]
    _tmul(A, XA, new)
    for i in range(n):
        for j in range(n):
            for m in range(n):
                new[i, j] += GXA[m, i] * GXA[m, j] / tau
    for m in range(n):  # p = L^-T V, since G' X T = W^-1 G' X A
        for i in range(n - 1, -1, -1):
            total = GXA[i, m]
            for j in range(i + 1, n):
                total -= W[j, i] * p[j, m]
            p[i, m] = total / W[i, i]
    _mul(G, p, T)
    for i in range(n):
        for j in range(n):
            T[i, j] = A[i, j] + T[i, j] / tau
    _symmetric(new)
    return True


@compiled(error_model="numpy")
def backward_kernel(A: Any, S_B: Any, Q: Any, G: Any, tau: Any, X: Any, paths: Any) -> bool:  # pragma: no cover
    """Write the matrices of the first stage into X (6, n, n); return whether all multipliers are large enough.

    D_PI, D_Y are derivatives with respect to a common change of all multipliers.  ``paths`` (2, N, n, n) receives T
    and Pi T of the game, unless its N is 0.
    """
    N, n = A.shape[0], A.shape[1]
    s = np.empty((14, n, n))
    PT, Pi, Delta, Ya, dPi, dY = X[FIRST], X[PI], X[DELTA], X[Y], X[D_PI], X[D_Y]
    S_now, T_Y, p_Y, T, p, T_S, F, M = s[4], s[5], s[6], s[7], s[8], s[9], s[10], s[11]
    for i in range(n):
        for j in range(n):
            S_now[i, j] = Pi[i, j] = Ya[i, j] = Q[N - 1, i, j]
            Delta[i, j] = dPi[i, j] = dY[i, j] = 0.0
    for t in range(N - 1, -1, -1):
        price = tau[t]
        if not _alone(A[t], G[t], price, Ya, s[12], T_Y, p_Y, s):
            return False
        _put(s[12], Ya)
        _carry(T_Y, p_Y, price, dY, s)
        for i in range(n):  # M = M_w / tau
            for j in range(n):
                M[i, j] = 0.0
                for m in range(n):
                    M[i, j] += G[t, i, m] * G[t, j, m] / price
                s[12, i, j] = S_B[t, i, j] - M[i, j]
        _mul(s[12], Pi, F)
        for i in range(n):
            F[i, i] += 1.0
        _solve(F, A[t], T)  # T = (I + (S_B - M_w / tau) Pi)^-1 A
        _mul(Pi, T, PT)
        _tmul(G[t], PT, p)
        _carry(T, p, price, dPi, s)
        _mul(S_B[t], S_now, F)
        for i in range(n):
            F[i, i] += 1.0
        _solve(F, A[t], T_S)
        # Delta = Pi - S has its own recursion, because the difference would cancel for large states.
        _mul(M, S_now, s[12])
        _mul(Pi, s[12], s[13])
        _add(s[13], Delta, s[13])
        _mul(s[13], T_S, s[12])
        _tmul(T, s[12], Delta)
        _mul(S_now, T_S, s[12])
        _tmul(A[t], s[12], S_now)
        _symmetric(Delta)
        _symmetric(S_now)
        if t > 0:
            _add(S_now, Q[t - 1], S_now)
            _add(Ya, Q[t - 1], Ya)
        _add(S_now, Delta, Pi)
        if paths.shape[1] > 0:
            _put(T, paths[0, t])
            _put(PT, paths[1, t])
    return True


@compiled(error_model="numpy")
def _carry(T: Any, p: Any, tau: float, dX: Any, s: Any) -> None:  # pragma: no cover
    """Replace dX by T' dX T - p' p / tau^2."""
    n = len(T)
    _mul(dX, T, s[0])
    _tmul(T, s[0], dX)
    for i in range(n):
        for j in range(n):
            for m in range(n):
                dX[i, j] -= p[m, i] * p[m, j] / tau**2
    _symmetric(dX)


@compiled(error_model="numpy")
def first_error_kernel(
    X: Any, M_root: Any, x: Any, x_w: Any, top: Any, first: Any
) -> tuple[float, float, float]:  # pragma: no cover
    """Minimise over the multiplier tau_1 of the error of the first state, for given multipliers of the noise.

    Writes the worst first state x_w = x + e, the direction ``top`` that bounds tau_1 from below, and ``first`` =
    Pi_1 T x_w, so that u = -R^-1 B' first.  Returns tau_1, the slack 1 - e' M^-1 e at the boundary of the domain, and
    the cost minus that without noise.
    """
    n = len(x)
    lam, V = np.linalg.eigh(M_root.T.dot(X[PI]).dot(M_root))
    edge, U = np.linalg.eigh(M_root.T.dot(X[Y]).dot(M_root))
    widest = M_root.dot(np.ascontiguousarray(U[:, n - 1]))
    g = V.T.dot(M_root.T.dot(X[PI].dot(x)))
    tau, size, f = max(edge[n - 1], 0.0), 0.0, np.zeros(n)
    for i in range(n):
        if g[i] != 0.0:
            size += (g[i] / (tau - lam[i])) ** 2 if tau > lam[i] else inf
    # If size > 1, the optimum is in the interior: Newton's method from below on sum (g / (tau - lam))^2 = 1.
    if size > 1.0:
        for i in range(n):
            tau = max(tau, lam[i] + abs(g[i]))
        for _ in range(MOST_STEPS):
            size, slope = 0.0, 0.0
            for i in range(n):
                if g[i] != 0.0:
                    size += (g[i] / (tau - lam[i])) ** 2
                    slope += g[i] ** 2 / (tau - lam[i]) ** 3
            step = (sqrt(size) - 1.0) * size / slope if slope > 0.0 else 0.0
            tau += step
            if not step > 1e-15 * tau:
                break
        size = 1.0
    excess = tau + x.dot(X[DELTA].dot(x))
    for i in range(n):
        if g[i] != 0.0:
            f[i] = g[i] / (tau - lam[i])
            excess += g[i] * f[i]
    e = M_root.dot(V.dot(f))
    for i in range(n):
        top[i], x_w[i] = widest[i], x[i] + e[i]
    e = X[FIRST].dot(x_w)
    for i in range(n):
        first[i] = e[i]
    return tau, 1.0 - size, excess


@compiled(error_model="numpy")
def optimum_kernel(
    A: Any, S_B: Any, Q: Any, G: Any, M_root: Any, x: Any, tau_min: float, s: float, X: Any
) -> float:  # pragma: no cover
    """Return the optimal s = log(tau / tau_min - 1), where D(s) = 1 for D = -d(rho - tau) / d tau.

    Secant steps on log D, which is nearly linear in s, with bisection if a step leaves the bracket.  Where D is steep,
    close to the point at which the worst error reaches its ellipsoid, secant steps on (D - 1) / edge, with the slope of
    the boundary.  The optimum may be the boundary itself.
    """
    n = len(x)
    tau, x_w, top, first, paths = np.empty(len(A)), np.empty(n), np.empty(n), np.empty(n), np.empty((2, 0, n, n))
    low, high, corner, last_s, last_log, last_ratio = NEAREST, FARTHEST, False, nan, nan, nan
    for number in range(MOST_STEPS):
        for t in range(len(A)):
            tau[t] = tau_min * (1.0 + exp(s))
        slope, edge, slack = inf, 1.0, 1.0
        if backward_kernel(A, S_B, Q, G, tau, X, paths):
            slack = first_error_kernel(X, M_root, x, x_w, top, first)[1]
            edge = -top.dot(X[D_Y].dot(top))
            slope = -x_w.dot(X[D_PI].dot(x_w)) + slack * edge
        if slope != slope:
            return nan
        value = log(slope) if 0.0 < slope < inf else (inf if slope > 0.0 else -inf)
        ratio = (slope - 1.0) / edge
        if abs(slope - 1.0) <= 1e-13 * max(edge, 1.0) or (value <= 0.0 and s == NEAREST):
            return s
        if value > 0.0:
            low = s
        else:
            high, corner = s, slack == 0.0
        # In the interior the result is insensitive to s, as long as the boundary lies below.
        if corner and exp(high) - exp(low) <= 1e-13:
            return high
        if number == 0:
            new = s + 0.5 * value
        elif slope > 1.0 and 0.0 < slack < 0.5:
            new = s - ratio * (s - last_s) / (ratio - last_ratio)
        else:
            new = s - value * (s - last_s) / (value - last_log)
        if new <= NEAREST == low:
            new = NEAREST
        elif not low < new < high or (number > 8 and number % 3 == 0):
            new = 0.5 * (low + high)
        if (abs(new - s) <= 1e-12 and abs(value) <= 1e-3) or high - low <= 1e-12:
            return new
        last_s, last_log, last_ratio, s = s, value, ratio, new
    return s


@compiled(error_model="numpy")
def _fits(A: Any, Q: Any, G: Any, tau: float, s: Any) -> bool:  # pragma: no cover
    """Return whether the cost without control is bounded for the multiplier tau at all stages."""
    X = Q[len(A) - 1].copy()
    for t in range(len(A) - 1, -1, -1):
        if not _alone(A[t], G[t], tau, X, s[4], s[5], s[6], s):
            return False
        _put(s[4], X)
        if t > 0:
            _add(X, Q[t - 1], X)
    return True


@compiled(error_model="numpy")
def smallest_multiplier_kernel(A: Any, Q: Any, G: Any) -> float:  # pragma: no cover
    """Return the smallest multiplier with a bounded cost without control, the norm of the map from noise to cost.

    It lies between the trace of that map divided by its size, and the trace.  Bisection until adjacent numbers are
    left; the result is the upper one.
    """
    N, n = A.shape[0], A.shape[1]
    X, s, high = Q[N - 1].copy(), np.empty((7, n, n)), 0.0
    for t in range(N - 1, -1, -1):
        _mul(X, G[t], s[0])
        _tmul(G[t], s[0], s[1])
        trace = 0.0
        for i in range(n):
            trace += s[1, i, i]
        high += trace
        _mul(X, A[t], s[0])
        _tmul(A[t], s[0], X)
        if t > 0:
            _add(X, Q[t - 1], X)
    if not 0.0 < high < inf:
        return high
    # Margins for the rounding of the sum.
    low, high = high / (n * N) * (1.0 - 1e-9), high * (1.0 + 1e-9)
    while True:
        middle = sqrt(low * high) if high > 1.1 * low else 0.5 * (low + high)
        if not low < middle < high:
            return high
        low, high = (low, middle) if _fits(A, Q, G, middle, s) else (middle, high)


# Tables: at the boundary of the domain the solution of a run depends only on x_hat and s.  A table therefore contains
# functions of s: Chebyshev series in z = (offset - middle) / half, where offset is s minus its optimum for x_hat = 0.
# Rows of a table (1 + 3 n^2, nodes): the slope D of a state (1 constant, n^2 of a quadratic form), times
# exp(2 offset), so that it is nearly constant; e' M^-1 e (n^2 of a quadratic form); ``first`` (n^2 of a matrix).
LOOKUP_STEPS = 30  # four to five are usual
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
    for number in range(LOOKUP_STEPS):
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
