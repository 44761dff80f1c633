"""Compiled filters in which every run has a root of its covariance of its own, with weights of the measured outputs.

output_weights.py has the equations, square_root.py the correction.

Phases
    1  orthogonal triangularisation                          _triangle
    2  weights of a single output                            _single
    3  weights of several outputs, or of x - x_pred, too     _fit, _diagonalise, _student, _bounded, _reweigh
    4  correction with weights                               _correct, correct_kernel
    5  next sample                                           predict_kernel
    6  comparison of measurements with predictions           measure_kernel

F is the root of the predicted covariance, q the whitened innovation, H the whitened output matrix, T = H F, and z the
whitened deviation: x - x_pred = F z.  No weight is inverted, so that it may be 0.  G = T T' is not formed where there
are several outputs: beside variances of 1e14 it has lost the noise.  A missing output has q = 0 and zeros in H.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled

STUDENT, HUBER, CORRENTROPY, GATE, INNOVATION = range(5)
"""Values of `law`; `numbers` has dof and iterations, k, sigma, the gate of 1, 2, .. outputs, and k."""
MOST = 200
"""Largest number of iterations of `_reweigh`, and of changes of the set of bounds in `_bounded`."""
SWEEPS = 30
"""Largest number of sweeps of `_diagonalise`."""
RESOLVED = 1e-11
"""Change of a whitened residual, relative to max(1, residual), at which `_reweigh` stops."""
LEAST = 1e-12
"""Least weight of a component of x - x_pred, so that P / weight stays in range."""
ROUNDING = 1e-13
"""Share of k and q up to which a residual that is beyond k is a rounding error."""


@compiled(error_model="numpy")
def _triangle(W: Any, m: int, c: int) -> None:  # pragma: no cover
    """Replace the first m rows and c columns, m >= c, by the triangle U with U' U = W' W, as `square_root.triangle`."""
    for j in range(c):
        total, pivot = 0.0, j
        for i in range(j, m):
            total += W[i, j] * W[i, j]
            if abs(W[i, j]) > abs(W[pivot, j]):
                pivot = i
        if total == 0.0:
            continue
        if pivot > j:
            for s in range(j, c):
                W[j, s], W[pivot, s] = W[pivot, s], W[j, s]
        length = sqrt(total) if W[j, j] < 0.0 else -sqrt(total)
        # The vector is W[j:, j] with another first entry; half its square is `half`.
        first = W[j, j] - length
        half = -length * first
        for s in range(j + 1, c):
            product = first * W[j, s]
            for i in range(j + 1, m):
                product += W[i, j] * W[i, s]
            product /= half
            W[j, s] -= product * first
            for i in range(j + 1, m):
                W[i, s] -= product * W[i, j]
        W[j, j] = length
        for i in range(j + 1, m):
            W[i, j] = 0.0


@compiled(error_model="numpy")
def _project(H: Any, F: Any, T: Any) -> None:  # pragma: no cover
    """Write H F."""
    for o in range(len(H)):
        for s in range(len(F)):
            T[o, s] = 0.0
            for j in range(len(F)):
                T[o, s] += H[o, j] * F[j, s]


@compiled(error_model="numpy")
def _weight(law: int, number: float, r: float) -> float:  # pragma: no cover
    """Return the weight of a whitened residual."""
    if law == CORRENTROPY:
        return exp(-0.5 * (r / number) ** 2)
    return number / abs(r) if abs(r) > number else 1.0


@compiled(error_model="numpy")
def _single(law: int, numbers: Any, G: float, q: float) -> float:  # pragma: no cover
    """Return the weight of a single output, for which everything is a number."""
    number, w = numbers[0], 1.0
    if law == STUDENT:
        for _ in range(int(numbers[1]) - 1):
            share = 1.0 / (1.0 + w * G)
            w = (number + 1.0) / (number + (q * share) ** 2 + G * share)
    elif law == HUBER:
        if abs(q) > number * (1.0 + G):
            w = number / abs(q - G * (number if q > 0.0 else -number))
    else:
        r = q
        for _ in range(MOST):
            old, w = r, _weight(law, number, r)
            r = q / (1.0 + w * G)
            # True for NaN.
            if not abs(r - old) > RESOLVED * max(1.0, abs(r)):
                break
    return w


@compiled(error_model="numpy")
def _fit(T: Any, q: Any, w: Any, v: Any, pull: Any, W: Any, z: Any, r: Any) -> None:  # pragma: no cover
    """Write z and r = q - T z that minimise sum v z^2 / 2 + sum w r^2 / 2 - pull' z; W has n + m rows."""
    m, n = T.shape
    for i in range(m):
        for s in range(n):
            W[i, s] = sqrt(w[i]) * T[i, s]
        W[i, n] = sqrt(w[i]) * q[i]
    for s in range(n):
        for j in range(n + 1):
            W[m + s, j] = sqrt(v[s]) if j == s else 0.0
    # A last row of zeros makes the array as high as wide for one output.
    for j in range(n + 1):
        W[m + n, j] = 0.0
    _triangle(W, m + n + 1, n + 1)
    for i in range(n):
        z[i] = pull[i]
        for s in range(i):
            z[i] -= W[s, i] * z[s]
        z[i] /= W[i, i]
    for i in range(n - 1, -1, -1):
        z[i] += W[i, n]
        for s in range(i + 1, n):
            z[i] -= W[i, s] * z[s]
        z[i] /= W[i, i]
    for i in range(m):
        r[i] = q[i]
        for s in range(n):
            r[i] -= T[i, s] * z[s]


