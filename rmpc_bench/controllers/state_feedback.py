"""State feedback over a receding horizon: linear-quadratic (`lqr`) and H-infinity of finite horizon (`game-gain`).

Model   From the estimate x_hat(k), minimise sum_{t=k..k+N-1} x(t+1)' Q_x x(t+1) + u(t)' R_u u(t) of
        x(t+1) = A_t x + B_t u + d + w, and apply u(k): certainty equivalence.  There is no reference: x goes to 0, or
        to the operating point, from which x and u then count.
        `lqr`  d is the mean of the process noise: known from the model, in addition estimated (`w_mean` of the
               estimate), or ignored; w = 0.
        `game-gain`  w maximises the cost minus the penalty tau w' M_w^-1 w, where tau is `ratio` times the smallest
                     multiplier for which the game is bounded.  M_w is the estimator's set of the process noise.  Unlike
                     in minimax-lq, u(t) may depend on x(t), so that smaller multipliers are sufficient.
Source  `game-gain`  H-infinity control of finite horizon, full information (Basar and Bernhard 1995).
Limit   `lqr`  horizon -> infinity gives the stationary Riccati gain.
        `game-gain`  ratio -> infinity gives lqr.
Cost    One small matrix-vector product per run and step.
Fails   Design error: a weight is not admissible (R_u must be positive definite), or noise grows beyond 1e100.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Gt
from jaxtyping import Float

from rmpc_bench.controllers.limits import Bounds, InputLimits, bounds_of, common_limits
from rmpc_bench.models.noise_sets import stochastic_sets
from rmpc_bench.numerics.linalg import as_covariance, as_positive, at_sample, mv, psd_sqrt
from rmpc_bench.numerics.lq_game import Game
from rmpc_bench.numerics.lq_windows import Stages, game_gains, noise_sizes, smallest_multipliers, window_law
from rmpc_bench.types import (
    Array,
    Command,
    CompiledLaw,
    Controller,
    DesignError,
    Estimate,
    Estimator,
    Horizon,
    LinearLaw,
    Matrix,
    Model,
    OperatingPoint,
    as_command,
)

EQUATION = {
    "lqr": r"\min_u \sum_{t=k}^{k+N-1} x_{t+1}^\top Q_x x_{t+1} + u_t^\top R_u u_t",
    "game_gain": r"""\min_u \max_w \sum_{t=k}^{k+N-1} x_{t+1}^\top
