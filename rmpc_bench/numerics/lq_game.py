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

from math import exp, nan
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array


class Game(NamedTuple):
    """A game; axis 0 is the stage t = 0..N-1."""

    A: Float[Array, "N n n"]
    S_B: Float[Array, "N n n"]
    """B R^-1 B'."""
    Q: Float[Array, "N n n"]
    """Weight of x(t+1)."""
    G: Float[Array, "N n n"]
    """Root of the set of w(t)."""

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
    """Solve the game with a common multiplier of the noise at all stages.

    Parameters
    ----------
    game : the game
    M_root : root of the set of e
    x : estimate x_hat
    """
    return solve_from(game, M_root, np.array(x, dtype=float), smallest_multiplier(game), 0.0)


def solve_from(
    game: Game, M_root: Float[Array, "n n"], x: Float[Array, " n"], tau_min: float, guess: float
) -> Solution:
    """Solve the game as `solve` does, from a known smallest multiplier and a first guess of s.

    Parameters
    ----------
    game : the game
    M_root : root of the set of e
    x : estimate x_hat, contiguous and writable, as the compiled code is made for such arrays
    tau_min : smallest multiplier of the noise
    guess : s = log(tau_2 / tau_min - 1) at which the search starts
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
    """Return all controls of a game, of which the first one is applied.

    Parameters
    ----------
    game : the game
    feedback : R^-1 B' of every stage
    solution : solution of the game
    """
    from rmpc_bench.numerics.game_kernel import backward_kernel

    N, n = game.A.shape[:2]
    paths, U, z = np.empty((2, N, n, n)), np.empty(feedback.shape[:2]), solution.x_w
    backward_kernel(*game, np.where(solution.tau > 0.0, solution.tau, 1.0), np.empty((6, n, n)), paths)
    for t in range(N):
        U[t] = -feedback[t] @ paths[1, t] @ z
        z = paths[0, t] @ z
    return U
