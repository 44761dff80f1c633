"""Linear-quadratic game with one Lagrange multiplier per stage: the tightest of the three bounds.

Problem  That of lq_game.py with multiplier tau_t at stage t: every w(t) has its own ellipsoid, and rho is the minimum
         over all multipliers.
Form     With noises v of unit size, e = M_root v_0 and w(t) = G_t v_{t+1}: T v are the states caused by the noise
         without control, each times the root of its weight.  F v and f are the parts of T v and of the response to
         x_hat that remain with optimal control.  rho(tau) = sum of tau + h' (D(tau) - S)^-1 h, with h = T' f,
         S = T' F and D the block-diagonal matrix of the multipliers, subject to D(tau) >= C = T' T.  rho is convex,
         and smooth in the interior; the optimum is usually on the boundary.
Solution Primal-dual interior-point method with predictor and corrector steps (Mehrotra): dual matrix Z of W = D - C and
         eta = (D - S)^-1 h, with |eta_t|^2 + trace Z_tt = 1 for every block at the optimum.  Any Z and eta, scaled to
         satisfy this, give the lower bound 2 h' eta + eta' S eta + trace C Z, which bounds the distance to the optimum.
Source   ma2025, Theorem 1, with separate multipliers; tests compare it with the semidefinite program.
Cost     10 to 20 steps of (N n)^3 multiplications each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import psd_sqrt, symmetrise
from rmpc_bench.numerics.lq_game import Game, Solution, solve
from rmpc_bench.types import Array

GAP = 1e-9
"""Relative duality gap at which the search ends."""
MOST_STEPS = 100
START = 0.3
"""Initial duality gap divided by rho."""
BEFORE = 0.98
"""Largest share of the step to the boundary."""
NOTHING = 1e-30
"""Noise with a smaller share of the largest effect is omitted; it changes the bound by the root of that share."""
NEXT_TO_NOTHING = 1e-20
"""Multiplier, divided by rho, of noise without effect; not zero, because a recursion divides by it."""


class Form(NamedTuple):
    """The game as a single step with noises of unit size; the error of the first state precedes the noises."""

    T: Float[Array, "states noises"]  # states caused by noise without control, each times the root of its weight
    F: Float[Array, "states noises"]  # states caused by noise with optimal control
    f: Float[Array, " states"]  # states caused by x_hat with optimal control


class StageMultipliers(NamedTuple):
    """Result of the search."""

    rho: float
    tau: Float[Array, " blocks"]  # multiplier of every block
    eta: Float[Array, " noises"]  # the worst noise; the norm of every block is at most 1
    low: float  # a lower bound of the minimal rho


def solve_stages(game: Game, M_root: Float[Array, "n n"], x: Float[Array, " n"]) -> Solution:
    """Solve the game with one multiplier per stage.

    game.G is the root of the set of w(t) at each stage, M_root that of e.

    The duality gap at the end is below 1e-9 rho; this held for all 4000 test states, with singular sets, missing noise,
    A_0 = 0 and N up to 100.  If the search does not improve it, the result is the solution with a common multiplier
    for the set N M_w.  Noise without effect has the multiplier 1e-20 rho.  With a singular M, the recursion with these
    multipliers may give another tau_1, which changes rho by up to 2e-7 by rounding.
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
    """Write the game as a single step."""
    T = _reach(game, M_root, game.G)
    alone = _reach(game, x[:, None], psd_sqrt(game.S_B))
    E = alone[:, 1:]
    left = np.linalg.solve(np.eye(len(E)) + E @ E.T, np.column_stack([T, alone[:, 0]]))
    return Form(T, np.ascontiguousarray(left[:, :-1]), np.ascontiguousarray(left[:, -1]))


def search(
    T: Float[Array, "states noises"], F: Float[Array, "states noises"], f: Float[Array, " states"], n: int
) -> StageMultipliers:
    """Compute the multipliers of the blocks of noise, of size n, by a primal-dual method."""
    C, S, h = symmetrise(T.T @ T), symmetrise(T.T @ F), T.T @ f
    size = np.sqrt(_traces(C, n))
    # In the interior of the domain, by the Cauchy-Schwarz inequality.
    tau = 2.0 * size * size.sum() + np.linalg.norm(h.reshape(-1, n), axis=1)
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
        # Rounding has led to the boundary: the best solution so far is the result.
        except np.linalg.LinAlgError:
            break
        tau, Z = tau + d_tau, Z + d_Z
    return found


def _step(
    W: Array, L_inv: Array, Z: Array, G_inv: Array, eta: Float[Array, " d"], n: int
) -> tuple[Float[Array, " m"], Float[Array, "d d"]]:
    """Return the change of tau and Z: Newton steps on W Z = mu, for mu = 0, which determines mu, then for that mu."""
    # Both have the same step length, which ends before the boundary; separate lengths took up to three times more
    # steps.
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


def _lower(C: Array, S: Array, h: Float[Array, " d"], Z: Array, eta: Float[Array, " d"], n: int) -> float:
    """Return a lower bound of rho(tau) for all tau from Z and eta, scaled so that |eta_t|^2 + trace Z_tt = 1."""
    scale = np.repeat(1.0 / np.sqrt((eta.reshape(-1, n) ** 2).sum(axis=1) + _traces(Z, n)), n)
    z = scale * eta
    return float(2.0 * h @ z + z @ S @ z + scale @ (C * Z) @ scale)


def _traces(X: Float[Array, "d d"], n: int) -> Float[Array, " m"]:
    """Return the traces of the diagonal blocks."""
    return np.asarray(np.diag(X).reshape(-1, n).sum(axis=1))


def _reach(game: Game, first: Float[Array, "n k"], maps: Float[Array, "N n n"]) -> Float[Array, "states inputs"]:
    """Return the weighted states without control as responses to the first state and to the inputs of every stage."""
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
    """Return half the gradient of the cost with respect to x(1), from the weighted states."""
    weighted = np.einsum("tij,tj->ti", psd_sqrt(game.Q), y)
    slope = weighted[-1]
    for t in range(len(y) - 2, -1, -1):
        slope = game.A[t + 1].T @ slope + weighted[t]
    return np.asarray(slope)
