"""Compiled Riccati recursion of filters in which every run has a covariance of its own; own_covariance.py calls it.

Phases
    measure_kernel   innovation e and its covariance S, whitened innovation q and output matrix H
    correct_kernel   correction with weights of the whitened outputs, one output after the other, P in Joseph form
    predict_kernel   next sample

Imported at the first step only, as it loads numba.  One file, because numba's cache does not detect a change of a
function in another file.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled


@compiled(error_model="numpy")
def _project(P: Any, C: Any, PC: Any) -> None:  # pragma: no cover
    """Write P C'."""
    for i in range(len(P)):
        for o in range(len(C)):
            PC[i, o] = 0.0
            for j in range(len(P)):
                PC[i, o] += P[i, j] * C[o, j]


@compiled(error_model="numpy")
def measure_kernel(
    C: Any, d: Any, R: Any, T: Any, x: Any, P: Any, y: Any, e: Any, S: Any, q: Any, H: Any
) -> None:  # pragma: no cover
    """Write innovations of all outputs with their covariance, and q = T e, H = T C of the outputs that are there."""
    runs, n = x.shape
    ny = len(C)
    PC = np.empty((n, ny))
    for run in range(runs):
        root = T[run if len(T) > 1 else 0]
        _project(P[run], C, PC)
        for o in range(ny):
            e[run, o] = y[run, o] - d[o]
            for j in range(n):
                e[run, o] -= C[o, j] * x[run, j]
            for p in range(o, ny):
                total = 0.5 * (R[o, p] + R[p, o])
                for j in range(n):
                    total += 0.5 * (C[o, j] * PC[j, p] + C[p, j] * PC[j, o])
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


@compiled(error_model="numpy")
def correct_kernel(P: Any, H: Any, weight: Any, x: Any, lam: Any, x_hat: Any, P_hat: Any) -> None:  # pragma: no cover
    """Write x + P H' lam, and P after a correction with white noise of the variances 1 / weight."""
    runs, ny, n = H.shape
    g, L, Th = np.empty(n), np.empty(n), np.empty(n)
    for run in range(runs):
        now = P_hat[run]
        for i in range(n):
            total = x[run, i]
            for o in range(ny):
                for j in range(n):
                    total += P[run, i, j] * H[run, o, j] * lam[run, o]
            x_hat[run, i] = total
            for j in range(n):
                now[i, j] = P[run, i, j]
        for o in range(ny):
            w, s = weight[run, o], 1.0
            for i in range(n):
                g[i] = 0.0
                for j in range(n):
                    g[i] += now[i, j] * H[run, o, j]
                s += w * H[run, o, i] * g[i]
            # (I - L h') P (I - L h')' + L L' / w with L = w g / s and P h = g.
            for i in range(n):
                L[i] = w * g[i] / s
            for i in range(n):
                Th[i] = 0.0
                for j in range(n):
                    now[i, j] -= L[i] * g[j]
                    Th[i] += now[i, j] * H[run, o, j]
            for i in range(n):
                for j in range(n):
                    now[i, j] += w * g[i] * g[j] / (s * s) - Th[i] * L[j]
            for i in range(n):
                for j in range(i):
                    now[i, j] = now[j, i] = 0.5 * (now[i, j] + now[j, i])


@compiled(error_model="numpy")
def predict_kernel(
    A: Any, B: Any, f: Any, Q: Any, x: Any, P: Any, u: Any, moved: Any, P_next: Any
) -> None:  # pragma: no cover
    """Write x_pred and P_pred of the next sample."""
    runs, n = x.shape
    AP = np.empty((n, n))
    for run in range(runs):
        for i in range(n):
            total = f[i]
            for j in range(n):
                total += A[i, j] * x[run, j]
            for j in range(u.shape[1]):
                total += B[i, j] * u[run, j]
            moved[run, i] = total
            for j in range(n):
                AP[i, j] = 0.0
                for s in range(n):
                    AP[i, j] += A[i, s] * P[run, s, j]
        for i in range(n):
            for j in range(i, n):
                upper = lower = 0.0
                for s in range(n):
                    upper += AP[i, s] * A[j, s]
                    lower += AP[j, s] * A[i, s]
                P_next[run, i, j] = P_next[run, j, i] = 0.5 * (upper + Q[i, j] + lower + Q[j, i])
