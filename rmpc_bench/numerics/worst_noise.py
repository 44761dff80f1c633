"""Worst bounded noise for a fixed sequence of controls: a lower bound of the largest cost by local maximisation.

Problem  Maximise sum_t x(t+1)' Q x(t+1) + u' R u of x(t+1) = A x + B u + w, x(0) = x_hat + e over e in E(0, M) and
         every w(t) in E(0, M_w(t)): a convex function on a product of ellipsoids, whose maxima are extreme points.
         With `shared` all w(t) together are in one ellipsoid, sum over t of w' M_w^-1 w <= 1.
Method   Every step moves to the maximiser of the linearised cost on each ellipsoid.  A convex function lies above its
         tangent planes, so that no step decreases the cost.  The result is a lower bound; the maximum is NP-hard.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.lq_windows import Stages
from rmpc_bench.types import Array

MOST_STEPS = 10_000
GAIN = 1e-13
"""The search ends when a step increases the cost by less than this share."""


def worst_cost(
    stages: Stages,
    U: Float[Array, "N nu"],
    x: Float[Array, " nx"],
    M_root: Float[Array, "nx nx"],
    G: Float[Array, "N nx nx"],
    starts: int,
    *,
    shared: bool = False,
) -> float:
    """Return the largest cost found from several starts, random ones that are the same at every call.

    With `shared` all w(t) are in one ellipsoid, else each is in its own.
    """
    N, nx = stages.A.shape[:2]
    generator = np.random.Generator(np.random.PCG64(starts))
    points = generator.standard_normal((starts, N + 1, nx))
    maps, forced = np.concatenate([M_root[None], G]), np.einsum("tij,tj->ti", stages.B, U)
    moves = float(np.einsum("ti,tij,tj->", U, stages.R, U))
    best = np.full(starts, -np.inf)
    for _ in range(MOST_STEPS):
        length = np.linalg.norm(points, axis=2, keepdims=True)
        if shared:
            length[:, 1:] = np.linalg.norm(length[:, 1:], axis=1, keepdims=True)
        noise = np.einsum("tij,btj->bti", maps, points / np.where(length > 0.0, length, 1.0))
        cost, gradient = _cost(stages, forced, x, noise)
        if not (cost > best + GAIN * np.abs(cost)).any():
            break
        best = np.maximum(best, cost)
        points = np.einsum("tji,btj->bti", maps, gradient)
    return float(best.max()) + moves


def _cost(
    stages: Stages, forced: Float[Array, "N nx"], x: Float[Array, " nx"], noise: Float[Array, "b stages nx"]
) -> tuple[Float[Array, " b"], Float[Array, "b stages nx"]]:
    """Return the cost of the states and half its gradient with respect to the noise, e first."""
    now, cost, weighted = x + noise[:, 0], np.zeros(len(noise)), []
    for t, push in enumerate(forced):
        now = now @ stages.A[t].T + push + noise[:, t + 1]
        weighted.append(now @ stages.Q[t])
        cost += (now * weighted[t]).sum(axis=1)
    gradient, behind = np.empty_like(noise), np.zeros_like(now)
    for t in range(len(forced) - 1, -1, -1):
        gradient[:, t + 1] = weighted[t] + behind
        behind = gradient[:, t + 1] @ stages.A[t]
    gradient[:, 0] = behind
    return cost, gradient
