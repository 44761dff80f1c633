"""Minimax linear-quadratic control under stochastic and bounded noise.

Model   At every k, with x(k) - x_hat(k) = e in E(0, M(k)) and w_b(t) in E(0, M_w(t)): choose all u(k..k+N-1) that
        minimise an upper bound of the largest sum_{t=k..k+N-1} x(t+1)' Q_x x(t+1) + u(t)' R_u u(t), in the mean over
        the stochastic noise, and apply u(k).  Future measurements are not modelled, so that v has no effect (ma2025,
        (P_k)).  M and M_w are the sets of the estimator; for an estimator without sets they are the 95 % ellipsoids of
        its P and of Q_w.  It regulates to x = 0, without a reference.  Sets that do not depend on the data are those of
        a run without missing measurements.
Source  ma2025, Theorem 1: the semidefinite program (57), solved exactly by the recursion of numerics/lq_game.py.
Sets    `stacked`  sum over t of w' M_w^-1 w <= 1, as (62) and (65) are printed.  It excludes admissible noise
                   sequences, so that rho is not a bound for the stated problem.
        `product`  M_w -> N M_w, which contains every sequence of admissible w(t): rho is a bound.
        `stages`   one multiplier per stage: rho is the tightest bound of the three (one search per state: slow).
Limit   M = 0 and M_w = 0 give the control of lqr.
Cost    stacked, product: tables for all k, once per method. stages: one search per state, 10 to 20 times (N n)^3.
Fails   Design error: a weight is not admissible, the model has constant parts, or noise grows beyond 1e100 over the
        horizon.  With R_u = 1e-8 Q_x nine digits of rho and seven digits of u are correct.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.state_feedback import Regulator, game_of, noise_roots, refuse_mean, stages_of
from rmpc_bench.models.noise_sets import LEVEL
from rmpc_bench.numerics.ellipsoid import confidence
from rmpc_bench.numerics.linalg import as_compiled, at_sample, mv, psd_sqrt
from rmpc_bench.numerics.lq_game import (
    HALF,
    MIDDLE,
    Game,
    Solution,
    Tables,
    plan,
    smallest_multiplier,
    solve,
    solve_from,
    tables,
)
from rmpc_bench.numerics.lq_windows import Stages, window_law, worst_cost
from rmpc_bench.numerics.stage_multipliers import solve_stages
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Horizon, Matrix, Model

EQUATION = r"\min_u \max_{e, w^b} \mathrm{E} \sum_{t=k}^{k+N-1} x_{t+1}^\top Q_x x_{t+1} + u_t^\top R_u u_t"


@dataclass(frozen=True, eq=False)
class MinimaxLq(Regulator):
    """The minimax law; create it with `design`."""

    stages: Stages  # system and weights to the end of the last window
    horizon: int  # N
    set: str  # noise sequences that the bound includes
    M_roots: Float[Array, "k nx nx"] | None  # roots of the sets of e, axis 0 = k; None if they depend on the data
    w_roots: Float[Array, "t nx nx"]  # roots of the sets of w

    allows_delay = False
    allows_late_outputs = False

    def input_of(self, k: int, estimate: Estimate) -> Float[Array, "runs nu"]:
        """Return the first inputs of the minimisers at k."""
        M_roots = _stacked_roots(estimate.M) if self.M_roots is None else at_sample(self.M_roots, k)[None]
        x = np.ascontiguousarray(estimate.x_hat)
        first = self._first_of_stages(k, M_roots, x) if self.set == "stages" else self._first(k, M_roots, x)
        return -mv(self._feedback[k], first)

    @property
    def certifies(self) -> bool:
        """Whether `certificate` is available: the sets of the errors do not depend on the data."""
        return self.M_roots is not None

    def certificate(
        self, k: int, x_hat: Float[Array, "runs nx"], starts: int, *, shared: bool = False
    ) -> tuple[Float[Array, " runs"], Float[Array, " runs"]]:
        """Return rho and the largest cost found for admissible noise, both minus the minimal cost without noise.

        With `shared` the search admits noise in one ellipsoid for all stages only.
        """
        assert self.M_roots is not None, "`certificate` needs `certifies`"
        window, M_root = slice(k, k + self.horizon), at_sample(self.M_roots, k)
        stages = Stages(*(each[window] for each in self.stages))
        S = window_law(stages, self.horizon, np.zeros((self.horizon, len(M_root), 1))).S[0]
        rho, worst = np.empty(len(x_hat)), np.empty(len(x_hat))
        x_hat = x_hat if self.point is None else x_hat - self.point.x
        for row, x in enumerate(x_hat):
            found = self.solution(k, M_root, x)
            U = plan(self.game(k), self._feedback[window], found)
            rho[row] = found.rho
            found_cost = worst_cost(stages, U, x, M_root, self.w_roots[window], starts, shared=shared)
            worst[row] = found_cost - x @ S @ x
        return rho, worst

    def game(self, k: int) -> Game:
        """Return the game at k."""
        return self._game.window(k, self.horizon)

    def solution(self, k: int, M_root: Float[Array, "nx nx"], x: Float[Array, " nx"]) -> Solution:
        """Solve the game exactly for one state."""
        return (solve_stages if self.set == "stages" else solve)(self.game(k), M_root, x)

    def warm_up(self) -> None:
        """Compute the tables, which loads compiled code, before the design is sent to workers."""
        # The set `stages` has one multiplier per stage and no tables.
        if self.set != "stages":
            _ = self._smallest_multipliers if self.M_roots is None else self._tables

    @cached_property
    def _game(self) -> Game:
        wider = np.sqrt(self.horizon) if self.set == "product" else 1.0
        return game_of(self.stages, self.w_roots * wider)

    @cached_property
    def _feedback(self) -> Float[Array, "t nu nx"]:
        """R_u^-1 B'."""
        return np.linalg.solve(self.stages.R, self.stages.B.mT)

    def _games(self) -> list[Game]:
        return [self.game(k) for k in range(len(self.stages.A) - self.horizon + 1)]

    @cached_property
    def _smallest_multipliers(self) -> list[float]:
        """Smallest multipliers at all k, used without tables if the sets of e depend on the data."""
        return [smallest_multiplier(game) for game in self._games()]

    @cached_property
    def _tables(self) -> Tables:
        assert self.M_roots is not None, "tables need sets that do not depend on the data"
        return tables(self._games(), self.M_roots)

    def _first(self, k: int, M_roots: Float[Array, "sets nx nx"], x: Float[Array, "runs nx"]) -> Array:
        from rmpc_bench.numerics.game_kernel import lookup_kernel

        x, holds = as_compiled(x), np.zeros(len(x), dtype=bool)
        first = np.full_like(x, np.nan)
        if self.M_roots is None:
            multiplier, guess = self._smallest_multipliers[k], 0.0
        else:
            made = self._tables
            multiplier, guess = made.tau_min[k], made.s[k]
            if made.usable[k]:
                lookup_kernel(made.series[k], MIDDLE, HALF, x, first, holds)
        first[~holds] = np.nan
        for row in np.flatnonzero(~holds & np.isfinite(x).all(axis=1)):
            M_root = M_roots[row if len(M_roots) > 1 else 0]
            if np.isfinite(M_root).all():
                first[row] = solve_from(self.game(k), M_root, x[row], multiplier, guess).first
        return first

    def _first_of_stages(self, k: int, M_roots: Float[Array, "sets nx nx"], x: Float[Array, "runs nx"]) -> Array:
        first = np.full_like(x, np.nan)
        for row in np.flatnonzero(np.isfinite(x).all(axis=1)):
            M_root = M_roots[row if len(M_roots) > 1 else 0]
            if np.isfinite(M_root).all():
                first[row] = self.solution(k, M_root, x[row]).first
        return first


