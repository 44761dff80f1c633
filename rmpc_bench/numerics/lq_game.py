"""Linear-quadratic game of a minimax control law: a scalar problem per state instead of a semidefinite program.

Problem  Minimise over U, for the worst e in E(0, M) and w(0..N-1), the cost sum_{t=0..N-1} x(t+1)' Q x(t+1) + u' R u of
         x(t+1) = A x + B u + w, x(0) = x_hat + e.  The S-procedure with Lagrange multipliers tau_1, tau_2 gives
         rho = min over tau of tau_1 + tau_2 - x_hat' S x_hat
               + min over U of max over e, w of [cost - tau_1 e' M^-1 e - sum over t of tau_2 w' M_w^-1 w].
         S is the LQ Riccati matrix, so that rho is the cost minus the minimal cost without noise.
Solution For fixed multipliers it is a linear-quadratic game: Pi_N = Q,
         Pi_t = Q + A' Pi (I + (B R^-1 B' - M_w / tau_2) Pi)^-1 A without Q at t = 0.  The same recursion with B = 0
         gives Y_t.  The domain is tau_2 M_w^-1 > Y_t at all t, tau_1 >= lambda_max(M^1/2 Y_0 M^1/2).  The optimum is
         usually on the boundary of the second constraint, where the gradient is not zero.  tau_2 solves log D(s) = 0
         for D = -d(rho - tau_2)/d tau_2 and s = log(tau_2 / tau_min - 1), and log D(s) is nearly linear.
         M and M_w are not inverted and may be singular.
Sets     One multiplier for all stages corresponds to the set sum over t of w' M_w^-1 w <= 1, one multiplier per stage
         to separate ellipsoids for every w(t) (stage_multipliers.py).
Source   ma2025, Theorem 1.  The reduction is an addition; tests compare it with the semidefinite program and with a
         dense form of it.
Cost     The smallest multiplier takes about fifty short passes over the horizon, once per game.  A state then takes
         five passes, or, from a table, (1 + 3 n^2) polynomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, nan
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types import Array


class Game(NamedTuple):
    """A game; axis 0 is the stage t = 0..N-1."""

    A: Float[Array, "N n n"]
    S_B: Float[Array, "N n n"]  # B R^-1 B'
    Q: Float[Array, "N n n"]  # weight of x(t+1)
    G: Float[Array, "N n n"]  # root of the set of w(t)

    def window(self, first: int, length: int) -> Game:
        """Return ``length`` stages starting at ``first``."""
        return Game(*(each[first : first + length] for each in self))


class Solution(NamedTuple):
    """Solution of a game."""

    rho: float
    """Bound of the cost minus the minimal cost without noise."""
    tau_1: float
    """Multiplier of the error of the first state."""
    tau: Float[Array, " N"]
    """Multiplier of the noise of every stage; N equal entries, of which rho contains one, for a common multiplier."""
    x_w: Float[Array, " n"]
    """The worst first state, x_hat + e."""
    first: Float[Array, " n"]
    """Pi_1 T x_w: u(0) = -R^-1 B' first."""


def smallest_multiplier(game: Game) -> float:
    """Return the smallest multiplier tau_min of the noise for which the cost without control is bounded."""
    from rmpc_bench.numerics.game_kernel import smallest_multiplier_kernel

    return float(smallest_multiplier_kernel(game.A, game.Q, game.G))


def solve(game: Game, M_root: Float[Array, "n n"], x: Float[Array, " n"]) -> Solution:
    """Solve the game with a common multiplier of the noise at all stages; M_root is the root of the set of e."""
    return solve_from(game, M_root, np.array(x, dtype=float), smallest_multiplier(game), 0.0)


def solve_from(
    game: Game, M_root: Float[Array, "n n"], x: Float[Array, " n"], tau_min: float, guess: float
) -> Solution:
    """Solve the game as `solve` does, from the smallest multiplier and a guess of s = log(tau_2 / tau_min - 1).

    The compiled code is made for a contiguous and writable x.
    """
    from rmpc_bench.numerics.game_kernel import backward_kernel, first_error_kernel, optimum_kernel

    N, n = game.A.shape[:2]
    X, x_w, top, first, price = np.empty((6, n, n)), np.empty(n), np.empty(n), np.empty(n), 0.0
    if tau_min > 0.0:
        price = tau_min * (1.0 + exp(optimum_kernel(*game, M_root, x, tau_min, guess, X)))
    if not backward_kernel(*game, np.full(N, price if tau_min > 0.0 else 1.0), X, np.empty((2, 0, n, n))):
        return Solution(nan, nan, np.full(N, nan), np.full(n, nan), np.full(n, nan))
    tau_1, _, excess = first_error_kernel(X, M_root, x, x_w, top, first)
    return Solution(price + excess, tau_1, np.full(N, price), x_w, first)


def plan(game: Game, feedback: Float[Array, "N nu n"], solution: Solution) -> Float[Array, "N nu"]:
    """Return all controls of a game, of which the first one is applied; `feedback` is R^-1 B' of every stage."""
    from rmpc_bench.numerics.game_kernel import backward_kernel

    N, n = game.A.shape[:2]
    paths, U, z = np.empty((2, N, n, n)), np.empty(feedback.shape[:2]), solution.x_w
    backward_kernel(*game, np.where(solution.tau > 0.0, solution.tau, 1.0), np.empty((6, n, n)), paths)
    for t in range(N):
        U[t] = -feedback[t] @ paths[1, t] @ z
        z = paths[0, t] @ z
    return U


