"""Linear moving-horizon estimator: a least-squares fit to a window of samples under bounds of noises and states.

Model   x(k+1) = A x(k) + B u(k) + f0 + G w(k),  y(k) = C x(k) + v(k),  w ~ N(w_mean, W), v ~ N(v_mean, R_v), white.
        x_hat(k) is the last state of the window x(k-N)..x(k) that minimises
        |x(k-N) - x_bar|^2 in P_bar^-1 + sum |w - w_mean|^2 in W^-1 + sum |v - v_mean|^2 in R_v^-1
        with low <= w <= high, low <= v <= high, low <= x <= high at all samples of the window.  x_bar is the prediction
        A x_hat(k-N-1) + B u from the estimate of that time, P_bar the covariance P_pred of the Kalman filter at k-N.
        While k < N the window begins at k = 0 with x0 and P0.
Bounds  Those of w are bounds of the process noise of the design model, with its sign, unit and mean.  With
        `uncertain-linear` G is Bw, else I, with a coordinate per state.  For noise in one direction g, w = g w_1, they
        are bounds of g_i w_1.  W is used as a root: directions without noise stay without noise.  Bounds of v are those
        of y - C x, one per output; bounds of x one per state.
Source  Rao, Rawlings, Lee, Automatica 37 (2001); Rawlings, Mayne, Diehl, Model Predictive Control, chapter 4.
Limit   Without bounds, or as long as none is active, it is `kalman` for every window.  Where the estimate without
        bounds satisfies all of them, it is the minimum, and no quadratic program is solved.
        P is that of the Kalman filter: the covariance without bounds, and a design matrix where bounds are active.
        A missing measurement (NaN) is left out; the run then has matrices of its own until its covariances are those of
        the other runs again.
Cost    Two states, one bounded noise, N = 10: 6 us per run and step (`make perf`); much more for a run with matrices of
        its own.
Fails   Design error: a covariance of an innovation is singular, or bounds that no noise satisfies.  Status
        `infeasible`: no window satisfies the bounds (those of w alone can be satisfied if they contain its mean);
        `not-converged`: the solver fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, riccati_schedule, singular_innovation
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.models.uncertain_linear import ModelSeries, UncertainModel, model_series, window_bounds
from rmpc_bench.numerics.intervals import Pairs
from rmpc_bench.numerics.linalg import appended, at_sample, check_signal, driven, mv, nearly_equal
from rmpc_bench.numerics.qp import QpStatus
from rmpc_bench.numerics.riccati import filter_step
from rmpc_bench.numerics.square_root import covariance_of, without_missing
from rmpc_bench.numerics.window_posterior import WindowBounds, WindowFit, WindowProgram, range_of_root
from rmpc_bench.types import Array, Count, DesignError, Estimate, Estimator, Model, Status

EQUATION = r"""\min \Vert x_{k-N} - \bar x \Vert^2_{\bar P^{-1}} + \sum_j \Vert w_j
\Vert^2_{Q_w^{-1}} + \sum_j \Vert y_j - C x_j \Vert^2_{R_v^{-1}}, \quad w_j \in [\underline w, \overline w], \quad
v_j \in [\underline v, \overline v], \quad x_j \in [\underline x, \overline x]"""
STATUS = {each: Status.OK if each.solved else Status.NOT_CONVERGED for each in QpStatus}
STATUS |= {QpStatus.INFEASIBLE: Status.INFEASIBLE}
"""What a run becomes by the result of its quadratic program."""
SHORT = 32
"""Points of a window up to which a matrix is faster than a filter sample by sample."""
SETTLED = 1e-13
"""Windows whose covariances differ by less, relative to the standard deviations, share their matrices."""


class HorizonState(NamedTuple):
    """State between steps: the window, whose newest sample is the last one."""

    x_hat: Float[Array, "runs nx"]
    x_pred: Float[Array, "runs points nx"]
    """Predictions of the states at the samples of the window, each from the estimate before it."""
    c: Float[Array, "runs moves nx"]
    """B u + f0 between these samples."""
    y: Float[Array, "runs measured ny"]
    """Measurements without the constant part; NaN where one is missing."""
    roots: Float[Array, "runs points nx nx"]
    """Roots of the covariances of the predictions without bounds."""
    root_next: Float[Array, "runs nx nx"]
    """The next of them, of a run with matrices of its own."""
    own: Bool[Array, " runs"]
    """Whether the run has matrices of its own, since a measurement has been missing."""


@dataclass(frozen=True, eq=False)
class MovingHorizon(Estimator):
    """Linear moving-horizon estimator."""

    model: ModelSeries  # the design model over k
    kalman: GainScheduleFilter  # gains and covariances of the Kalman filter
    window: int  # number N of steps of the window
    bounds: WindowBounds  # bounds of the noises and states
    use_y0: bool = True  # whether to use y(0)
    programs: tuple[WindowProgram, ...] = field(init=False)
    """The problem at every k; the same object where the matrices are the same."""

    bridges_missing = True
    form = "filter"

    def __post_init__(self) -> None:
        """Prepare the problems of all k."""
        object.__setattr__(self, "programs", tuple(self._programs()))

    @property
    def cost_per_step(self) -> float:
        """Time of a step, if a bound is active [s]."""
        return 1.5e-5 + 7e-7 * self.window

    @property
    def x0(self) -> Float[Array, " nx"]:
        """Prediction of x(0)."""
        return self.kalman.x0

    @property
    def P(self) -> Float[Array, "k nx nx"] | None:
        """Covariance of x_hat - x without bounds."""
        return self.kalman.P

    @property
    def reports(self) -> Mapping[str, tuple[int, ...]]:
        """The innovation with its covariance, and whether a program was solved (1) or the closed form suffices (0)."""
        ny = self.model.C.shape[1]
        return {"e": (ny,), "S": (ny, ny), "solved": ()}

    def series(self) -> dict[str, Array]:
        """Gains and covariances of the Kalman filter over k."""
        return self.kalman.series()

    def init(self, n_runs: int) -> HorizonState:
        """Start every run at ``x0``."""
        ny, nx = self.model.C.shape[1:]
        x0, P0 = np.tile(self.x0, (n_runs, 1)), np.tile(self._roots[0], (n_runs, 1, 1))
        none = np.zeros((n_runs, 0, nx)), np.zeros((n_runs, 0, ny))
        return HorizonState(x0, x0[:, None].copy(), *none, P0[:, None].copy(), P0, np.zeros(n_runs, dtype=bool))

    def correct(self, k: int, state: HorizonState, y: Float[Array, "runs ny"]) -> tuple[HorizonState, Estimate]:
        """Use y(k): fit the window."""
        check_signal("y", y, len(state.x_hat), self.model.C.shape[1])
        y = y - at_sample(self.model.d0, k)
        own = state.own | np.isnan(y).any(axis=1)
        state = state._replace(y=appended(state.y, y, 0), own=own)
        fit = self._fit(k, self.programs[k], state)
        P: Array = at_sample(self.P, k)
        if own.any():
            fit, P, root_next = self._of_own_runs(k, state, fit)
            state = state._replace(root_next=root_next)
        status = np.array([STATUS[each] for each in fit.status], dtype=np.int8)
        C, R_v = at_sample(self.model.C, k), at_sample(self.model.R_v, k)
        e, S = y - mv(C, state.x_pred[:, -1]), covariance_of(C @ state.roots[:, -1]) + R_v
        info = {"e": e, "S": S, "solved": fit.solved.astype(float)}
        return state._replace(x_hat=fit.x), Estimate(fit.x, P, None, status, info)

    def predict(self, k: int, state: HorizonState, u: Float[Array, "runs nu"]) -> HorizonState:
        """Predict k+1 from x_hat(k), which is not estimated again."""
        c = driven(at_sample(self.model.B, k), u) + at_sample(self.model.f0, k)
        x_pred = mv(at_sample(self.model.A, k), state.x_hat) + c
        # After the last sample of the experiment no covariance is known or needed.
        common = self._roots[min(k + 1, len(self._roots) - 1)]
        root = np.where(state.own[:, None, None], state.root_next, common)
        begin = max(state.c.shape[1] + 1 - self.window, 0)
        after = state._replace(
            x_pred=appended(state.x_pred, x_pred, begin),
            c=appended(state.c, c, begin),
            y=state.y[:, begin:],
            roots=appended(state.roots, root, begin),
        )
        return after._replace(own=after.own & ~self._settled(k + 1, after)) if after.own.any() else after

    def _settled(self, k: int, state: HorizonState) -> Bool[Array, " runs"]:
        """Whether a run has the covariances of the others again, after a window without a missing measurement."""
        near = ~np.isnan(state.y).any(axis=(1, 2))
        for sample, place in ((k - state.c.shape[1], 0), (min(k, len(self._covariances) - 1), -1)):
            common = self._covariances[sample]
            near &= nearly_equal(covariance_of(state.roots[:, place]), common, SETTLED)
        return np.asarray(near)

    @property
    def _covariances(self) -> Float[Array, "k nx nx"]:
        """P_pred of the Kalman filter."""
        P_pred: Array = self.kalman.extra["P_pred"]
        return P_pred

    @property
    def _roots(self) -> Float[Array, "k nx nx"]:
        """Roots of these covariances."""
        assert self.kalman.root is not None
        return self.kalman.root

    def _fit(self, k: int, program: WindowProgram, state: HorizonState) -> WindowFit:
        """Fit the windows that end at k, by predictions and innovations of a filter that starts with them."""
        (runs, points, ny), nx, x = state.y.shape, state.x_hat.shape[1], state.x_pred[:, 0]
        if program.filter_map is None:
            x_bar, e = self.model.filtered(k + 1 - points, x, state.c, state.y, program.L)
        else:
            found = mv(program.filter_map, np.hstack([x, state.c.reshape(runs, -1), state.y.reshape(runs, -1)]))
            x_bar, e = found[:, : points * nx].reshape(runs, points, nx), found[:, points * nx :].reshape(state.y.shape)
        return program.fit(x_bar[:, -1], e.reshape(runs, points * ny), self.bounds.base(x_bar, e))

    def _of_own_runs(self, k: int, state: HorizonState, fit: WindowFit) -> tuple[WindowFit, Array, Array]:
        """Fit the windows of runs with missing measurements; return all fits, P and the next root."""
        P, root_next = np.tile(at_sample(self.P, k), (len(state.y), 1, 1)), state.root_next.copy()
        x, solved, status = fit.x.copy(), fit.solved.copy(), list(fit.status)
        A, C, Q_w, R_v = (at_sample(getattr(self.model, name), k) for name in ("A", "C", "Q_w", "R_v"))
        for i in np.flatnonzero(state.own):
            measured = ~np.isnan(state.y[i])
            alone = HorizonState(*(each[i : i + 1] for each in state))
            one = self._fit(k, self._program(k, state.roots[i, 0], measured), alone)
            x[i], solved[i], status[i] = one.x[0], one.solved[0], one.status[0]
            there = measured[-1]
            counts = k > 0 or self.use_y0
            seen, noise = np.where(there[:, None], C, 0.0), without_missing(R_v, there)
            step = filter_step(A, seen, Q_w, noise, state.roots[i, -1], measured=counts)
            P[i], root_next[i] = step.P, step.root_next
        return WindowFit(x, solved, status), P, root_next

    def _program(self, k: int, root: Array, measured: Bool[Array, "points ny"]) -> WindowProgram:
        """Prepare the problem of the window that ends at k."""
        first = k + 1 - len(measured)
        measured = measured & (self.use_y0 | (np.arange(first, k + 1) > 0))[:, None]
        *_, law = self.bounds.laws(self.model.stages(first, k), range_of_root(root), measured)
        return WindowProgram.of(law, self.bounds.interval(measured))

    def _programs(self) -> Iterator[WindowProgram]:
        """Prepare the problems; while the window grows, each one continues the one before."""
        n, ny, N = len(self._covariances), self.model.C.shape[1], self.window
        program, made_for, last = None, 0, min(N, n - 1)
        every, constant = np.ones((last + 1, ny), dtype=bool), len(self.model.A) == len(self.model.C) == 1
        every[0] = self.use_y0
        growing = self.bounds.laws(self.model.stages(0, last), range_of_root(self._roots[0]), every)
        for k in range(n):
            first = max(k - N, 0)
            P_bar, before = self._covariances[first], self._covariances[made_for]
            close = bool(nearly_equal(P_bar, before, SETTLED))
            shared = k > N and close and len(self.model.A) == 1 and (made_for > 0 or self.use_y0)
            if program is None or not shared:
                try:
                    if first == 0:
                        program = WindowProgram.of(next(growing), self.bounds.interval(every[: k + 1]))
                    else:
                        program = self._program(k, self._roots[first], np.ones((N + 1, ny), dtype=bool))
                except np.linalg.LinAlgError:
                    raise singular_innovation(k) from None
                if constant and len(program.L) <= SHORT:
                    program = replace(program, filter_map=self.model.filter_map(program.L))
                made_for = first
            yield program


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    window: Count = 10,
    w: Pairs | None = None,
    v: Pairs | None = None,
    x: Pairs | None = None,
    use_y0: bool = True,
) -> MovingHorizon:
    """Linear moving-horizon estimator: least squares over a window, with bounds of noises and states.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    window : number of steps of the window, which has the samples k - window to k
    w : [low, high] of the process noise, mean included, or one pair per coordinate; null for no bound
    v : [low, high] of the measurement noise y - C x, mean included, or one pair per output
    x : [low, high] of the state, or one pair per state
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If an innovation covariance is singular, bounds do not fit, or noises of the model are correlated.
    """
    if isinstance(model, StateDependentModel):
        raise DesignError("does not support a model that depends on the state; use kalman", "kind")
    kalman = riccati_schedule(model, n_steps, x0, P0, use_y0=use_y0)
    # Without bounds of w its coordinates do not matter, and a model may have other process noise.
    series = model_series(model, n_steps, in_states=w is None or not isinstance(model, UncertainModel))
    return MovingHorizon(series, kalman, window, window_bounds(model, series, n_steps, w=w, v=v, x=x), use_y0)