@compiled(error_model="numpy")
def _diagonalise(T: Any, V: Any) -> None:  # pragma: no cover
    """Make the rows of T orthogonal by rotations, which are written as columns of V."""
    m, n = T.shape
    for i in range(m):
        for j in range(m):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        turned = False
        for i in range(m):
            for j in range(i + 1, m):
                first = second = both = 0.0
                for s in range(n):
                    first += T[i, s] * T[i, s]
                    second += T[j, s] * T[j, s]
                    both += T[i, s] * T[j, s]
                # False for NaN.
                if not both * both > 1e-30 * first * second:
                    continue
                turned = True
                half = 0.5 * (second - first) / both
                t = (1.0 if half >= 0.0 else -1.0) / (abs(half) + sqrt(1.0 + half * half))
                c = 1.0 / sqrt(1.0 + t * t)
                for s in range(n):
                    T[i, s], T[j, s] = c * (T[i, s] - t * T[j, s]), c * (T[j, s] + t * T[i, s])
                for s in range(m):
                    V[s, i], V[s, j] = c * (V[s, i] - t * V[s, j]), c * (V[s, j] + t * V[s, i])
        if not turned:
            break


@compiled(error_model="numpy")
def _student(
    dof: float, iterations: int, count: int, T: Any, q: Any, V: Any, turned: Any, w: Any
) -> None:  # pragma: no cover
    """Write the common weight of a Student-t law after a fixed number of corrections; T gets orthogonal rows."""
    m, common = len(q), 1.0
    _diagonalise(T, V)
    for i in range(m):
        turned[i] = w[i] = 0.0
        for j in range(m):
            turned[i] += V[j, i] * q[j]
        for s in range(T.shape[1]):
            w[i] += T[i, s] * T[i, s]
    for _ in range(iterations - 1):
        # r' r + tr H P H', with H P H' = G (I + w G)^-1.
        total = 0.0
        for i in range(m):
            share = 1.0 / (1.0 + common * w[i])
            total += (turned[i] * share) ** 2 + w[i] * share
        common = (dof + count) / (dof + total)
    for i in range(m):
        w[i] = common


@compiled(error_model="numpy")
def _free_step(k: float, r: Any, lam: Any, side: Any) -> int:  # pragma: no cover
    """Move the free entries of lam towards r; return the one that meets a bound first, or -1."""
    step, hit = 1.0, -1
    for i in range(len(r)):
        if side[i] == 0.0 and abs(r[i]) > k:
            share = ((k if r[i] > 0.0 else -k) - lam[i]) / (r[i] - lam[i])
            if share < step:
                step, hit = share, i
    for i in range(len(r)):
        if side[i] == 0.0:
            lam[i] += step * (r[i] - lam[i])
        if i == hit:
            side[i] = 1.0 if r[i] > 0.0 else -1.0
            lam[i] = side[i] * k
    return hit


