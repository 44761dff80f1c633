"""Compiled mechanics of the parallel robot for all rows of a block, with the limits of its poses.

Phases
    1  geometry of the arms                                     _geometry
    2  matrices of the equations of motion                      _matrices, _factor, _solve
    3  sampled matrices: exponential and its integrals          pair_kernel, _frozen, _integrals, _series, _product
    4  simulation of a sample by the Runge-Kutta method         slide_step_kernel, _slope
    5  validity of a state                                      _status, _sigma, sigma_kernel

Parameters ``p`` of a run: a, b [m], m_p [kg], I_p [kg m^2], m_s [kg], I_arm [kg m^2], d_rot [N m s], d_sl [N s/m], and
for a plant the shortest and the longest arm [m].  A row of ``arms`` (4, 7) contains the rows J and S of the velocities
of one arm (theta' = J v, l' = S v, v the velocity of the platform) and its length l.

An arm of length zero gives NaN.
"""

from __future__ import annotations

from math import cos, isfinite, sin, sqrt
from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled

OK, DIVERGED, OUT_OF_RANGE, SINGULAR = 0, 1, 2, 5  # values of types.Status, which compiled code cannot read
FARTHEST = 1.0  # largest |x_c| and |y_c| of a valid state [m]
LEAST_SIGMA = 0.02  # smallest singular value of J of a regular pose
SIGN_X, SIGN_Y = (1.0, -1.0, -1.0, 1.0), (1.0, 1.0, -1.0, -1.0)  # of the corners, arm by arm
SHORT = 0.5  # largest |K| h of a series: a dozen terms without cancellation
MOST_TERMS = 40
LARGEST = 1e12  # |K| Ts beyond it gives NaN
ROUNDING = 1e-16  # cosine below which two columns count as orthogonal
MOST_SWEEPS = 30  # of rotations; two to four are usual


@compiled(error_model="numpy")
def _geometry(x: Any, p: Any, arms: Any) -> None:  # pragma: no cover
    """Write the arms at a pose (the first three entries of x)."""
    a, b, c, s = p[0], p[1], cos(x[2]), sin(x[2])
    for i in range(4):
        px, py = b * (SIGN_X[i] * c - SIGN_Y[i] * s), b * (SIGN_X[i] * s + SIGN_Y[i] * c)
        dx, dy = x[0] + px - SIGN_X[i] * a, x[1] + py - SIGN_Y[i] * a
        length = sqrt(dx * dx + dy * dy)
        ex, ey = dx / length, dy / length
        arms[i, 0], arms[i, 1], arms[i, 2] = -ey / length, ex / length, (ex * px + ey * py) / length
        arms[i, 3], arms[i, 4], arms[i, 5] = ex, ey, ey * px - ex * py
        arms[i, 6] = length


@compiled(error_model="numpy")
def _matrices(v: Any, p: Any, arms: Any, M: Any, N: Any) -> None:  # pragma: no cover
    """Write M and N of M v' + N v = J' tau, both 3 x 3."""
    # The slides are the corners of a square: terms of their inertia that are linear in their positions cancel, so that
    # they contribute to the platform like masses fixed to it.
    M[:], N[:] = 0.0, 0.0
    M[0, 0] = M[1, 1] = p[2] + 4.0 * p[4]
    M[2, 2] = p[3] + 8.0 * p[4] * p[1] * p[1]
    for i in range(4):
        J, S, length = arms[i, :3], arms[i, 3:6], arms[i, 6]
        turn, slide = J[0] * v[0] + J[1] * v[1] + J[2] * v[2], S[0] * v[0] + S[1] * v[1] + S[2] * v[2]
        for n in range(3):
            spin = (v[2] - turn if n == 2 else -turn) * S[n]
            rate = p[5] * (spin - J[n] * slide) / length + p[6] * J[n]  # of the torque: I_arm J' + d_rot J
            for m in range(3):
                M[m, n] += p[5] * J[m] * J[n]
                N[m, n] += J[m] * rate + p[7] * S[m] * S[n]


@compiled(error_model="numpy")
def _factor(M: Any) -> None:  # pragma: no cover
    """Turn the lower half of a positive definite M (3 x 3) into its Cholesky factor."""
    for i in range(3):
        for j in range(i + 1):
            total = M[i, j]
            for m in range(j):
                total -= M[i, m] * M[j, m]
            M[i, j] = sqrt(total) if i == j else total / M[j, j]


