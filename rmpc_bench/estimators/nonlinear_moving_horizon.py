"""Nonlinear moving-horizon estimator: a least-squares fit of a nonlinear model to a window of samples, with bounds.

Model   x(k+1) = f(x(k), u(k)) + w(k), w ~ N(0, Q_w);  y(k) = h(x(k)) + v(k), v ~ N(0, R_v);  white, independent.
        x_hat(k) is the last state of the window x(k-N)..x(k) that minimises
        |x(k-N) - x_bar|^2 in P_bar^-1 + sum |x(j+1) - f(x(j), u(j))|^2 in Q_w^-1 + sum |y(j) - h(x(j))|^2 in R_v^-1
        with low <= x(j) <= high. x_bar is f of the estimate x_hat(k-N-1).  P_bar is that of the prediction of an
        extended Kalman filter at the estimates.  While k < N the window begins at k = 0 with x0 and P0.
Source  Rao, Rawlings, Mayne, IEEE Trans. Automatic Control 48 (2003); Haseltine and Rawlings, Ind. Eng. Chem. Res.
        44 (2005); Rawlings, Mayne, Diehl, Model Predictive Control, chapter 4.
Assumed The start is the last window, shifted, with the prediction as its newest state (numerics/nonlinear_window.py).
        P is the covariance of that extended Kalman filter; it knows no bounds.  e and S are those of its prediction.
        Where the flow has more states than the design model (servo), all are estimated, and the others have no bounds.
Limit   A linear model: `kalman` without bounds for every window, `moving-horizon` with bounds of x.
        It finds a local minimum, that near the last window.  Another one may be lower: with two reactants and their sum
        measured that was so in 2 of 400 windows.
        A missing measurement (NaN) is left out.
Cost    About five iterations, each with (2 n + 1) (N + 1) evaluations of f.  Two or three states, N = 10, blocks of 20:
        0.5 to 1 ms per run and step with `substeps: 4`, up to 4 ms with error control.
Fails   Design error: Q_w, P0 or R_v is singular.  Status `not-converged`: f or h is not defined at the start.
        A window without convergence keeps its last iterate and is counted as `fallback`; `iterations` are reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.gaussian_filter import OVERHEAD, GaussianFilter, GaussianState, gaussian_filter
from rmpc_bench.models.flow import Flow
from rmpc_bench.numerics.intervals import Interval, Pairs, interval_of
from rmpc_bench.numerics.linalg import appended, has_root
from rmpc_bench.numerics.moment_transform import CentralDifferences
from rmpc_bench.numerics.nonlinear_window import WindowMaps, Windows, WindowSolver
from rmpc_bench.numerics.square_root import covariance_of
from rmpc_bench.types import Array, Count, DesignError, Estimate, Estimator, Model, Positive, Status

EQUATION = r"""\min \Vert x_{k-N} - \bar x \Vert^2_{\bar P^{-1}} + \sum_j \Vert x_{j+1} - f(x_j, u_j)
\Vert^2_{Q_w^{-1}} + \sum_j \Vert y_j - h(x_j) \Vert^2_{R_v^{-1}}, \quad x_j \in [\underline x, \overline x]"""
USUAL = 5
"""Iterations of a window, for the expected time."""


class WindowState(NamedTuple):
    """State between steps: the window, whose newest sample is the last one."""

    x: Float[Array, "runs samples n"]  # states of the last fit, and the prediction of the newest one
    x_bar: Float[Array, "runs samples n"]  # predictions, each from the estimate before it
    root: Float[Array, "runs samples n n"]  # roots of their covariances
    u: Float[Array, "runs moves nu"]
    y: Float[Array, "runs measured ny"]
    after: Float[Array, "runs n n"]  # root of the covariance of the newest estimate


@dataclass(frozen=True, eq=False)
class NonlinearMovingHorizon(Estimator):
    """Moving-horizon estimator of a nonlinear model."""

    filter: GaussianFilter  # the extended Kalman filter, whose covariances are used
    nu: int  # number of inputs
    window: int  # number N of steps of the window
    solver: WindowSolver  # the method, with the bounds

    bridges_missing = True
    form = "filter"

    @property
    def flow(self) -> Flow:
        """The design model as maps of many states."""
        return self.filter.flow

    @property
    def x0(self) -> Float[Array, " nx"]:
        """Prediction of x(0)."""
        return self.filter.x0

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """The innovation with its covariance, the number of iterations, and whether they did not converge (1)."""
        return self.filter.reports | {"iterations": (), "fallback": ()}

    @property
    def cost_per_step(self) -> float:
        """Time of the points of usual iterations, and of the rest [s]."""
        points = (self.window + 1) * (2 * len(self.filter.x_start) + 2)
        return USUAL * (points * (self.flow.cost_per_point + 1e-6) + 6 * OVERHEAD)

    def warm_up(self) -> None:
        """Compile the flow."""
        self.flow.warm_up()

    def init(self, n_runs: int) -> WindowState:
        """Start every run at ``x0``."""
        x, root, _ = self.filter.init(n_runs)
        u, y = (np.zeros((n_runs, 0, m)) for m in (self.nu, len(self.flow.R_v_at(0))))
        return WindowState(x[:, None], x[:, None], root[:, None], u, y, root)

    def correct(self, k: int, state: WindowState, y: Array, *u: Array) -> tuple[WindowState, Estimate]:
        """Use y(k): fit the window."""
        newest = state.root[:, -1]
        count = np.zeros(len(newest), dtype=int)
        _, predicted = self.filter.correct(k, GaussianState(state.x_bar[:, -1], newest, count), y, *u)
        used = y if k > 0 or self.filter.use_y0 else np.full_like(y, np.nan)
        state = state._replace(y=appended(state.y, used, 0))
        first, defined = k + 1 - state.x.shape[1], np.asarray(np.isfinite(state.root).all(axis=(1, 2, 3)))
        root = np.where(defined[:, None, None, None], state.root, np.eye(newest.shape[1]))
        inputs = np.concatenate([state.u, *(each[:, None] for each in u)], axis=1)
        data = self._data(first, k, state._replace(root=root, u=inputs))
        fit = self.solver.solve(self._maps(first, k), data, state.x)
        x_hat = np.ascontiguousarray(fit.x[:, -1])
        # The covariance of the filter that is linearised at the estimate.
        after, _ = self.filter.correct(k, GaussianState(x_hat, root[:, -1], count), y, *u)
        P = covariance_of(after.root[:, : self.filter.nx])
        status = np.where(defined & fit.defined, Status.OK, Status.NOT_CONVERGED).astype(np.int8)
        iterations, fallback = fit.iterations.astype(float), (~fit.converged).astype(float)
        info = {**predicted.info, "iterations": iterations, "fallback": fallback}
        if "x_all" in info:
            info["x_all"] = x_hat
        return state._replace(x=fit.x, after=after.root), Estimate(x_hat[:, : self.filter.nx], P, None, status, info)

    def predict(self, k: int, state: WindowState, u: Float[Array, "runs nu"]) -> WindowState:
        """Predict k+1 from x_hat(k), and shift the window."""
        x_hat, count = state.x[:, -1], np.zeros(len(u), dtype=int)
        x_bar, root, _ = self.filter.predict(k, GaussianState(x_hat, state.after, count), u)
        begin = max(state.x.shape[1] - self.window, 0)
        # Where f is not defined at the estimate, the state is held.
        x = appended(state.x, np.where(np.isfinite(x_bar).all(axis=1, keepdims=True), x_bar, x_hat), begin)
        x_bar, root = appended(state.x_bar, x_bar, begin), appended(state.root, root, begin)
        return WindowState(x, x_bar, root, appended(state.u, u, begin), state.y[:, begin:], state.after)

    def _data(self, first: int, k: int, state: WindowState) -> Windows:
        """Return the data of the window first..k."""
        root, there = state.root, ~np.isnan(state.y)
        inverse = np.linalg.inv(np.ascontiguousarray(root[:, 0]))
        R_v = np.array([self.flow.R_v_at(j) for j in range(first, k + 1)])
        both = there[:, :, :, None] & there[:, :, None]
        R_inv = np.where(both, np.linalg.inv(np.where(both, R_v, np.eye(R_v.shape[1]))), 0.0)
        size = np.sqrt(np.einsum("rjab,rjab->rja", root, root))
        y = np.where(there, state.y, 0.0)
        return Windows(state.x_bar[:, 0], inverse.mT @ inverse, state.u, y, R_inv, size)

    def _maps(self, first: int, k: int) -> WindowMaps:
        """Return the model at the samples first..k."""
        flow, samples = self.flow, range(first, k + 1)
        n = len(self.filter.x_start)

        def advance(j: int, x: Array, u: Array, leading: int) -> Array:
            runs, moves, points = x.shape[:3]
            if not flow.varies:
                each = x.reshape(runs * moves, points, n), u.reshape(runs * moves, u.shape[2])
                return flow.advance_points(k, *each, leading or None).reshape(x.shape)
            found = np.empty_like(x)
            for i in range(moves):
                found[:, i] = flow.advance_points(first + j + i, x[:, i], u[:, i], leading or None)
            return found

        def measure(x: Array, u: Array) -> Array:
            if not flow.varies and not flow.fed:
                return flow.measure(k, x.reshape(-1, n)).reshape(*x.shape[:3], -1)
            given = [[np.repeat(u[:, i], x.shape[2], axis=0)] if flow.fed else [] for i in range(len(samples))]
            each = [flow.measure(j, x[:, j - first].reshape(-1, n), *given[j - first]) for j in samples]
            return np.stack([y.reshape(len(x), x.shape[2], -1) for y in each], axis=1)

        Q_inv = np.array([np.linalg.inv(flow.Q_w_at(j)) for j in samples[:-1]]).reshape(-1, n, n)
        A, C = flow.A_at(k), flow.C_at(k)
        return WindowMaps(
            advance,
            measure,
            Q_inv,
            None if A is None else np.array([flow.A_at(j) for j in samples[:-1]]).reshape(-1, n, n),
            None if C is None else np.array([flow.C_at(j) for j in samples]),
            flow.adaptive,
            flow.x_period,
            flow.y_period,
        )


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    window: Count = 10,
    x: Pairs | None = None,
    use_y0: bool = True,
    tolerance: Positive = 1e-6,
    iterations: Count = 50,
) -> NonlinearMovingHorizon:
    """Nonlinear moving-horizon estimator: least squares over a window of a nonlinear model, with bounds of states.

    Parameters
    ----------
    model : design model: `nonlinear`, `ode`, `servo`, `linearise` with `at: trajectory`, or a linear one
    n_steps : number of control periods N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    window : number of steps of the window, which has the samples k - window to k
    x : [low, high] of the state, or one pair per state; null for no bound (default: those of the model)
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)
    tolerance : the iteration ends when no state of the window moves by more, in its standard deviations
    iterations : most iterations per sample

    Raises
    ------
    DesignError
        If the model has no map f(x, u), Q_w, P0 or R_v is singular, or bounds do not fit.
    """
    made = gaussian_filter(model, CentralDifferences(), n_steps, x0, P0, use_y0=use_y0)
    flow, n = made.flow, len(made.x_start)
    if not all(has_root(flow.Q_w_at(k)) for k in range(n_steps if flow.varies else 1)):
        raise DesignError("Q_w is singular: give every state process noise")
    if not has_root(made.P_start):
        raise DesignError("P is singular: give every initial state a variance, initial.P")
    limits = flow.limits
    if x is not None:
        given, none = interval_of(x, model.nx, "x", required=False), np.full(n - model.nx, np.inf)
        found = Interval(np.concatenate([given.low, -none]), np.concatenate([given.high, none]))
        limits = found if found.bounded.any() else None
    made = replace(made, limits=limits)
    return NonlinearMovingHorizon(made, model.nu, window, WindowSolver(limits, tolerance, iterations))