@compiled(error_model="numpy")
def _bounded(
    k: float, T: Any, q: Any, W: Any, z: Any, r: Any, w: Any, lam: Any, side: Any, pull: Any, v: Any
) -> None:  # pragma: no cover
    """Write the weights of Huber's law: the dual is min |T' lam|^2 / 2 + |lam|^2 / 2 - lam' q over |lam_i| <= k."""
    m, n = T.shape
    side[:] = lam[:] = 0.0
    for _ in range(MOST):
        for i in range(m):
            w[i] = 1.0 if side[i] == 0.0 else 0.0
        for s in range(n):
            pull[s] = 0.0
            for i in range(m):
                pull[s] += side[i] * k * T[i, s]
        _fit(T, q, w, v, pull, W, z, r)
        if _free_step(k, r, lam, side) >= 0:
            continue
        release, worst = -1, 0.0
        for i in range(m):
            # The residual of an entry at a bound is beyond k, apart from rounding.
            excess = side[i] * r[i] - k
            if side[i] != 0.0 and excess < worst - ROUNDING * (k + abs(q[i])):
                release, worst = i, excess
        if release < 0:
            break
        side[release] = 0.0
    for i in range(m):
        w[i] = 1.0 if side[i] == 0.0 else k / abs(r[i])


@compiled(error_model="numpy")
def _reweigh(
    law: int, number: float, both: bool, T: Any, q: Any, W: Any, z: Any, r: Any, w: Any, v: Any, old: Any, pull: Any
) -> None:  # pragma: no cover
    """Write the weights w of y, and with `both` the v of x - x_pred, after repeated corrections."""
    # It starts from x_pred for CORRENTROPY, and from the correction without weights for HUBER.
    m, n = T.shape
    r[:] = q
    z[:] = pull[:] = 0.0
    for step in range(MOST):
        for i in range(m):
            old[i] = r[i]
            w[i] = 1.0 if law == HUBER and step == 0 else _weight(law, number, r[i])
        for s in range(n):
            old[m + s] = z[s]
            v[s] = max(LEAST, _weight(law, number, z[s])) if both else 1.0
        _fit(T, q, w, v, pull, W, z, r)
        change = 0.0
        for i in range(m):
            change = max(change, abs(r[i] - old[i]) / max(1.0, abs(r[i])))
        for s in range(n if both else 0):
            change = max(change, abs(z[s] - old[m + s]) / max(1.0, abs(z[s])))
        # True for NaN.
        if not change > RESOLVED:
            break


@compiled(error_model="numpy")
def _correct(F: Any, T: Any, q: Any, w: Any, v: Any, W: Any, z: Any) -> None:  # pragma: no cover
    """Write [U K; 0 F_hat'] in W and z = U'^-1 W^1/2 q, which has covariance I: x_hat = x + K' z."""
    m, n = T.shape
    W[: n + m, : n + m] = 0.0
    for s in range(n):
        wider = 1.0 / sqrt(v[s])
        for o in range(m):
            W[s, o] = sqrt(w[o]) * T[o, s] * wider
        for i in range(n):
            W[s, m + i] = F[i, s] * wider
    for o in range(m):
        W[n + o, o] = 1.0
    _triangle(W, n + m, n + m)
    for i in range(m):
        z[i] = sqrt(w[i]) * q[i]
        for s in range(i):
            z[i] -= W[s, i] * z[s]
        z[i] /= W[i, i]


@compiled(error_model="numpy")
def _admit(law: int, limit: float, z: Any, w: Any) -> None:  # pragma: no cover
    """Write the weights that depend on the innovation z of covariance I: clipped, or all of it within the gate."""
    distance = 0.0
    for i in range(len(z)):
        distance += z[i] * z[i]
    for i in range(len(z)):
        if law == INNOVATION:
            w[i] = _weight(HUBER, limit, z[i])
        elif not distance <= limit:
            w[i] = 0.0
        z[i] *= w[i]


@compiled(error_model="numpy")
def _mix(kept: float, F: Any, W: Any, m: int) -> None:  # pragma: no cover
    """Write the root of (1 - kept) P_pred + kept P_hat in place of that of P_hat."""
    n = len(F)
    stacked = np.empty((2 * n, n))
    for s in range(n):
        for i in range(n):
            stacked[s, i] = sqrt(kept) * W[m + s, m + i]
            stacked[n + s, i] = sqrt(1.0 - kept) * F[i, s]
    _triangle(stacked, 2 * n, n)
    W[m : m + n, m : m + n] = stacked[:n]