@compiled(error_model="numpy")
def _solve(L: Any, z: Any) -> None:  # pragma: no cover
    """Replace a vector z by M^-1 z, with the factor of M."""
    for i in range(3):
        for j in range(i):
            z[i] -= L[i, j] * z[j]
        z[i] /= L[i, i]
    for i in range(2, -1, -1):
        for j in range(i + 1, 3):
            z[i] -= L[j, i] * z[j]
        z[i] /= L[i, i]


@compiled(error_model="numpy")
def _product(a: Any, b: Any, out: Any) -> None:  # pragma: no cover
    """Write a b, all 3 x 3."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled(error_model="numpy")
def _series(K: Any, h: float, E: Any, term: Any, work: Any) -> None:  # pragma: no cover
    """Write e^(K h) and its first and second integral over [0, h] into E (3, 3, 3)."""
    # The Taylor series of the second integral, until its terms vanish; the others follow from it.
    E2 = E[2]
    E2[:], term[:] = 0.0, 0.0
    for i in range(3):
        term[i, i] = 0.5 * h * h
    for n in range(3, MOST_TERMS):
        changed = False
        for i in range(3):
            for j in range(3):
                total = E2[i, j] + term[i, j]
                changed |= total != E2[i, j]
                E2[i, j] = total
        if not changed:
            break
        _product(K, term, work)
        for i in range(3):
            for j in range(3):
                term[i, j] = work[i, j] * (h / n)
    for order in (1, 0):  # K times an integral is the one before it, less its first term
        _product(K, E[order + 1], E[order])
        for i in range(3):
            E[order, i, i] += h if order == 1 else 1.0


@compiled(error_model="numpy")
def _integrals(K: Any, Ts: float, E: Any, term: Any, work: Any) -> None:  # pragma: no cover
    """Write e^(K Ts) and its integrals for any Ts: by `_series` over a short time, which is then doubled repeatedly."""
    size, doublings = 0.0, 0
    for i in range(3):
        size = max(size, (abs(K[i, 0]) + abs(K[i, 1]) + abs(K[i, 2])) * Ts)
    if not size < LARGEST:
        E[:] = np.nan
        return
    while size > SHORT:
        size, doublings = 0.5 * size, doublings + 1
    h = Ts / 2.0**doublings
    _series(K, h, E, term, work)
    for _ in range(doublings):
        for order in (2, 1, 0):
            _product(E[0], E[order], work)
            for i in range(3):
                for j in range(3):
                    before = h * E[1, i, j] + E[2, i, j] if order == 2 else E[order, i, j] if order == 1 else 0.0
                    E[order, i, j] = before + work[i, j]
        h *= 2.0


@compiled(error_model="numpy")
def _frozen(M: Any, N: Any, arms: Any, K: Any, G: Any, z: Any) -> None:  # pragma: no cover
    """Write K = -M^-1 N (3 x 3) and G' = M^-1 J' (4 x 3); M becomes its factor."""
    _factor(M)
    for j in range(3):
        for i in range(3):
            z[i] = -N[i, j]
        _solve(M, z)
        for i in range(3):
            K[i, j] = z[i]
    for m in range(4):
        for i in range(3):
            G[m, i] = arms[m, i]
        _solve(M, G[m])


@compiled(error_model="numpy")
def pair_kernel(x: Any, p: Any, Ts: float, euler: bool) -> tuple[Any, Any]:  # pragma: no cover
    """Return the sampled matrices (runs, 6, 6) and (runs, 6, 4), frozen at every row of x (runs, 6); p (8,)."""
    A, B = np.zeros((len(x), 6, 6)), np.empty((len(x), 6, 4))
    arms, M, N, E = np.empty((4, 7)), np.empty((3, 3)), np.empty((3, 3)), np.zeros((3, 3, 3))
    K, G, term, work = np.empty((3, 3)), np.empty((4, 3)), np.empty((3, 3)), np.empty((3, 3))
    for row in range(len(x)):
        _geometry(x[row], p, arms)
        _matrices(x[row, 3:], p, arms, M, N)
        _frozen(M, N, arms, K, G, term[0])
        if euler:
            for i in range(3):
                for j in range(3):
                    E[0, i, j] = Ts * K[i, j] + (1.0 if i == j else 0.0)
                E[1, i, i] = Ts
        else:
            _integrals(K, Ts, E, term, work)
        for i in range(3):
            A[row, i, i] = 1.0
            for j in range(3):
                A[row, i, 3 + j], A[row, 3 + i, 3 + j] = E[1, i, j], E[0, i, j]
            for m in range(4):
                B[row, i, m] = E[2, i, 0] * G[m, 0] + E[2, i, 1] * G[m, 1] + E[2, i, 2] * G[m, 2]
                B[row, 3 + i, m] = E[1, i, 0] * G[m, 0] + E[1, i, 1] * G[m, 1] + E[1, i, 2] * G[m, 2]
    return A, B


@compiled(error_model="numpy")
def _slope(x: Any, u: Any, p: Any, arms: Any, M: Any, N: Any, slope: Any) -> None:  # pragma: no cover
    """Write the time derivative of the state."""
    _geometry(x, p, arms)
    _matrices(x[3:], p, arms, M, N)
    _factor(M)
    for i in range(3):
        force = 0.0
        for m in range(4):
            force += arms[m, i] * u[m]
        for j in range(3):
            force -= N[i, j] * x[3 + j]
        slope[i], slope[3 + i] = x[3 + i], force
    _solve(M, slope[3:])


@compiled(error_model="numpy")
def _sigma(arms: Any, V: Any) -> float:  # pragma: no cover
    """Smallest singular value of J (4 x 3), by rotations of its columns until they are orthogonal."""
    # The roots of the eigenvalues of J' J would lose half of the digits where it is small.
    for i in range(4):
        for j in range(3):
            V[i, j] = arms[i, j]
    for _ in range(MOST_SWEEPS):
        turned = False
        for j in range(2):
            for m in range(j + 1, 3):
                alpha, beta, gamma = 0.0, 0.0, 0.0
                for i in range(4):
                    alpha, beta = alpha + V[i, j] * V[i, j], beta + V[i, m] * V[i, m]
                    gamma += V[i, j] * V[i, m]
                if not abs(gamma) > ROUNDING * sqrt(alpha * beta):
                    continue
                turned = True
                zeta = 0.5 * (beta - alpha) / gamma
                t = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + sqrt(1.0 + zeta * zeta))
                c = 1.0 / sqrt(1.0 + t * t)
                for i in range(4):
                    one, other = V[i, j], V[i, m]
                    V[i, j], V[i, m] = c * (one - t * other), c * (t * one + other)
        if not turned:
            break
    least = np.inf
    for j in range(3):
        square = V[0, j] * V[0, j] + V[1, j] * V[1, j] + V[2, j] * V[2, j] + V[3, j] * V[3, j]
        if not square >= least:  # a NaN comes out, too
            least = square
    return sqrt(least)


@compiled(error_model="numpy")
def _status(x: Any, p: Any, arms: Any, V: Any) -> int:  # pragma: no cover
    """Return the status of a state."""
    for i in range(6):
        if not isfinite(x[i]):
            return DIVERGED
    if abs(x[0]) > FARTHEST or abs(x[1]) > FARTHEST:
        return DIVERGED
    _geometry(x, p, arms)
    for i in range(4):
        if not p[8] <= arms[i, 6] <= p[9]:
            return OUT_OF_RANGE
    return SINGULAR if _sigma(arms, V) < LEAST_SIGMA else OK


@compiled(error_model="numpy")
def slide_step_kernel(x: Any, u: Any, w: Any, p: Any, Ts: float, substeps: int) -> tuple[Any, Any]:  # pragma: no cover
    """Advance every row of x (runs, 6) by one sample with constant torques u (runs, 4), then add w; return statuses.

    The Runge-Kutta method of order 4 with equal steps; p (runs, 10) has one row per run.
    """
    x_next, status, h = np.empty(x.shape), np.zeros(len(x), np.int8), Ts / substeps
    arms, M, N, V = np.empty((4, 7)), np.empty((3, 3)), np.empty((3, 3)), np.empty((4, 3))
    now, at, slope, total = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    for row in range(len(x)):
        now[:] = x[row]
        for _ in range(substeps):
            at[:], total[:] = now, 0.0
            for stage in range(4):
                _slope(at, u[row], p[row], arms, M, N, slope)
                reach = h if stage == 2 else 0.5 * h
                for i in range(6):
                    total[i] += slope[i] * (2.0 if 0 < stage < 3 else 1.0)
                    at[i] = now[i] + reach * slope[i]
            for i in range(6):
                now[i] += h / 6.0 * total[i]
        for i in range(6):
            now[i] += w[row, i]
            x_next[row, i] = now[i]
        status[row] = _status(now, p[row], arms, V)
    return x_next, status


@compiled(error_model="numpy")
def sigma_kernel(y: Any, p: Any) -> Any:  # pragma: no cover
    """Return the smallest singular value of J at every row of y (poses, 3); p begins with a and b."""
    arms, V, sigma = np.empty((4, 7)), np.empty((4, 3)), np.empty(len(y))
    for row in range(len(y)):
        _geometry(y[row], p, arms)
        sigma[row] = _sigma(arms, V)
    return sigma
