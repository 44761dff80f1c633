"""Compiled weights of measured outputs, run after run; output_weights.py has the equations.

Phases
    1  triangular factors                                        _factor, _forward, _backward
    2  correction with given weights, in the space of outputs    _gain; for a common weight _diagonalise
    3  a single output                                           _single
    4  laws                                                      _student, _bounded, _reweigh, _gate, _clip
    5  all runs                                                  weight_kernel

q is the whitened innovation, H the whitened output matrix, G = H P H', M the lower Cholesky factor of
I + W^(1/2) G W^(1/2), lam = W^(1/2) (M M')^-1 W^(1/2) q, r = q - G lam the whitened residual.  No weight of an output
is inverted, so that it may be 0.  An output that is missing has q = 0 and a row of zeros in H; it has no effect.

Imported at the first step only, as it loads numba.  One file, because numba's cache does not detect a change of a
function in another file.
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
RESOLVED = 1e-11
"""Change of a whitened residual, relative to max(1, residual), at which `_reweigh` stops."""
LEAST = 1e-12
"""Least weight of a component of x - x_pred, so that P / weight stays in range."""
NO_PIVOT = 1e-13
"""A pivot of P that is smaller, relative to the diagonal, is a direction without variance."""


@compiled(error_model="numpy")
def _factor(M: Any, m: int) -> None:  # pragma: no cover
    """Replace the lower triangle of M by its Cholesky factor; a column without variance becomes 0."""
    for j in range(m):
        pivot = M[j, j]
        for s in range(j):
            pivot -= M[j, s] * M[j, s]
        root = 0.0 if pivot <= NO_PIVOT * M[j, j] else sqrt(pivot)
        M[j, j] = root
        for i in range(j + 1, m):
            for s in range(j):
                M[i, j] -= M[i, s] * M[j, s]
            M[i, j] = 0.0 if root == 0.0 else M[i, j] / root


@compiled(error_model="numpy")
def _forward(L: Any, m: int, b: Any) -> None:  # pragma: no cover
    """Replace b by L^-1 b."""
    for i in range(m):
        for s in range(i):
            b[i] -= L[i, s] * b[s]
        b[i] /= L[i, i]


@compiled(error_model="numpy")
def _backward(L: Any, m: int, b: Any) -> None:  # pragma: no cover
    """Replace b by L'^-1 b."""
    for i in range(m - 1, -1, -1):
        for s in range(i + 1, m):
            b[i] -= L[s, i] * b[s]
        b[i] /= L[i, i]


@compiled(error_model="numpy")
def _gain(G: Any, w: Any, q: Any, M: Any, lam: Any, r: Any) -> None:  # pragma: no cover
    """Write M, lam and the whitened residual r = q - G lam after a correction with the weights w."""
    m = len(q)
    for i in range(m):
        for j in range(i + 1):
            M[i, j] = sqrt(w[i]) * sqrt(w[j]) * 0.5 * (G[i, j] + G[j, i])
        M[i, i] += 1.0
        lam[i] = sqrt(w[i]) * q[i]
    _factor(M, m)
    _forward(M, m, lam)
    _backward(M, m, lam)
    for i in range(m):
        lam[i] *= sqrt(w[i])
    for i in range(m):
        r[i] = q[i]
        for j in range(m):
            r[i] -= G[i, j] * lam[j]


@compiled(error_model="numpy")
def _weight(law: int, number: float, r: float) -> float:  # pragma: no cover
    """Return the weight of a whitened residual."""
    if law == CORRENTROPY:
        return exp(-0.5 * (r / number) ** 2)
    return number / abs(r) if abs(r) > number else 1.0


@compiled(error_model="numpy")
def _single(law: int, numbers: Any, G: float, q: float) -> tuple[float, float]:  # pragma: no cover
    """Return weight and lam of a single output, for which everything is a number."""
    number, S, w = numbers[0], 1.0 + G, 1.0
    if law == STUDENT:
        for _ in range(int(numbers[1]) - 1):
            share = 1.0 / (1.0 + w * G)
            w = (number + 1.0) / (number + (q * share) ** 2 + G * share)
    elif law == HUBER:
        lam = q / S
        if abs(lam) > number:
            lam = number if q > 0.0 else -number
            w = number / abs(q - G * lam)
        return w, lam
    elif law == CORRENTROPY:
        r = q
        for _ in range(MOST):
            old, w = r, _weight(law, number, r)
            r = q / (1.0 + w * G)
            # True for NaN.
            if not abs(r - old) > RESOLVED * max(1.0, abs(r)):
                break
    elif law == GATE:
        w = 1.0 if q * q / S <= number else 0.0
    else:
        w = _weight(HUBER, number, q / sqrt(S))
        return w, w * q / S
    return w, w * q / (1.0 + w * G)