@compiled(error_model="numpy")
def correct_kernel(
    law: int, numbers: Any, both: bool, kept: float, F: Any, q: Any, H: Any, count: Any, x: Any, weight: Any,
    x_hat: Any, F_hat: Any,
) -> None:  # fmt: skip  # pragma: no cover
    """Write the weights of every run, and the estimate with the root of its covariance."""
    runs, m, n = H.shape
    W, T, V = np.empty((n + m + 1, n + m + 1)), np.empty((m, n)), np.empty((m, m))
    r, lam, side, old = np.empty(m), np.empty(m), np.empty(m), np.empty(m + n)
    z, v, pull, inner = np.empty(n), np.empty(n), np.empty(n), np.empty(m)
    for run in range(runs):
        _project(H[run], F[run], T)
        w = weight[run]
        w[:] = v[:] = 1.0
        if law == GATE or law == INNOVATION:
            pass
        elif both or (law == CORRENTROPY and m > 1):
            _reweigh(law, numbers[0], both, T, q[run], W, z, r, w, v, old, pull)
        elif m == 1:
            G = 0.0
            for s in range(n):
                G += T[0, s] * T[0, s]
            w[0] = _single(law, numbers, G, q[run, 0])
        elif law == STUDENT:
            _student(numbers[0], int(numbers[1]), count[run], T, q[run], V, lam, w)
            _project(H[run], F[run], T)
        else:
            _bounded(numbers[0], T, q[run], W, z, r, w, lam, side, pull, v)
        _correct(F[run], T, q[run], w, v, W, inner)
        if law == GATE or law == INNOVATION:
            _admit(law, numbers[max(count[run], 1) - 1 if law == GATE else 0], inner, w)
        if kept < 1.0:
            _mix(kept, F[run], W, m)
        used = not (law == GATE and w[0] == 0.0)
        for i in range(n):
            x_hat[run, i] = x[run, i]
            for o in range(m):
                x_hat[run, i] += W[o, m + i] * inner[o] if used else 0.0
            for s in range(n):
                F_hat[run, i, s] = W[m + s, m + i] if used else F[run, i, s]


@compiled(error_model="numpy")
def predict_kernel(
    A: Any, B: Any, f: Any, Q_root: Any, x: Any, F: Any, u: Any, moved: Any, F_next: Any
) -> None:  # pragma: no cover
    """Write x_pred and the root of P_pred of the next sample."""
    runs, n = x.shape
    W = np.empty((2 * n, n))
    for run in range(runs):
        for i in range(n):
            total = f[i]
            for j in range(n):
                total += A[i, j] * x[run, j]
            for j in range(u.shape[1]):
                total += B[i, j] * u[run, j]
            moved[run, i] = total
            for s in range(n):
                W[s, i], W[n + s, i] = 0.0, Q_root[i, s]
                for j in range(n):
                    W[s, i] += A[i, j] * F[run, j, s]
        _triangle(W, 2 * n, n)
        for i in range(n):
            for s in range(n):
                F_next[run, i, s] = W[s, i]


@compiled(error_model="numpy")
def measure_kernel(
    C: Any, d: Any, R: Any, whitening: Any, x: Any, F: Any, y: Any, e: Any, S: Any, q: Any, H: Any
) -> None:  # pragma: no cover
    """Write innovations of all outputs with their covariance; whitened ones and H of the outputs that are there."""
    runs, n = x.shape
    ny = len(C)
    T = np.empty((ny, n))
    for run in range(runs):
        root = whitening[run if len(whitening) > 1 else 0]
        for o in range(ny):
            for s in range(n):
                T[o, s] = 0.0
                for j in range(n):
                    T[o, s] += C[o, j] * F[run, j, s]
        for o in range(ny):
            e[run, o] = y[run, o] - d[o]
            for j in range(n):
                e[run, o] -= C[o, j] * x[run, j]
            for p in range(o, ny):
                total = 0.5 * (R[o, p] + R[p, o])
                for j in range(n):
                    total += T[o, j] * T[p, j]
                S[run, o, p] = S[run, p, o] = total
        for i in range(ny):
            q[run, i] = 0.0
            for j in range(n):
                H[run, i, j] = 0.0
            for o in range(i + 1):
                if np.isnan(y[run, o]) or np.isnan(y[run, i]):
                    continue
                q[run, i] += root[i, o] * e[run, o]
                for j in range(n):
                    H[run, i, j] += root[i, o] * C[o, j]