NODES = 44
"""Number of nodes; the last coefficients are then a few roundings if no eigenvalues cross."""
BELOW, ABOVE = 1.5, 5.5
"""Range of s around the optimum for x_hat = 0; larger states have larger optimal s."""
TAIL = 1e-12
"""Largest relative error of the first control, estimated from the last coefficients."""
ROUGH = 1e-6
"""Largest relative size of the last coefficients of the functions that determine s and the validity of the table."""
TINY = 1e-300
MIDDLE, HALF = 0.5 * (ABOVE - BELOW), 0.5 * (ABOVE + BELOW)


# Tables of games: the functions of s that all runs share; game_kernel.py evaluates them.
#
# At the boundary of the domain, tau_1 = lambda_max(M^1/2 Y_0 M^1/2), the slope D is a quadratic form and the first
# control a linear form of the state, whose matrices depend on s alone.  Chebyshev series of these matrices with `NODES`
# points, around the optimum for x_hat = 0, are computed by the design, so that no result depends on the runs of a
# block.  A table is not used if the last coefficients of a series are not small, as with nearly double eigenvalues, and
# not for a state whose optimum is outside the range of s or in the interior of the domain.  These problems are solved
# individually.


class Tables(NamedTuple):
    """Tables of all k; axis 0 is k."""

    tau_min: Float[Array, " k"]  # smallest multiplier of the noise
    s: Float[Array, " k"]  # optimal s = log(tau / tau_min - 1) for x_hat = 0
    series: Float[Array, "k rows nodes"]  # chebyshev coefficients; game_kernel.py describes the rows
    usable: Bool[Array, " k"]


def tables(games: Sequence[Game], M_roots: Float[Array, "k n n"]) -> Tables:
    """Compute the tables of all k; one root if the sets of e(k) are the same at all k."""
    found = [_table(game, M_roots[k if len(M_roots) > 1 else 0]) for k, game in enumerate(games)]
    tau_min, s, series, usable = zip(*found, strict=True)
    return Tables(np.array(tau_min), np.array(s), np.array(series), np.array(usable))


def _table(game: Game, M_root: Float[Array, "n n"]) -> tuple[float, float, Array, bool]:
    from rmpc_bench.numerics.game_kernel import backward_kernel, optimum_kernel

    N, n, tau_min, s = len(game.A), len(M_root), smallest_multiplier(game), np.nan
    found, paths = np.full((NODES, 6, n, n), np.nan), np.empty((2, 0, n, n))
    offsets = MIDDLE + HALF * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    if tau_min > 0.0:
        s = optimum_kernel(*game, M_root, np.zeros(n), tau_min, 0.0, found[0])
        for offset, X in zip(offsets.tolist(), found, strict=True):
            if not backward_kernel(*game, np.full(N, tau_min * (1.0 + exp(s + offset))), X, paths):
                X[:] = np.nan
    if not np.isfinite(found).all():
        return tau_min, 0.0, np.zeros((1 + 3 * n * n, NODES)), False
    # A table with values that are not finite is not used.
    with np.errstate(all="ignore"):
        groups = [_coefficients(values) for values in _functions(found, M_root, offsets)]
        return tau_min, s, np.concatenate(groups), _is_resolved(*groups)


def _functions(found: Float[Array, "nodes 6 n n"], M_root: Float[Array, "n n"], offsets: Array) -> list[Array]:
    """Return the values of the functions at the nodes, by groups."""
    Pi, _, Y, d_Pi, d_Y, first = np.moveaxis(found, 1, 0)
    lam, V = np.linalg.eigh(M_root @ Pi @ M_root)
    edge, U = np.linalg.eigh(M_root @ Y @ M_root)
    top = np.einsum("ij,kj->ki", M_root, U[:, :, -1])
    f = V.mT @ M_root @ Pi / (edge[:, -1:] - lam)[:, :, None]  # e = M_root V f x_hat
    x_w = np.eye(len(M_root)) + M_root @ V @ f
    E = f.mT @ f
    weight = np.exp(2.0 * offsets)
    alone = -weight * np.einsum("ki,kij,kj->k", top, d_Y, top)
    D = -weight[:, None, None] * (x_w.mT @ d_Pi @ x_w) - alone[:, None, None] * E
    return [alone[:, None], *(each.reshape(NODES, -1) for each in (D, E, first @ x_w))]


def _coefficients(values: Float[Array, "nodes rows"]) -> Float[Array, "rows nodes"]:
    """Return the coefficients of the Chebyshev series through the values at the nodes."""
    degrees = np.arange(NODES)
    basis = np.cos(np.pi * np.outer(degrees, degrees + 0.5) / NODES) * (2.0 / NODES)
    basis[0] *= 0.5
    return (basis @ values).T


def _is_resolved(alone: Array, D: Array, E: Array, first: Array) -> bool:
    """Return whether the last coefficients are small enough."""
    # A relative error of the slope causes an error of s of the same size, which affects the first control through its
    # derivative. Close to the smallest multiplier the slope has few digits, but the first control hardly depends on s.
    tails = [np.abs(each[:, -4:]).max() / max(np.abs(each).max(), TINY) for each in (alone, D, E, first)]
    # An upper bound of the derivative of the first control with respect to s.
    change = (np.abs(first) * np.arange(NODES)).sum(axis=1).max() / HALF
    scale = np.abs(first).max()
    return bool(tails[3] <= TAIL and max(tails[:2]) * change <= TAIL * scale and max(tails[:3]) <= ROUGH)
