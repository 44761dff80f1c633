"""Quadratic programs whose active rows are nearly dependent: a dual active-set method without squared matrices.

Problem  That of qp.py as a least distance: minimise |y|^2 over G y >= h with y = R x + R^-T f, H = R' R, and for every
         soft row one more unknown e = sqrt(quadratic) (eps + linear / quadratic).
Method   Goldfarb and Idnani, Mathematical Programming 27 (1983).  The normals of the active rows are factorised anew in
         every step by `eliminated`, which keeps the digits of every unknown: an unknown that moves the rows 1e-36 times
         as much as others, as in predictions of unstable plants, counts exactly where the others are used up.
Cost     About 1 ms for ten unknowns; only for problems that DAQP does not solve.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import SMALLEST, eliminated
from rmpc_bench.types import Array

SATISFIED = 1e-13
"""Largest violation of a row relative to its terms."""


def refined(
    H: Float[Array, "n n"],
    A: Float[Array, "rows n"],
    soft: Bool[Array, " rows"],
    weights: tuple[Array, Array],
    f: Float[Array, " n"],
    low: Float[Array, " rows"],
    high: Float[Array, " rows"],
) -> tuple[Float[Array, " n"], Float[Array, " rows"]] | None:
    """Return the minimum and the multipliers, None without a point; a ValueError where the method fails."""
    n, rows = A.shape[1], np.arange(len(A))
    R = np.linalg.cholesky(H).T
    shift = np.linalg.solve(R.T, f)
    turned = np.linalg.solve(R.T, A.T).T
    of_slack = np.zeros((len(A), int(soft.sum())))
    linear, quadratic = (each[soft] for each in weights)
    of_slack[rows[soft], np.arange(len(linear))] = 1.0 / np.sqrt(quadratic)
    offset, eye = of_slack @ (linear / np.sqrt(quadratic)), np.eye(len(linear))
    moved = turned @ shift
    G = np.vstack(
        [np.hstack([np.zeros((len(linear), n)), eye]), np.hstack([turned, of_slack]), np.hstack([-turned, of_slack])]
    )
    h = np.concatenate([linear / np.sqrt(quadratic), low + moved + offset, offset - high - moved])
    there = np.isfinite(h)
    found = _least_distance(G[there], h[there], len(linear))
    if found is None:
        return None
    y, lam = found
    every = np.zeros(len(h))
    every[there] = lam
    below, above = np.split(every[len(linear) :], 2)
    return np.linalg.solve(R, y[:n] - shift), above - below


def _least_distance(G: Float[Array, "m n"], h: Float[Array, " m"], start: int) -> tuple[Array, Array] | None:
    """Return the y with the least |y| and G y >= h, and y = G' lam; the first ``start`` rows are active at first."""
    (m, n), active, p, lam = G.shape, list(range(start)), -1, np.zeros(len(G))
    sizes = np.abs(G).max(axis=0, initial=0.0)
    stack, short, violated = np.hstack([G.T, np.eye(n)]), 0.0, np.zeros(m)
    for _ in range(20 * (m + n)):
        k, scale = len(active), sizes.copy()
        T, order = eliminated(np.hstack([G[active].T, stack]), k, scale)
        R, first, rest = T[:k, :k], T[:k, k:], T[k:, k:]
        if p < 0:
            t = np.linalg.solve(R.T, h[active][order])
            both, lam[:] = t @ first, 0.0
            lam[np.array(active, dtype=int)[order]] = np.linalg.solve(R, t)
            y = both[m:]
            violated = h - both[:m]
            violated = np.where(violated > SATISFIED * (np.abs(h) + np.abs(G) @ np.abs(y)), violated, 0.0)
            violated[active] = 0.0
            p = int(np.argmax(violated))
            short = violated[p]
            if not short > 0.0:
                return y, lam
        r = np.zeros(k)
        r[order] = np.linalg.solve(R, first[:, p])
        left = np.where(np.abs(rest[:, p]) > SMALLEST * scale[k:], rest[:, p], 0.0)
        gain = float(left @ left)
        blocking = np.flatnonzero(r > SMALLEST * np.abs(r).max(initial=0.0))
        ratios = lam[active][blocking] / r[blocking]
        partial, full = ratios.min(initial=np.inf), short / gain if gain > 0.0 else np.inf
        step = min(partial, full)
        if step == np.inf:
            return None
        lam[active] -= step * r
        lam[p] += step
        short -= step * gain
        if full <= partial:
            active.append(p)
            p = -1
        else:
            dropped = active.pop(int(blocking[np.argmin(ratios)]))
            lam[dropped] = 0.0
    raise ValueError("too many steps")
