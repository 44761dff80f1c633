"""The linear-quadratic game with a price of its own for the noise of every stage: the tightest bound of the three.

Problem  lq_game.py's, with tau_t at stage t: every w(t) has its own ellipsoid, and rho = min over all multipliers.
Form     in noises v of unit size, e = M_root v_0 and w(t) = G_t v_{t+1}, with T v the states that they cause without
         control, each times the root of its weight, F v and f what control leaves of T v and of x_hat:
         rho(tau) = sum of tau + h' (D(tau) - S)^-1 h, with h = T' f, S = T' F and D the multipliers along the diagonal,
         where D(tau) >= C = T' T.  It is convex and smooth inside; the optimum lies on the edge as a rule.
Solution a primal-dual path inside the domain, with the steps of Mehrotra: Z of W = D - C and eta = (D - S)^-1 h, with
         |eta_t|^2 + trace Z_tt = 1 for every block at the optimum.  Any Z and eta scaled to that give a lower bound,
         2 h' eta + eta' S eta + trace C Z, so that the search knows how far it is.
Source   the multipliers of ma2025, Theorem 1, taken apart; tests: it equals the semidefinite program.
Cost     some 10 to 20 steps of (N n)^3 multiplications each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import psd_sqrt, symmetrise
from rmpc_bench.numerics.lq_game import Game, Solution, solve
from rmpc_bench.types import Array

GAP = 1e-9
"""Distance of the two bounds, relative, at which the search ends."""
MOST_STEPS = 100
START = 0.3
"""Of the gap that Z starts with, over rho."""
BEFORE = 0.98
"""Share of the way to the edge that a step may go."""
NOTHING = 1e-30
"""Share of the largest effect below which noise has none; it moves the bound by the root of that."""
NEXT_TO_NOTHING = 1e-20
"""Price of noise without effect, over rho: a recursion divides by it."""


class Form(NamedTuple):
    """The game as one step in noises of unit size, that of the first state before those of the stages."""

    T: Float[Array, "states noises"]
    """States, each times the root of its weight, that noise causes without control."""
    F: Float[Array, "states noises"]
    """What control leaves of them."""
    f: Float[Array, " states"]
    """What control leaves of those that x_hat causes."""


class StageMultipliers(NamedTuple):
    """What the search has found."""

    rho: float
    tau: Float[Array, " blocks"]
    eta: Float[Array, " noises"]
    """The worst noise, of unit size in every block at most."""
    low: float
    """A lower bound of the least rho."""


def solve_stages(game: Game, M_root: Float[Array, "n n"], x: Float[Array, " n"]) -> Solution:
    """Solve the game with one price per stage.

    The search ends within 1e-9 of the least bound, relative, as its lower bound shows: in all of 4000 states tried,
    with flat sets, missing noise, A_0 = 0 and N up to 100.  Where it finds nothing better, the result is the optimum of
    one price for all stages, in which w fills N M_w.  Noise without effect has a price of 1e-20 rho.  With a flat M the
    recursion at the same multipliers of the stages may have tau_1 so far away that rho moves by 2e-7, by rounding.

    Parameters
    ----------
    game : the game; G is the root of the set of w(t) at each stage
    M_root : root of the set of e
    x : estimate x_hat
    """
    x, (N, n) = np.ascontiguousarray(x, dtype=float), game.A.shape[:2]
    start = solve(game._replace(G=game.G * np.sqrt(N)), M_root, x)
    start = start._replace(tau=start.tau / N)
    if N == 1:
        return start
    form = make_form(game, M_root, x)
    size = (form.T**2).sum(axis=0).reshape(N + 1, n).sum(axis=1)
    matters = size > NOTHING * size.max()
    if not matters[1:].any():
        return start
    kept = np.repeat(matters, n)
    found = search(form.T[:, kept], form.F[:, kept], form.f, n)
    if start.rho <= found.rho or not np.isfinite(found.rho):
        return start
    tau, eta = np.full(N + 1, found.rho * NEXT_TO_NOTHING), np.zeros(kept.size)
    tau[matters], eta[kept] = found.tau, found.eta
    first = _costate(game, (form.F @ eta + form.f).reshape(N, n))
    return Solution(found.rho, float(tau[0]), tau[1:], x + M_root @ eta[:n], first)


def make_form(game: Game, M_root: Float[Array, "n n"], x: Float[Array, " n"]) -> Form:
    """Write the game as one step.

    Parameters
    ----------
    game : the game
    M_root : root of the set of e
    x : estimate x_hat
    """
    T = _reach(game, M_root, game.G)
    alone = _reach(game, x[:, None], psd_sqrt(game.S_B))
    E = alone[:, 1:]
    left = np.linalg.solve(np.eye(len(E)) + E @ E.T, np.column_stack([T, alone[:, 0]]))
    return Form(T, np.ascontiguousarray(left[:, :-1]), np.ascontiguousarray(left[:, -1]))


def search(
    T: Float[Array, "states noises"], F: Float[Array, "states noises"], f: Float[Array, " states"], n: int
) -> StageMultipliers:
    """Find the multipliers of some blocks of noise, by a primal-dual path.

    Parameters
    ----------
    T, F, f : the form
    n : size of a block
    """
    C, S, h = symmetrise(T.T @ T), symmetrise(T.T @ F), T.T @ f
    size = np.sqrt(_traces(C, n))
    tau = 2.0 * size * size.sum() + np.linalg.norm(h.reshape(-1, n), axis=1)  # inside, by Cauchy and Schwarz
    found, Z = StageMultipliers(np.inf, tau, h, -np.inf), np.zeros_like(C)
    for number in range(MOST_STEPS):
        try:
            D = np.diag(np.repeat(tau, n))
            L_inv = np.linalg.inv(np.linalg.cholesky(D - C))
            G_inv = np.linalg.inv(D - S)
            eta = G_inv @ h
            rho = float(tau.sum() + h @ eta)
            if number == 0:
                Z = START * rho / len(h) * (L_inv.T @ L_inv)
            found = found._replace(low=max(found.low, _lower(C, S, h, Z, eta, n)))
            if rho < found.rho:
                found = found._replace(rho=rho, tau=tau, eta=eta)
            if found.rho - found.low <= GAP * found.rho:
                break
            d_tau, d_Z = _step(D - C, L_inv, Z, G_inv, eta, n)
        except np.linalg.LinAlgError:  # rounding has reached the edge
            break
        tau, Z = tau + d_tau, Z + d_Z
    return found


def _step(
    W: Float[Array, "d d"],
    L_inv: Float[Array, "d d"],
    Z: Float[Array, "d d"],
    G_inv: Float[Array, "d d"],
    eta: Float[Array, " d"],
    n: int,
) -> tuple[Float[Array, " m"], Float[Array, "d d"]]:
    """Change of tau and Z: Newton's on W Z = mu, first for mu = 0, which says how small mu may be, then for that mu.

    Both go equally far, at most to just before the edge; with lengths of their own some cases take three times longer.
    """
    W_inv, (d, m) = L_inv.T @ L_inv, (len(eta), len(eta) // n)
    mu, Z_inv = np.vdot(W, Z) / d, np.linalg.inv(np.linalg.cholesky(Z))
    blocks = W_inv * Z + 2.0 * eta[:, None] * G_inv * eta
    H = blocks.reshape(m, n, m, n).sum(axis=(1, 3))
    residual, traces = (eta.reshape(m, n) ** 2).sum(axis=1) - 1.0, _traces(W_inv, n)

    def newton(mu: float, correction: Float[Array, "d d"]) -> tuple[Array, Array, Array, float]:
        d_tau = np.linalg.solve(H, residual + mu * traces - _traces(correction, n))
        wide = np.repeat(d_tau, n)
        d_Z = mu * W_inv - Z - symmetrise(W_inv @ (wide[:, None] * Z)) - correction
        edge = min(np.linalg.eigvalsh((L_inv * wide) @ L_inv.T)[0], np.linalg.eigvalsh(Z_inv @ d_Z @ Z_inv.T)[0])
        return d_tau, d_Z, wide, min(1.0, BEFORE / -edge) if edge < 0.0 else 1.0

    _, d_Z, wide, length = newton(0.0, np.zeros_like(Z))
    left = np.vdot(W + length * np.diag(wide), Z + length * d_Z) / d
    correction = symmetrise(W_inv @ (wide[:, None] * d_Z))
    d_tau, d_Z, _, length = newton(mu * (left / mu) ** 3, correction)
    return length * d_tau, length * d_Z


def _lower(
    C: Float[Array, "d d"],
    S: Float[Array, "d d"],
    h: Float[Array, " d"],
    Z: Float[Array, "d d"],
    eta: Float[Array, " d"],
    n: int,
) -> float:
    """Lower bound of rho(tau) for all tau, by Z and eta, scaled so that every block counts one."""
    scale = np.repeat(1.0 / np.sqrt((eta.reshape(-1, n) ** 2).sum(axis=1) + _traces(Z, n)), n)
    z = scale * eta
    return float(2.0 * h @ z + z @ S @ z + scale @ (C * Z) @ scale)


def _traces(X: Float[Array, "d d"], n: int) -> Float[Array, " m"]:
    """Traces of the blocks along the diagonal."""
    return np.asarray(np.diag(X).reshape(-1, n).sum(axis=1))


def _reach(game: Game, first: Float[Array, "n k"], maps: Float[Array, "N n n"]) -> Float[Array, "states inputs"]:
    """States, each times the root of its weight, by first states and by what enters at every stage, without control."""
    N, n = game.A.shape[:2]
    weight, width = psd_sqrt(game.Q), first.shape[1]
    now, rows = np.zeros((n, width + N * n)), np.empty((N, n, width + N * n))
    now[:, :width] = first
    for t in range(N):
        now = game.A[t] @ now
        now[:, width + t * n : width + (t + 1) * n] = maps[t]
        rows[t] = weight[t] @ now
    return rows.reshape(N * n, -1)


def _costate(game: Game, y: Float[Array, "N n"]) -> Float[Array, " n"]:
    """Half the slope of the cost by x(1), of the states times the roots of their weights."""
    weighted = np.einsum("tij,tj->ti", psd_sqrt(game.Q), y)
    slope = weighted[-1]
    for t in range(len(y) - 2, -1, -1):
        slope = game.A[t + 1].T @ slope + weighted[t]
    return np.asarray(slope)