def design(
    model: Model,
    n_steps: int,
    estimator: Estimator,
    *,
    horizon: Horizon,
    Q_x: Matrix,
    R_u: Matrix,
    set: Literal["stacked", "product", "stages"] = "stacked",
) -> MinimaxLq:
    """Minimax linear-quadratic control of the estimate over a receding horizon.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods; the games are those of k = 0..n_steps-1
    estimator : estimator of the method, for the sets of the estimation error and of the process noise
    horizon : N [samples]
    Q_x : weight of the state
    R_u : weight of the input, positive definite
    set : admissible noise sequences: `stacked`, `product` or `stages`

    Raises
    ------
    DesignError
        If a weight is not admissible, the process noise has a mean, or noise grows beyond 1e100 over the horizon.
    """
    model.refuse_feedthrough("minimax-lq")
    stages = stages_of(model, n_steps, horizon, Q_x, R_u)
    refuse_mean(model, estimator, stages)
    w_roots = noise_roots(model, estimator, stages, horizon)
    return MinimaxLq(stages, horizon, set, _error_roots(estimator), w_roots, point=model.operating_point)


def _error_roots(estimator: Estimator) -> Float[Array, "k nx nx"] | None:
    """Return the roots of the estimator's sets of x - x_hat over k; None if they depend on the data."""
    if estimator.M is not None:
        return psd_sqrt(estimator.M)
    if estimator.P is not None:
        return psd_sqrt(confidence(LEVEL, estimator.P.shape[1]) * estimator.P)
    if not estimator.estimates_set:
        raise DesignError("the estimator reports neither a set nor a covariance of its error over time")
    return None


def _stacked_roots(M: Array | None) -> Float[Array, "runs nx nx"]:
    """Return the roots of the sets of every run; NaN if the set is not finite, as in a failed run."""
    assert M is not None, "an estimator with sets returns M"
    good = np.isfinite(M).all(axis=(1, 2), keepdims=True)
    return np.where(good, psd_sqrt(np.where(good, M, 0.0)), np.nan)
