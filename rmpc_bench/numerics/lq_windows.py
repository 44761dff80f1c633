"""Linear-quadratic control over a receding horizon of a system that varies: the windows of all k at once.

Cost     sum_{t=k..k+N-1} x(t+1)' Q_t x(t+1) + u(t)' R_t u(t), from x(k) on; nothing weighs x(k), nothing else the end.
Source   the Riccati recursion of x' S x + 2 x' s d for x(t+1) = A x + B u + F d with a known vector d.
Effort   N steps on stacks of k matrices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array


class Stages(NamedTuple):
    """A system with its weights; axis 0 is t = 0.. to the end of the last window."""

    A: Float[Array, "t nx nx"]
    B: Float[Array, "t nx nu"]
    Q: Float[Array, "t nx nx"]
    """Weight of x(t+1)."""
    R: Float[Array, "t nu nu"]


class WindowLaw(NamedTuple):
    """The first control of every window, u = -K x - K_d d, and what it leads to."""

    K: Float[Array, "k nu nx"]
    K_d: Float[Array, "k nu m"]
    S: Float[Array, "k nx nx"]
    """The least cost from x is x' S x for d = 0."""


def window_law(stages: Stages, horizon: int, F: Float[Array, "t nx m"]) -> WindowLaw:
    """First controls of all windows of a length.

    Parameters
    ----------
    stages : system and weights
    horizon : N
    F : how a known vector d enters x(t+1)
    """
    n_windows = len(stages.A) - horizon + 1
    S, s = stages.Q[horizon - 1 :], np.zeros((n_windows, *F.shape[1:]))
    K = K_d = np.zeros(0)
    for t in range(horizon - 1, -1, -1):
        A, B, now, R = (each[t : t + n_windows] for each in (stages.A, stages.B, F, stages.R))
        from_d = S @ now + s
        gains = np.linalg.solve(R + B.mT @ S @ B, B.mT @ np.concatenate([S @ A, from_d], axis=2))
        K, K_d = gains[:, :, : A.shape[2]], gains[:, :, A.shape[2] :]
        closed = A - B @ K
        S, s = A.mT @ S @ closed, closed.mT @ from_d
        S = 0.5 * (S + S.mT)
        if t > 0:
            S = S + stages.Q[t - 1 : t - 1 + n_windows]
    return WindowLaw(K, K_d, S)