@compiled(error_model="numpy")
def _diagonalise(G: Any, V: Any) -> None:  # pragma: no cover
    """Replace G by its eigenvalues on the diagonal, and write its eigenvectors as columns of V, by Jacobi rotations."""
    m = len(G)
    for i in range(m):
        for j in range(m):
            V[i, j] = 1.0 if i == j else 0.0
            G[i, j] = G[j, i] = 0.5 * (G[i, j] + G[j, i])
    for _ in range(MOST):
        turned = False
        for i in range(m):
            for j in range(i + 1, m):
                # False for NaN.
                if not G[i, j] * G[i, j] > 1e-32 * abs(G[i, i] * G[j, j]):
                    continue
                turned = True
                half = 0.5 * (G[j, j] - G[i, i]) / G[i, j]
                t = (1.0 if half >= 0.0 else -1.0) / (abs(half) + sqrt(1.0 + half * half))
                c = 1.0 / sqrt(1.0 + t * t)
                for s in range(m):
                    G[s, i], G[s, j] = c * (G[s, i] - t * G[s, j]), c * (G[s, j] + t * G[s, i])
                    V[s, i], V[s, j] = c * (V[s, i] - t * V[s, j]), c * (V[s, j] + t * V[s, i])
                for s in range(m):
                    G[i, s], G[j, s] = c * (G[i, s] - t * G[j, s]), c * (G[j, s] + t * G[i, s])
        if not turned:
            break


@compiled(error_model="numpy")
def _student(
    dof: float, iterations: int, count: int, G: Any, q: Any, V: Any, lam: Any, turned: Any, w: Any
) -> None:  # pragma: no cover
    """Write the common weight of a Student-t law after a fixed number of corrections; G becomes diagonal."""
    m, common = len(q), 1.0
    _diagonalise(G, V)
    for i in range(m):
        turned[i] = 0.0
        for j in range(m):
            turned[i] += V[j, i] * q[j]
    for _ in range(iterations - 1):
        # r' r + tr H P H', with H P H' = G (I + w G)^-1.
        total = 0.0
        for i in range(m):
            share = 1.0 / (1.0 + common * G[i, i])
            total += (turned[i] * share) ** 2 + G[i, i] * share
        common = (dof + count) / (dof + total)
    for i in range(m):
        w[i] = common
        lam[i] = 0.0
        for j in range(m):
            lam[i] += V[i, j] * common * turned[j] / (1.0 + common * G[j, j])


@compiled(error_model="numpy")
def _free_step(k: float, G: Any, q: Any, side: Any, M: Any, goal: Any, lam: Any, free: Any) -> int:  # pragma: no cover
    """Move lam towards the minimum over its free entries; return the entry that meets a bound first, or -1."""
    m = len(q)
    n_free = 0
    for i in range(m):
        if side[i] == 0.0:
            free[n_free] = i
            n_free += 1
    for a in range(n_free):
        goal[a] = q[free[a]]
        for j in range(m):
            if side[j] != 0.0:
                goal[a] -= G[free[a], j] * lam[j]
        for b in range(a + 1):
            M[a, b] = 0.5 * (G[free[a], free[b]] + G[free[b], free[a]])
        M[a, a] += 1.0
    _factor(M, n_free)
    _forward(M, n_free, goal)
    _backward(M, n_free, goal)
    step, hit = 1.0, -1
    for a in range(n_free):
        i = free[a]
        if abs(goal[a]) > k:
            share = ((k if goal[a] > 0.0 else -k) - lam[i]) / (goal[a] - lam[i])
            if share < step:
                step, hit = share, i
    for a in range(n_free):
        i = free[a]
        lam[i] += step * (goal[a] - lam[i])
        if i == hit:
            side[i] = 1.0 if goal[a] > 0.0 else -1.0
            lam[i] = side[i] * k
    return hit


@compiled(error_model="numpy")
def _bounded(
    k: float, G: Any, q: Any, M: Any, lam: Any, w: Any, side: Any, goal: Any, free: Any
) -> None:  # pragma: no cover
    """Write the weights of Huber's law: the dual is min lam' (I + G) lam / 2 - lam' q over |lam_i| <= k."""
    m = len(q)
    side[:] = lam[:] = 0.0
    for _ in range(MOST):
        if _free_step(k, G, q, side, M, goal, lam, free) >= 0:
            continue
        release, worst = -1, 0.0
        for i in range(m):
            rest = q[i]
            for j in range(m):
                rest -= G[i, j] * lam[j]
            # The residual of an entry at a bound is beyond k, apart from rounding.
            excess = side[i] * rest - k
            if side[i] != 0.0 and excess < worst - NO_PIVOT * (k + abs(q[i])):
                release, worst = i, excess
        if release < 0:
            break
        side[release] = 0.0
    for i in range(m):
        rest = q[i]
        for j in range(m):
            rest -= G[i, j] * lam[j]
        w[i] = 1.0 if side[i] == 0.0 else k / abs(rest)