Q_x x_{t+1} + u_t^\top R_u u_t - \tau w_t^\top M_w^{-1} w_t""",
}
LARGEST = 1e100
"""Largest effect of noise on the cost; squares of larger multipliers overflow."""


@dataclass(frozen=True, eq=False)
class Regulator(Controller):
    """A static law u(k) of the estimate that regulates to x = 0; subclasses define `input_of`."""

    # operating point to which the law regulates instead, None without one; a subclass then receives and returns
    # deviations from it
    point: OperatingPoint | None = field(default=None, kw_only=True)

    regulates = True

    @property
    def regulates_to(self) -> Float[Array, " ny"] | None:
        """Output at the operating point."""
        return None if self.point is None else self.point.y

    def init(self, n_runs: int) -> None:
        """There is nothing to remember."""

    def control(
        self, k: int, state: None, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[None, Command]:
        """Apply the first input of the window."""
        if self.point is None:
            u = self.input_of(k, estimate)
        else:
            u = self.point.u + self.input_of(k, estimate._replace(x_hat=estimate.x_hat - self.point.x))
        return None, as_command(Command(u))

    def input_of(self, k: int, estimate: Estimate) -> Float[Array, "runs nu"]:
        """Return the inputs at k."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Lqr(Regulator):
    """u = -K x_hat - K_d d - u_0; axis 0 of the gains is k."""

    K: Float[Array, "k nu nx"]
    K_d: Float[Array, "k nu nx"] | None  # gain of the estimated mean of the process noise, None if it is not used
    u_0: Float[Array, "k nu"]  # input that compensates the mean known from the model
    bounds: Bounds | None = field(default=None, kw_only=True)  # bounds to which the input is clipped, None without

    @property
    def input_limits(self) -> tuple[float, float] | Bounds | None:
        """Lower and upper limit that no input exceeds."""
        return None if self.bounds is None else common_limits(self.bounds)

    def control(
        self, k: int, state: None, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[None, Command]:
        """Apply the first input of the window, clipped to its bounds."""
        _, command = super().control(k, state, y, estimate, r)
        return None, command if self.bounds is None else command._replace(u=np.clip(command.u, *self.bounds))

    def input_of(self, k: int, estimate: Estimate) -> Float[Array, "runs nu"]:
        """Return the inputs at k."""
        u: Array = -mv(at_sample(self.K, k), estimate.x_hat) - at_sample(self.u_0, k)
        return u if self.K_d is None else u - mv(at_sample(self.K_d, k), estimate.info["w_mean"])

    @property
    def has_compiled_form(self) -> bool:
        """A law that uses an estimated mean, or clips its input, has none."""
        return self.K_d is None and self.bounds is None

    def compiled_form(self, r: Float[Array, "known ny"], n_steps: int, runs: Sequence[int]) -> CompiledLaw:
        """Return the gains."""
        return CompiledLaw(np.zeros((1, 1, self.u_0.shape[1])), self.K, u_0=self.u_0, point=self.point)

    def linear_law(self) -> LinearLaw | None:
        """Return the last gain without limits; None if the law uses an estimated mean."""
        nu, affine = self.K.shape[1], self.point is not None or bool(self.u_0.any())
        return None if self.K_d is not None else LinearLaw(self.K[-1], np.eye(nu), np.zeros((nu, 0)), affine=affine)

    def series(self) -> dict[str, Array]:
        """Gains over k."""
        return {"L_u": self.K}


def lqr(
    model: Model,
    n_steps: int,
    estimator: Estimator,
    *,
    horizon: Horizon,
    Q_x: Matrix,
    R_u: Matrix,
    mean: Literal["known", "estimated", "ignored"] | None = None,
    limits: InputLimits | None = None,
) -> Lqr:
    """Linear-quadratic regulator (LQR): state feedback of the estimate over a receding horizon.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods; gains are computed for k = 0..n_steps-1
    estimator : estimator of the method; `mean: estimated` needs one that estimates the mean of the process noise
    horizon : N [samples]
    Q_x : weight of the state
    R_u : weight of the input, positive definite
    mean : mean of the process noise: `known` of the model, `estimated` in addition (default where the estimator has
        it), `ignored` (0)
    limits : bounds `u` to which the input is clipped; none if not given

    Raises
    ------
    DesignError
        If a weight or a bound is not admissible, or the estimator does not estimate the mean.
    """
    if mean is None:
        mean = "estimated" if estimator.estimates_mean else "known"
    stages = stages_of(model, n_steps, horizon, Q_x, R_u)
    nx = stages.A.shape[1]
    f0 = np.array([model.deviation.at(k).f0 for k in range(len(stages.A))])[:, :, None]
    law = window_law(stages, horizon, np.concatenate([f0, np.broadcast_to(np.eye(nx), stages.A.shape)], axis=2))
    if mean == "estimated" and not estimator.estimates_mean:
        raise DesignError("the estimator does not estimate the mean; use kalman-disturbance, or `known`", "mean")
    u_0 = np.zeros_like(law.K_d[:, :, 0]) if mean == "ignored" else law.K_d[:, :, 0]
    bounds = None if limits is None else bounds_of(limits.u, model.nu, "limits.u")
    K_d = law.K_d[:, :, 1:] if mean == "estimated" else None
    return Lqr(law.K, K_d, u_0, point=model.operating_point, bounds=bounds)


@dataclass(frozen=True, eq=False)
class GameGain(Regulator):
    """u = -L x_hat, with the gain for the worst noise of the game; create it with `game_gain`."""

    stages: Stages
    G: Float[Array, "t nx nx"]  # roots of the sets of the process noise
    horizon: int
    ratio: float

    def input_of(self, k: int, estimate: Estimate) -> Float[Array, "runs nu"]:
        """Return the inputs at k."""
        return -mv(self.L[k], estimate.x_hat)

    has_compiled_form = True

    def compiled_form(self, r: Float[Array, "known ny"], n_steps: int, runs: Sequence[int]) -> CompiledLaw:
        """Return the gains."""
        return CompiledLaw(np.zeros((1, 1, self.L.shape[1])), self.L, point=self.point)

    @cached_property
    def L(self) -> Float[Array, "k nu nx"]:
        """Gains over k, computed on first use, as the smallest multipliers need a search."""
        multipliers = self.ratio * smallest_multipliers(self.stages, self.G, self.horizon)
        return game_gains(self.stages, self.G, self.horizon, multipliers)

    def warm_up(self) -> None:
        """Compute the gains before the design is sent to workers."""
        _ = self.L

    def series(self) -> dict[str, Array]:
        """Gains over k."""
        return {"L_u": self.L}


def game_gain(
    model: Model,
    n_steps: int,
    estimator: Estimator,
    *,
    horizon: Horizon,
    Q_x: Matrix,
    R_u: Matrix,
    ratio: Annotated[float, Gt(1)] = 1.1,
) -> GameGain:
    """H-infinity control of finite horizon: linear-quadratic control against penalised worst-case noise.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods; gains are computed for k = 0..n_steps-1
    estimator : estimator of the method, for the set of the process noise
    horizon : N [samples]
    Q_x : weight of the state
    R_u : weight of the input, positive definite
    ratio : multiplier of the noise divided by the smallest one for which the game is bounded

    Raises
    ------
    DesignError
        If a weight is not admissible, the process noise has a mean, or noise grows beyond 1e100 over the horizon.
    """
    stages = stages_of(model, n_steps, horizon, Q_x, R_u)
    refuse_mean(model, estimator, stages)
    roots = noise_roots(model, estimator, stages, horizon)
    return GameGain(stages, roots, horizon, ratio, point=model.operating_point)


def stages_of(model: Model, n_steps: int, horizon: int, Q_x: Matrix, R_u: Matrix) -> Stages:
    """Return the matrices of the model and the weights from k = 0 to the end of the window of k = n_steps - 1."""
    models = [_ahead(model.at, k) for k in range(n_steps + horizon - 1)]
    A, B = np.array([each.A for each in models]), np.array([each.B for each in models])
    nd = model.n_disturbances
    # A disturbance has no weight: the law takes it into account, and cannot change it.
    Q = np.pad(as_covariance(Q_x, A.shape[1] - nd, "Q_x"), (0, nd))
    R = as_positive(R_u, B.shape[2], "R_u")
    return Stages(A, B, *(np.broadcast_to(weight, (len(A), *weight.shape)) for weight in (Q, R)))


def _ahead(what: Callable[[int], Any], k: int) -> Any:
    """Evaluate a model at a k within the horizon; report an error beyond the last step under the key `horizon`."""
    try:
        return what(k)
    except DesignError as error:
        # An error at k = 0 does not depend on the horizon.
        if k == 0:
            raise
        blamed = error.parameter or "matrix"
        raise DesignError(f"reaches k = {k}, where the model's {blamed} {error}", "horizon") from None


def refuse_mean(model: Model, estimator: Estimator, stages: Stages) -> None:
    """Raise a DesignError if the process noise has a mean, known from the model or estimated: the law ignores it."""
    if any(model.deviation.at(k).f0.any() for k in range(len(stages.A))):
        if model.operating_point is not None:
            raise DesignError("needs an operating point that is a steady state; use lqr, or another `at` of the model")
        raise DesignError("does not support a known mean of the process noise; use lqr, or a model without this mean")
    if estimator.estimates_mean:
        raise DesignError(
            "does not support an estimated mean of the process noise; use lqr, mpc or gpc, or another estimator"
        )


def noise_roots(model: Model, estimator: Estimator, stages: Stages, horizon: int) -> Float[Array, "t nx nx"]:
    """Return roots of the estimator's sets of the process noise, or of 95 % ellipsoids of the model's covariances."""
    sets = estimator.sets or stochastic_sets(model)
    G = psd_sqrt(np.array([_ahead(sets.process, k) for k in range(len(stages.A))]))
    # Negated, so that NaN counts as an overflow.
    if not (noise_sizes(stages, G, horizon) < LARGEST).all():
        message = f"noise grows beyond {LARGEST:g} over {horizon} samples without control; choose fewer"
        raise DesignError(message, "horizon")
    return G


def game_of(stages: Stages, G: Float[Array, "t nx nx"]) -> Game:
    """Return the game of all stages; the game of a window is a part of it."""
    S_B = stages.B @ np.linalg.solve(stages.R, stages.B.mT)
    return Game(stages.A, S_B, np.ascontiguousarray(stages.Q), G)
