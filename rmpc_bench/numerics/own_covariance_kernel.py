"""Compiled comparison of measurements with predictions that have a root of the covariance; output_weights.py calls it.

Imported at the first step only, as it loads numba.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rmpc_bench.numerics.compiled import compiled


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
