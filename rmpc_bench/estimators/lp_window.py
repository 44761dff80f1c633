"""State from the last samples by linear programming: noises of least bounds, which nobody has to know.

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k);  w and v uniform on boxes of unknown half-widths rho, r,
        constant over a window.  The most probable states, rho and r of the last Ne + 1 samples have the least sum of
        all rho_i and r_j, (17)-(19).  A state-dependent model is linearised at x_hat(k), from which it moves to k+1;
        the pairs of a window are those of their own times.
Source  belda2017, section IV, LP1.
Chosen  `start: free` leaves the first state of the window without a state equation, as the input before it is not among
        the data of (17); `anchored` takes (19) at its word and inserts the estimate before the window.  Then there are
        many optima; of these, and wherever else there may be more than one, a weighted sum of absolute noises chooses.
        x_hat(0) is x0; y(0) counts in a free window.  With fewer than ceil(nx / ny) + 1 samples the estimate is the
        prediction, its measured part taken halfway to y: x_pred + C^+ (y - C x_pred) / 2.
        (18) adds up units that differ: another unit of a state or an output is another estimate.
Limit   without noise the state itself.  With Ne = 3 a chain of double integrators has rho = 0.
Cost    9 us per run and step for Ne = 3, 6 states and 3 outputs; 1.6 ms where rho = 0 is not certain.
Fails   where the window has a number missing or a solver fails, the estimate is as in the beginning, where y(k) itself
        is missing the prediction, and `fallback` is 1; diverged after more than 50 of them in a row, or where a
        state-dependent model says that the estimate is too large.
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
from rmpc_bench.numerics.bounded_window import SampleWindow, WindowFits, fit_anchored, fit_free
from rmpc_bench.numerics.linalg import at_sample, mv
from rmpc_bench.types import Array, Count, DesignError, Estimate, Estimator, Model, Status

OK, DIVERGED = np.int8(Status.OK), np.int8(Status.DIVERGED)
PATIENCE = 50
"""Most samples in a row without a fit."""

Start: TypeAlias = Literal["free", "anchored"]


class WindowState(NamedTuple):
    """What the next step needs; the newest sample of a window is its last."""

    x_pred: Float[Array, "runs nx"]
    x_hat: Float[Array, "runs nx"]
    y: Float[Array, "runs places ny"]
    """Without the constant part of the model."""
    A: Float[Array, "runs places nx nx"]
    c: Float[Array, "runs places nx"]
    """B u and the constant part."""
    before: Float[Array, "runs places nx"]
    """Estimates from which the pairs move on."""
    missed: Int[Array, " runs"]
    """How many estimates in a row came without a fit."""


@dataclass(frozen=True, eq=False)
class LpWindow(Estimator):
    """LP1 on a moving window.

    Parameters
    ----------
    model : linear or state dependent
    x0 : (nx,) estimate at k = 0
    C, d : (1 or samples, ny, nx), (1 or samples, ny) output matrix and constant part of the output
    Ne : length of the window, which has Ne + 1 samples
    start : what is known of its first state
    """

    model: Model | StateDependentModel
    x0: Float[Array, " nx"]
    C: Float[Array, "kC ny nx"]
    d: Float[Array, "kd ny"]
    Ne: int = 3
    start: Start = "free"

    bridges_missing = True

    @property
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """Half-widths of a window, NaN without a fit, and whether an estimate did without where one was due."""
        ny, nx = self.C.shape[1:]
        return {"rho": (nx,), "r": (ny,), "fallback": ()}

    def init(self, n_runs: int) -> WindowState:
        """Start every run at ``x0``."""
        ny, nx = self.C.shape[1:]
        x0 = np.tile(self.x0, (n_runs, 1))
        y, A, c, before = (np.zeros((n_runs, self.Ne + 1, *shape)) for shape in ((ny,), (nx, nx), (nx,), (nx,)))
        return WindowState(x0, x0.copy(), y, A, c, before, np.zeros(n_runs, dtype=np.int64))

    def correct(self, k: int, state: WindowState, y: Float[Array, "runs ny"]) -> tuple[WindowState, Estimate]:
        """Use y(k): solve LP1."""
        state = state._replace(y=_pushed(state.y, y - at_sample(self.d, k)))
        points = min(k, self.Ne) + 1 if self.start == "free" else min(k, self.Ne + 1)
        enough = k > 0 and points >= self.least + 1
        fits = self._fit(k, state, points) if enough else _nothing(state)
        x_hat = np.where(fits.solved[:, None], fits.x, self._halfway(k, state) if k > 0 else state.x_pred)
        missed = np.where(fits.solved, 0, state.missed + 1) if enough else state.missed
        fallback = ~fits.solved if enough else ~np.isfinite(y).all(axis=1)
        sound = (missed <= PATIENCE) & ~(np.abs(x_hat) > self._largest).any(axis=1)
        info = {"rho": fits.rho, "r": fits.r, "fallback": fallback.astype(float)}
        estimate = Estimate(x_hat, None, None, np.where(sound, OK, DIVERGED), info)
        return state._replace(x_hat=x_hat, missed=missed), estimate

    def predict(self, k: int, state: WindowState, u: Float[Array, "runs nu"]) -> WindowState:
        """Go to k+1 from x_hat(k)."""
        pair = pair_at(self.model, k, state.x_hat)
        c = mv(pair.B, u)
        if not self._depends:
            c = c + self.model.at(k).f0
        moved = (_pushed(state.A, pair.A), _pushed(state.c, c), _pushed(state.before, state.x_hat))
        return WindowState(mv(pair.A, state.x_hat) + c, state.x_hat, state.y, *moved, state.missed)

    def warm_up(self) -> None:
        """Compile the kernels (or load them from the cache) by a window of one run."""
        self.model.warm_up()
        ny, nx = self.C.shape[1:]
        window = SampleWindow(*(np.zeros((1, 2, *shape)) for shape in ((ny,), (nx, nx), (nx,), (nx,))))
        fit_free(window, self.C[:1], 2)

    @property
    def cost_per_step(self) -> float:
        """Mostly that of the fits [s]; windows of four samples hardly ever need a linear program."""
        return 9e-6 if self.start == "free" and self.Ne <= 3 else 4e-4 * (self.Ne + 1)

    @property
    def least(self) -> int:
        """Length of the shortest window that has as many outputs as states, and one sample more."""
        ny, nx = self.C.shape[1:]
        return ceil(int(nx) / int(ny))

    @cached_property
    def _depends(self) -> bool:
        """Whether the model depends on the state."""
        return isinstance(self.model, StateDependentModel)

    @cached_property
    def _largest(self) -> float:
        return cast("StateDependentModel", self.model).largest if self._depends else inf

    @cached_property
    def _inverse(self) -> Float[Array, "kC nx ny"]:
        """C^+ over k."""
        return np.linalg.pinv(self.C)

    def _fit(self, k: int, state: WindowState, points: int) -> WindowFits:
        C = self.C[k + 1 - points : k + 1] if len(self.C) > 1 else self.C
        window = SampleWindow(state.y, state.A, state.c, state.before)
        return fit_free(window, C, points) if self.start == "free" else fit_anchored(window, C, points)

    def _halfway(self, k: int, state: WindowState) -> Float[Array, "runs nx"]:
        """Prediction, its measured part averaged with y; the prediction alone where y is no number."""
        e = state.y[:, -1] - mv(at_sample(self.C, k), state.x_pred)
        x = state.x_pred + 0.5 * mv(at_sample(self._inverse, k), e)
        return np.where(np.isfinite(x).all(axis=1, keepdims=True), x, state.x_pred)


def _pushed(window: Array, newest: Array) -> Array:
    """Window (runs, places, ..) with a newest entry and without the oldest."""
    return np.concatenate([window[:, 1:], newest[:, None]], axis=1)


def _nothing(state: WindowState) -> WindowFits:
    """What is found where there are too few samples."""
    nan = np.full_like(state.x_hat, np.nan)
    return WindowFits(nan, nan, np.full_like(state.y[:, 0], np.nan), np.zeros(len(nan), dtype=bool))


def design(
    model: Model | StateDependentModel,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    Ne: Count = 3,
    start: Start = "free",
) -> LpWindow:
    """Fit the states of the last samples by linear programming; bounds of the noises are found, not given.

    Parameters
    ----------
    model : what the estimator believes, linear or state dependent; its covariances do not matter
    n_steps : number of control periods N
    x0 : (nx,) estimate at k = 0
    Ne : length of the window, which has the samples k - Ne to k
    start : `free` lets the first state of the window be what it likes, `anchored` ties it to the estimate before it

    Raises
    ------
    DesignError
        If the window has too few samples to find a state.
    """
    if isinstance(model, StateDependentModel):
        C, d = model.C[None], np.zeros((1, len(model.C)))
    else:
        models = [model.at(k) for k in range(n_steps + 1)]
        C, d = over_time([each.C for each in models]), over_time([each.d0 for each in models])
    estimator = LpWindow(model, x0, C, d, Ne, start)
    if Ne < estimator.least:
        ny, nx = C.shape[1:]
        raise DesignError(f"{nx} states need a window of {estimator.least} at least, as {ny} are measured", "Ne")
    return estimator