@compiled(error_model="numpy")
def _reweigh(
    law: int, number: float, H: Any, G: Any, q: Any, M: Any, lam: Any, r: Any, w: Any, v: Any, z: Any, old: Any
) -> None:  # pragma: no cover
    """Write the weights w of y, and v of x - x_pred unless v is empty, after repeated corrections.

    With v the columns of H belong to independent components of x - x_pred.  It starts from x_pred for CORRENTROPY, and
    from the correction without weights for HUBER.
    """
    m, n = len(q), len(v)
    r[:] = q
    z[:] = 0.0
    for step in range(MOST):
        for i in range(m):
            old[i] = r[i]
            w[i] = 1.0 if law == HUBER and step == 0 else _weight(law, number, r[i])
        if n > 0:
            for s in range(n):
                v[s] = max(LEAST, _weight(law, number, z[s]))
            for i in range(m):
                for j in range(m):
                    G[i, j] = 0.0
                    for s in range(n):
                        G[i, j] += H[i, s] * H[j, s] / v[s]
        _gain(G, w, q, M, lam, r)
        change = 0.0
        for i in range(m):
            change = max(change, abs(r[i] - old[i]) / max(1.0, abs(r[i])))
        for s in range(n):
            before, z[s] = z[s], 0.0
            for i in range(m):
                z[s] += H[i, s] * lam[i] / v[s]
            change = max(change, abs(z[s] - before) / max(1.0, abs(z[s])))
        # True for NaN.
        if not change > RESOLVED:
            break


@compiled(error_model="numpy")
def _widened(P: Any, v: Any, T: Any, wide: Any) -> None:  # pragma: no cover
    """Write T diag(1/v) T', which is P for weights of 1."""
    n = len(v)
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for s in range(j + 1):
                total += T[i, s] * T[j, s] / v[s]
            wide[i, j] = wide[j, i] = total


@compiled(error_model="numpy")
def _weigh_both(
    law: int, number: float, P: Any, H: Any, G: Any, q: Any, M: Any, lam: Any, r: Any, w: Any, wide: Any
) -> None:  # pragma: no cover
    """Write the weights of y, and P over the weights of x - x_pred, whitened by the Cholesky factor of P."""
    m, n = H.shape
    T, HT, v, z = P.copy(), np.zeros((m, n)), np.ones(n), np.empty(n)
    _factor(T, n)
    for i in range(m):
        for s in range(n):
            for j in range(s, n):
                HT[i, s] += H[i, j] * T[j, s]
    _reweigh(law, number, HT, G, q, M, lam, r, w, v, z, np.empty(m))
    _widened(P, v, T, wide)


@compiled(error_model="numpy")
def _clip(k: float, M: Any, q: Any, lam: Any, w: Any) -> None:  # pragma: no cover
    """Write lam from the clipped innovation of covariance I, and what is left of every component."""
    m = len(q)
    for i in range(m):
        lam[i] = q[i]
    _forward(M, m, lam)
    for i in range(m):
        w[i] = _weight(HUBER, k, lam[i])
        lam[i] *= w[i]
    _backward(M, m, lam)


@compiled(error_model="numpy")
def _gate(limit: float, G: Any, q: Any, M: Any, lam: Any, r: Any, w: Any) -> None:  # pragma: no cover
    """Write weights of 1 where e' S^-1 e is within the limit, else of 0; NaN is not within."""
    _gain(G, w, q, M, lam, r)
    distance = 0.0
    for i in range(len(q)):
        distance += q[i] * lam[i]
    if not distance <= limit:
        for i in range(len(q)):
            w[i] = lam[i] = 0.0


@compiled(error_model="numpy")
def weight_kernel(
    law: int, numbers: Any, both: bool, P: Any, q: Any, H: Any, count: Any, weight: Any, lam: Any, wide: Any
) -> None:  # pragma: no cover
    """Write the weights of every run, lam, and with `both` P over the weights of x - x_pred."""
    runs, m, n = H.shape
    G, M, PH, r, none = np.empty((m, m)), np.empty((m, m)), np.empty((n, m)), np.empty(m), np.empty(0)
    work, free = np.empty((2, m)), np.empty(m, dtype=np.int64)
    for run in range(runs):
        for o in range(m):
            weight[run, o] = 1.0
            for i in range(n):
                PH[i, o] = 0.0
                for j in range(n):
                    PH[i, o] += P[run, i, j] * H[run, o, j]
        for o in range(m):
            for p in range(m):
                G[o, p] = 0.0
                for j in range(n):
                    G[o, p] += H[run, o, j] * PH[j, p]
        w = weight[run]
        if both:
            _weigh_both(law, numbers[0], P[run], H[run], G, q[run], M, lam[run], r, w, wide[run])
        elif m == 1:
            w[0], lam[run, 0] = _single(law, numbers, G[0, 0], q[run, 0])
        elif law == STUDENT:
            _student(numbers[0], int(numbers[1]), count[run], G, q[run], M, lam[run], r, w)
        elif law == HUBER:
            _bounded(numbers[0], G, q[run], M, lam[run], w, work[0], work[1], free)
        elif law == GATE:
            _gate(numbers[max(count[run], 1) - 1], G, q[run], M, lam[run], r, w)
        elif law == INNOVATION:
            _gain(G, w, q[run], M, lam[run], r)
            _clip(numbers[0], M, q[run], lam[run], w)
        else:
            _reweigh(law, numbers[0], H[run], G, q[run], M, lam[run], r, w, none, none, work[0])
