"""A window of the moving-horizon estimator as a plain least-squares problem, written a second time.

Unknowns are the first state and the noises w of all steps.  Nothing here comes from the estimator: the covariances of
the predictions are those of a Riccati recursion with inverses.
"""

from itertools import product
from typing import NamedTuple

import numpy as np


class Window(NamedTuple):
    """Samples first..last of a system x+ = A x + c + G (w + mean), y = C x + v, over k."""

    A: np.ndarray
    G: np.ndarray
    C: np.ndarray
    W: np.ndarray
    R_v: np.ndarray
    P_bar: np.ndarray
    x_bar: np.ndarray
    c: np.ndarray
    y: np.ndarray

    @property
    def steps(self):
        return len(self.c)

    def maps(self):
        """Matrices and constants of all states in the unknowns."""
        nx, nw = self.G.shape[1:]
        n = nx + self.steps * nw
        S, s = [np.eye(nx, n)], [np.zeros(nx)]
        for j in range(self.steps):
            S.append(self.A[j] @ S[-1])
            S[-1][:, nx + j * nw : nx + (j + 1) * nw] += self.G[j]
            s.append(self.A[j] @ s[-1] + self.c[j])
        return np.array(S), np.array(s)

    def least_squares(self):
        """M and b of the cost |M z - b|^2 / 2; missing outputs are left out."""
        nx, nw = self.G.shape[1:]
        S, s = self.maps()
        n, blocks, sides = S.shape[2], [], []
        root = np.linalg.inv(np.linalg.cholesky(self.P_bar))
        blocks.append(root @ np.eye(nx, n))
        sides.append(root @ self.x_bar)
        for j in range(self.steps):
            blocks.append(np.linalg.inv(np.linalg.cholesky(self.W[j])) @ np.eye(nw, n, nx + j * nw))
            sides.append(np.zeros(nw))
        for j, y in enumerate(self.y):
            there = ~np.isnan(y)
            if there.any():
                root = np.linalg.inv(np.linalg.cholesky(self.R_v[j][np.ix_(there, there)]))
                blocks.append(root @ self.C[j][there] @ S[j])
                sides.append(root @ (y - self.C[j] @ s[j])[there])
        return np.vstack(blocks), np.concatenate(sides)

    def last(self, z):
        S, s = self.maps()
        return S[-1] @ z + s[-1]


def predicted_covariances(model, P0, y):
    """P_pred over k by the information form, which needs invertible matrices; what is missing in y is left out."""
    found = [P0]
    for k in range(len(y) - 1):
        now, there = model.at(k), ~np.isnan(y[k])
        C, R_v = now.C[there], now.R_v[np.ix_(there, there)]
        P = np.linalg.inv(np.linalg.inv(found[-1]) + C.T @ np.linalg.inv(R_v) @ C)
        found.append(now.A @ P @ now.A.T + now.Q_w)
    return found


def windows(model, noise, start, estimates, data, N):
    """k and window of a run; x_bar comes from the estimate before the window, of its own time.

    `noise` gives (G, W) at k, `start` is (x0, P0), `data` (y, u) of the run.  The constant parts of the model contain
    the means of the noises.
    """
    (x0, P0), (y, u) = start, data
    covariances = predicted_covariances(model, P0, y)
    for k in range(len(y)):
        first = max(k - N, 0)
        now = [model.at(j) for j in range(first, k + 1)]
        x_bar = x0
        if first > 0:
            m = model.at(first - 1)
            x_bar = m.A @ estimates[first - 1] + m.B @ u[first - 1] + m.f0
        # The matrices of the last sample are not used in a step.
        G, W = (np.array(each) for each in zip(*(noise(j) for j in range(first, k + 1)), strict=True))
        A, C, R_v = (np.array([getattr(m, name) for m in now]) for name in ("A", "C", "R_v"))
        c = np.array([m.B @ u[j] + m.f0 for j, m in enumerate(now, first)])[: k - first]
        rest = np.array([y[j] - m.d0 for j, m in enumerate(now, first)])
        yield k, Window(A, G, C, W, R_v, covariances[first], x_bar, c, rest)


def by_enumeration(M, b, bounded, low):
    """Minimum of |M z - b|^2 over z[bounded] >= low, by all sets of active bounds; the cost and z."""
    best, found = np.inf, None
    for active in product([False, True], repeat=len(bounded)):
        fixed = np.asarray(bounded, dtype=int)[list(active)]
        free = np.setdiff1d(np.arange(M.shape[1]), fixed)
        z = np.zeros(M.shape[1])
        z[fixed] = low
        z[free] = np.linalg.lstsq(M[:, free], b - M[:, fixed] @ z[fixed], rcond=None)[0]
        cost = np.sum((M @ z - b) ** 2)
        if (z[bounded] >= low - 1e-9).all() and cost < best:  # a bound is met to the rounding of the least squares
            best, found = cost, z
    return best, found
