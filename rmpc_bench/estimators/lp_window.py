"""Moving-window estimator by linear programming: it minimises the bounds of the noises, which need not be known.

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k).  w and v are uniform on boxes of unknown half-widths rho
        and r, constant over a window.  The maximum a posteriori estimate of the states, rho and r of the last Ne + 1
        samples minimises the sum of all rho_i and r_j, (17)-(19).  A state-dependent model is evaluated at x_hat(k) for
        the step to k+1.
Source  belda2017, section IV, LP1.
Assumed `start: free`: the first state of the window has no state equation, as (17) does not contain the input before
        it.  `start: anchored`: the estimate before the window replaces the unknown state, as (19) is printed.  Where
        the optimum is not unique (`anchored`), the solution minimises a weighted sum of the absolute noises
        (`tie_weight`). x_hat(0) is x0; a free window uses y(0).  With fewer than ceil(nx / ny) + 1 samples x_hat =
        x_pred + C^+ (y - C x_pred) / 2.  (18) adds quantities of different units: the estimate depends on the units of
        states and outputs.
Limit   Without noise the exact state.  With Ne = 3 a chain of double integrators has rho = 0.
Cost    9 us per run and step for Ne = 3, 6 states and 3 outputs; 1.6 ms if rho = 0 cannot be certified.
Fails   If the window contains NaN or a solver fails, the estimate is that of a short window (the prediction if y(k)
        itself is NaN) and `fallback` is 1.  Status `diverged`: more than 50 consecutive fallbacks, or the estimate
        exceeds the limit of a state-dependent model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import ceil, inf
from typing import Literal, NamedTuple, TypeAlias, cast

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.estimators.gain_schedule import over_time
from rmpc_bench.models.state_dependent import StateDependentModel, pair_at
from rmpc_bench.numerics.bounded_window import PROCESS, MeasurementWindow, WindowFits, fit_anchored, fit_free
from rmpc_bench.numerics.linalg import appended, at_sample, check_signal, driven, mv
from rmpc_bench.types import Array, Count, DesignError, Estimate, Estimator, Model, Positive, Status

EQUATION = r"""\min \sum_i \rho_i +
\sum_j r_j, \quad -\rho \le x_{\kappa+1} - A x_\kappa - B u_\kappa \le \rho, \quad -r \le y_\kappa - C x_\kappa \le r"""


OK, DIVERGED = np.int8(Status.OK), np.int8(Status.DIVERGED)
PATIENCE = 50
"""Largest number of consecutive samples without a fit."""

Start: TypeAlias = Literal["free", "anchored"]


class WindowState(NamedTuple):
    """State of the estimator between steps; the newest sample of a window is the last one."""

    x_pred: Float[Array, "runs nx"]
    x_hat: Float[Array, "runs nx"]
    y: Float[Array, "runs places ny"]  # outputs without the constant part d of the model
    A: Float[Array, "runs places nx nx"]
    c: Float[Array, "runs places nx"]  # B u and the constant part
    before: Float[Array, "runs places nx"]  # estimates x_hat at which the matrices of each step are evaluated
    missed: Int[Array, " runs"]  # number of consecutive estimates without a fit


@dataclass(frozen=True, eq=False)
class LpWindow(Estimator):
    """LP1 on a moving window."""

    model: Model | StateDependentModel  # linear or state-dependent model
    x0: Float[Array, " nx"]  # estimate at k = 0
    C: Float[Array, "kC ny nx"]  # C, d: output matrix and constant part of the output
    d: Float[Array, "kd ny"]
    Ne: int = 3  # length of the window, which has Ne + 1 samples
    start: Start = "free"  # treatment of the first state of the window
    tie_weight: float = PROCESS  # weight of process noise where the optimum is not unique

    bridges_missing = True

    @property
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """The innovation, half-widths of a window (NaN without a fit), whether a required fit was not available."""
        ny, nx = self.C.shape[1:]
        return {"e": (ny,), "rho": (nx,), "r": (ny,), "fallback": ()}

    def init(self, n_runs: int) -> WindowState:
        """Start every run at ``x0``."""
        ny, nx = self.C.shape[1:]
        x0 = np.tile(self.x0, (n_runs, 1))
        y, A, c, before = (np.zeros((n_runs, self.Ne + 1, *shape)) for shape in ((ny,), (nx, nx), (nx,), (nx,)))
        return WindowState(x0, x0.copy(), y, A, c, before, np.zeros(n_runs, dtype=np.int64))

    def correct(self, k: int, state: WindowState, y: Float[Array, "runs ny"]) -> tuple[WindowState, Estimate]:
        """Use y(k): solve LP1."""
        check_signal("y", y, len(state.x_pred), self.C.shape[1])
        y = y - at_sample(self.d, k)
        state = state._replace(y=appended(state.y, y))
        points = min(k, self.Ne) + 1 if self.start == "free" else min(k, self.Ne + 1)
        enough = k > 0 and points >= self.least + 1
        fits = self._fit(k, state, points) if enough else _nothing(state)
        x_hat = np.where(fits.solved[:, None], fits.x, self._halfway(k, state) if k > 0 else state.x_pred)
        missed = np.where(fits.solved, 0, state.missed + 1) if enough else state.missed
        fallback = ~fits.solved if enough else ~np.isfinite(y).all(axis=1)
        sound = (missed <= PATIENCE) & ~(np.abs(x_hat) > self._largest).any(axis=1)
        info = {"rho": fits.rho, "r": fits.r, "fallback": fallback.astype(float)}
        info["e"] = y - mv(at_sample(self.C, k), state.x_pred)
        estimate = Estimate(x_hat, None, None, np.where(sound, OK, DIVERGED), info)
        return state._replace(x_hat=x_hat, missed=missed), estimate

    def predict(self, k: int, state: WindowState, u: Float[Array, "runs nu"]) -> WindowState:
        """Predict k+1 from x_hat(k)."""
        pair = pair_at(self.model, k, state.x_hat)
        c = driven(pair.B, u)
        if not self._depends:
            c = c + self.model.at(k).f0
        moved = (appended(state.A, pair.A), appended(state.c, c), appended(state.before, state.x_hat))
        return WindowState(mv(pair.A, state.x_hat) + c, state.x_hat, state.y, *moved, state.missed)

    def warm_up(self) -> None:
        """Compile the kernels (or load them from the cache) with a window of one run."""
        self.model.warm_up()
        ny, nx = self.C.shape[1:]
        window = MeasurementWindow(*(np.zeros((1, 2, *shape)) for shape in ((ny,), (nx, nx), (nx,), (nx,))))
        fit_free(window, self.C[:1], 2)

    @property
    def cost_per_step(self) -> float:
        """Time of the fits [s]; windows of four samples rarely need a linear program."""
        return 9e-6 if self.start == "free" and self.Ne <= 3 else 4e-4 * (self.Ne + 1)

    @property
    def least(self) -> int:
        """Smallest Ne for which the Ne outputs before the last sample determine the state."""
        ny, nx = self.C.shape[1:]
        return ceil(int(nx) / int(ny))

    @cached_property
    def _depends(self) -> bool:
        """Whether the model depends on the state."""
        return isinstance(self.model, StateDependentModel)

    @cached_property
    def _largest(self) -> float | Float[Array, " nx"]:
        return cast("StateDependentModel", self.model).largest if self._depends else inf

    @cached_property
    def _inverse(self) -> Float[Array, "kC nx ny"]:
        """C^+ over k."""
        return np.linalg.pinv(self.C)

    def _fit(self, k: int, state: WindowState, points: int) -> WindowFits:
        C = self.C[k + 1 - points : k + 1] if len(self.C) > 1 else self.C
        window = MeasurementWindow(state.y, state.A, state.c, state.before)
        fit = fit_free if self.start == "free" else fit_anchored
        return fit(window, C, points, self.tie_weight)

    def _halfway(self, k: int, state: WindowState) -> Float[Array, "runs nx"]:
        """Prediction plus half of the measured correction; the prediction alone if y is NaN."""
        e = state.y[:, -1] - mv(at_sample(self.C, k), state.x_pred)
        x = state.x_pred + 0.5 * mv(at_sample(self._inverse, k), e)
        return np.where(np.isfinite(x).all(axis=1, keepdims=True), x, state.x_pred)


def _nothing(state: WindowState) -> WindowFits:
    """Return a result without solutions, for too few samples."""
    nan = np.full_like(state.x_hat, np.nan)
    return WindowFits(nan, nan, np.full_like(state.y[:, 0], np.nan), np.zeros(len(nan), dtype=bool))


def design(
    model: Model | StateDependentModel,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    Ne: Count = 3,
    start: Start = "free",
    tie_weight: Positive = PROCESS,
) -> LpWindow:
    """Estimate the state from the last samples by linear programming; the bounds of the noises are estimated, too.

    Parameters
    ----------
    model : design model, linear or state-dependent; its covariances have no effect
    n_steps : number of control periods N
    x0 : (nx,) estimate at k = 0
    Ne : length of the window, which contains the samples k - Ne to k
    start : `free` leaves the first state of the window free; `anchored` relates it to the estimate before it
    tie_weight : weight of the process noise, that of the output noise being 1, where the optimum is not unique

    Raises
    ------
    DesignError
        If the window has too few samples to determine the state.
    """
    if isinstance(model, StateDependentModel):
        if model.has_offsets:
            raise DesignError("does not support a model that is linearised along the trajectory; use kalman", "kind")
        C, d = model.C[None], np.zeros((1, len(model.C)))
    else:
        models = [model.at(k) for k in range(n_steps + 1)]
        C, d = over_time([each.C for each in models]), over_time([each.d0 for each in models])
    estimator = LpWindow(model, x0, C, d, Ne, start, tie_weight)
    if Ne < estimator.least:
        ny, nx = C.shape[1:]
        raise DesignError(f"must be at least {estimator.least} for {nx} states and {ny} outputs", "Ne")
    return estimator
