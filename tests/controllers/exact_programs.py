"""Programs of predictive control in exact arithmetic: all active sets of box limits, in 400 digits."""

from __future__ import annotations

from itertools import product

import mpmath as mp
import numpy as np

DIGITS = 400


def matrix(values):
    """Return an array as a matrix of exact binary numbers."""
    return mp.matrix(np.atleast_2d(np.asarray(values, dtype=float)).tolist())


def cost_of(A, B, C, Q, R, x, r, Hp, Hu, before=None):
    """Return H and g of 1/2 v' H v + g' v in the inputs v(0..Hu-1), the last of which is held, and the weight of them.

    With `before`, u(k-1), the increments are weighed, otherwise the inputs.
    """
    A, B, C, Q, R, x, r = (matrix(each) for each in (A, B, C, Q, R, np.reshape(x, (-1, 1)), np.reshape(r, (-1, 1))))
    nu, H, g = B.cols, mp.zeros(Hu * B.cols), mp.zeros(Hu * B.cols, 1)
    state, moved = x, mp.zeros(A.rows, Hu * nu)
    for j in range(Hp):
        moved = A * moved
        at = min(j, Hu - 1) * nu
        for i in range(A.rows):
            for m in range(nu):
                moved[i, at + m] += B[i, m]
        state = A * state
        seen = C * moved
        H += seen.T * Q * seen
        g += seen.T * Q * (C * state - r)
    D, first = mp.eye(Hu * nu), mp.zeros(Hu * nu, 1)
    if before is not None:
        for i in range(nu, Hu * nu):
            D[i, i - nu] = -1
        for m in range(nu):
            first[m] = mp.mpf(float(np.ravel(before)[m]))
    W = mp.zeros(Hu * nu)
    for i in range(Hu * nu):
        for m in range(nu):
            W[i, i - i % nu + m] = R[i % nu, m]
    return H + D.T * W * D, g - D.T * W * first


def boxed_minimum(H, g, low, high):
    """Return the minimum over low <= v <= high, by its active set: signs of multipliers and bounds hold exactly."""
    n = H.rows
    for sides in sorted(product((0, -1, 1), repeat=n), key=lambda each: sum(map(abs, each))):
        free = [i for i in range(n) if not sides[i]]
        v = mp.matrix([low if side < 0 else high if side > 0 else 0 for side in sides])
        if free:
            part = mp.matrix([[H[i, j] for j in free] for i in free])
            rest = mp.matrix([-g[i] - sum((H[i, j] * v[j] for j in range(n) if sides[j]), mp.mpf(0)) for i in free])
            for i, value in zip(free, mp.lu_solve(part, rest), strict=True):
                v[i] = value
        slope = H * v + g
        if all(low <= v[i] <= high for i in free) and all(slope[i] * sides[i] <= 0 for i in range(n)):
            return np.array([float(each) for each in v])
    raise AssertionError("no active set")
