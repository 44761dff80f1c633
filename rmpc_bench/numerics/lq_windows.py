"""Linear-quadratic control and games over a receding horizon of a time-varying system, for all k at once.

Cost     sum_{t=k..k+N-1} x(t+1)' Q_t x(t+1) + u(t)' R_t u(t), without a weight of x(k) or a further terminal weight.
Source   Riccati recursion of x' S x + 2 x' s d for x(t+1) = A x + B u + F d with a known vector d.
Game     x(t+1) = A x + B u + w with the penalty tau w' M_w^-1 w, M_w = G G': Pi_t = Q + A' Pi T,
         T = (I + (B R^-1 B' - M_w / tau) Pi)^-1 A.  The game is bounded if every tau M_w^-1 - Pi_{t+1} is positive
         definite.
Effort   N steps on stacks of k matrices; the smallest multiplier takes forty times as many.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import symmetrise
from rmpc_bench.types import Array


class Stages(NamedTuple):
    """A system with its weights; axis 0 is t = 0.. to the end of the last window."""

    A: Float[Array, "t nx nx"]
    B: Float[Array, "t nx nu"]
    Q: Float[Array, "t nx nx"]  # weight of x(t+1)
    R: Float[Array, "t nu nu"]


class WindowLaw(NamedTuple):
    """The first control of every window, u = -K x - K_d d, and the minimal cost."""

    K: Float[Array, "k nu nx"]
    K_d: Float[Array, "k nu m"]
    S: Float[Array, "k nx nx"]  # matrix of the minimal cost x' S x for d = 0


def window_law(stages: Stages, horizon: int, F: Float[Array, "t nx m"]) -> WindowLaw:
    """Return the first controls of all windows; F is the matrix of the known vector d in x(t+1)."""
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
        S = symmetrise(S)
        if t > 0:
            S = S + stages.Q[t - 1 : t - 1 + n_windows]
    return WindowLaw(K, K_d, S)


def game_gains(stages: Stages, G: Float[Array, "t nx nx"], horizon: int, multipliers: Float[Array, " k"]) -> Array:
    """Return the first gains R^-1 B' Pi_1 T of the games of all windows: u = -L x.

    G are roots of the sets of the noise; a ValueError says that a game is not bounded by its multiplier.
    """
    first, bounded = _game(stages, G, horizon, multipliers)
    if not bounded.all():
        raise ValueError("a multiplier is below the smallest one of its game")
    n_windows = len(multipliers)
    return np.linalg.solve(stages.R[:n_windows], stages.B[:n_windows].mT @ first)


def smallest_multipliers(stages: Stages, G: Float[Array, "t nx nx"], horizon: int) -> Float[Array, " k"]:
    """Return the smallest multiplier with a bounded game of each window: the square of an H-infinity norm.

    Found by bisection; 0 if noise has no effect on the cost.
    """
    # An upper bound, as the effect of the noise is larger without control.
    high = noise_sizes(stages, G, horizon)
    low = np.zeros_like(high)
    while (high - low > 1e-12 * high).any():
        middle = 0.5 * (low + high)
        bounded = _game(stages, G, horizon, middle)[1]
        low, high = np.where(bounded, low, middle), np.where(bounded, middle, high)
    return high


def noise_sizes(stages: Stages, G: Float[Array, "t nx nx"], horizon: int) -> Float[Array, " k"]:
    """Return the trace of the map from all noise to the cost of each window without control.

    It is an upper bound of the smallest multiplier; not finite if the cost overflows.
    """
    n_windows = len(stages.A) - horizon + 1
    Y, total = stages.Q[horizon - 1 :], np.zeros(n_windows)
    # The caller checks for values that are not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        for t in range(horizon - 1, -1, -1):
            A, now = stages.A[t : t + n_windows], G[t : t + n_windows]
            total += np.trace(now.mT @ Y @ now, axis1=1, axis2=2)
            Y = A.mT @ Y @ A + (stages.Q[t - 1 : t - 1 + n_windows] if t > 0 else 0.0)
    return total


def _game(
    stages: Stages, G: Float[Array, "t nx nx"], horizon: int, multipliers: Float[Array, " k"]
) -> tuple[Float[Array, "k nx nx"], Bool[Array, " k"]]:
    """Return Pi_1 T of every window, and whether its game is bounded; a multiplier 0 means no noise."""
    n_windows, nx = len(multipliers), stages.A.shape[1]
    share = np.divide(1.0, multipliers, out=np.zeros(n_windows), where=multipliers > 0.0)[:, None, None]
    Pi, first, bounded = stages.Q[horizon - 1 :], np.zeros(0), np.ones(n_windows, dtype=bool)
    # Windows with an unbounded game may overflow.
    with np.errstate(all="ignore"):
        for t in range(horizon - 1, -1, -1):
            A, B, now, R = (each[t : t + n_windows] for each in (stages.A, stages.B, G, stages.R))
            bounded &= np.linalg.eigvalsh(share * (now.mT @ Pi @ now))[:, -1] < 1.0
            Pi = np.where(bounded[:, None, None], Pi, 0.0)
            S_B = B @ np.linalg.solve(R, B.mT)
            first = Pi @ np.linalg.solve(np.eye(nx) + (S_B - share * (now @ now.mT)) @ Pi, A)
            Pi = A.mT @ first
            Pi = symmetrise(Pi) + (stages.Q[t - 1 : t - 1 + n_windows] if t > 0 else 0.0)
    return first, bounded


# Worst bounded noise for a fixed sequence of controls: a lower bound of the largest cost by local maximisation.
#
# Problem  Maximise sum_t x(t+1)' Q x(t+1) + u' R u of x(t+1) = A x + B u + w, x(0) = x_hat + e over e in E(0, M) and
#          every w(t) in E(0, M_w(t)): a convex function on a product of ellipsoids, whose maxima are extreme points.
#          With `shared` all w(t) together are in one ellipsoid, sum over t of w' M_w^-1 w <= 1.
# Method   Every step moves to the maximiser of the linearised cost on each ellipsoid.  A convex function lies above its
#          tangent planes, so that no step decreases the cost.  The result is a lower bound; the maximum is NP-hard.

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
