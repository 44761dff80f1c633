"""Filter of a nonlinear design model that keeps mean and covariance of the state, shared by the nonlinear filters.

Model   As models/flow.py, with additive noise.  The moments of f(x) and h(x) come from a rule of
        numerics/moment_transform.py:  x_pred = mean of f,  P_pred = covariance of f + Q_w;  before the correction the
        points are placed anew:  S = covariance of h + R_v,  L = cross-covariance of x and h times S^-1.  Where the
        model or its output is linear, its matrix is used and no points are needed.  Covariances are kept as roots.
        Points stay inside the state bounds of the model.  The estimate itself does not know them.
        Differences of angles, such as the innovation, are wrapped.
        A missing measurement (NaN) is left out of the correction; without any, the filter predicts only.
        Where the flow has more states than the design model, the estimate has those of the design model, and all are in
        the info `x_all`.
Fails   A run gets status `singular` when its covariance has had a negative eigenvalue twice (unscented-kalman with
        beta < 0 or kappa < 0); the positive part is used until then.  A point where the model is not defined makes the
        run `diverged`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rmpc_bench.models.flow import Flow, flow_of
from rmpc_bench.numerics.intervals import Interval
from rmpc_bench.numerics.linalg import check_time, has_root, innovation, mv
from rmpc_bench.numerics.moment_transform import MomentRule, covariance_root
from rmpc_bench.numerics.riccati import predicted_root
from rmpc_bench.numerics.square_root import conditional, covariance_of, joint_root, lower_root, root_of, without_missing
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Model, Status
from rmpc_bench.types.angles import wrapped

OK, SINGULAR = np.int8(Status.OK), np.int8(Status.SINGULAR)
INDEFINITE_TWICE = 2
"""So many indefinite covariances give a run the status `singular`."""
OVERHEAD = 5e-6
"""Time of a prediction and a correction per run, besides the points, in a block of 50 runs [s]."""


class GaussianState(NamedTuple):
    """State of the filter between steps; before a correction x and the root of P are those of the prediction."""

    x: Float[Array, "runs n"]
    root: Float[Array, "runs n n"]
    indefinite: Int[Array, " runs"]  # how often the covariance of the run was indefinite


class Innovation(NamedTuple):
    """Measurement against its prediction; the entries of a missing measurement have no effect."""

    e: Float[Array, "runs ny"]
    image: Float[Array, "runs ny r"]
    """Rows of the joint root of the output without noise and the state that belong to the output."""
    source: Float[Array, "runs n r"]
    """Rows that belong to the state."""
    minus: Float[Array, "runs ny"] | None = None
    rest: Float[Array, "runs n n"] | None = None
    """Both as in `Moments`."""

    def moved(self, rows: Int[Array, " some"]) -> Innovation:
        """Return that of runs with moved points; what these lack of P is a source of its own."""
        assert self.rest is not None
        image = np.pad(self.image[rows], ((0, 0), (0, 0), (0, self.rest.shape[2])))
        source = np.concatenate([self.source[rows], self.rest[rows]], axis=2)
        return Innovation(self.e[rows], image, source, None if self.minus is None else self.minus[rows])


@dataclass(frozen=True, eq=False)
class GaussianFilter(Estimator):
    """A filter of mean and covariance."""

    flow: Flow  # the design model as maps of many states
    rule: MomentRule  # how the moments of f(x) and h(x) are computed
    x_start: Float[Array, " n"]  # prediction of the first state of the flow
    P_start: Float[Array, "n n"]  # covariance of its error
    nx: int  # number of states of the design model, the first ones of the flow
    use_y0: bool = True
    limits: Interval | None = None  # bounds of the states, inside which the points stay; None where there are none

    bridges_missing = True
    form = "filter"

    @property
    def x0(self) -> Float[Array, " nx"]:
        """Prediction of x(0)."""
        return self.x_start[: self.nx]

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """The innovation and its covariance; all states of the flow where it has more than the design model."""
        ny, n = len(self.flow.R_v_at(0)), len(self.x_start)
        return {"e": (ny,), "S": (ny, ny)} | ({"x_all": (n,)} if n > self.nx else {})

    @property
    def cost_per_step(self) -> float:
        """Time of the points of a prediction, and of the rest [s]."""
        return (2 * len(self.x_start) + 1) * self.flow.cost_per_point + OVERHEAD

    def warm_up(self) -> None:
        """Compile the flow."""
        self.flow.warm_up()

    def init(self, n_runs: int) -> GaussianState:
        """Start every run at ``x0``."""
        root = np.tile(root_of(self.P_start), (n_runs, 1, 1))
        return GaussianState(np.tile(self.x_start, (n_runs, 1)), root, np.zeros(n_runs, dtype=int))

    def correct(self, k: int, state: GaussianState, y: Array, *u: Array) -> tuple[GaussianState, Estimate]:
        """Use what was measured of y(k)."""
        check_time(k, np.inf)
        given, after, R_v = self._innovation(k, state, y, *u), state, self.flow.R_v_at(k)
        if k > 0 or self.use_y0:
            after = _corrected(state, given, R_v, np.isnan(y))
            if given.rest is not None:
                rows = np.flatnonzero(given.rest.any(axis=(1, 2)))
                before = GaussianState(*(each[rows] for each in state))
                moved = _corrected(before, given.moved(rows), R_v, np.isnan(y[rows]))
                for every, some in zip(after, moved, strict=True):
                    every[rows] = some
        S = covariance_of(given.image) + R_v
        if given.minus is not None:
            S -= np.einsum("ri,rj->rij", given.minus, given.minus)
        info = {"e": given.e, "S": S}
        if len(self.x_start) > self.nx:
            info["x_all"] = after.x
        status = np.where(state.indefinite >= INDEFINITE_TWICE, SINGULAR, OK).astype(np.int8)
        nx = self.nx
        return after, Estimate(after.x[:, :nx], covariance_of(after.root[:, :nx]), None, status, info)

    def predict(self, k: int, state: GaussianState, u: Float[Array, "runs nu"]) -> GaussianState:
        """Predict k+1 by the moments of f."""
        A, Q_w = self.flow.A_at(k), self.flow.Q_w_at(k)
        if A is not None:
            return state._replace(x=self.flow.advance(k, state.x, u), root=predicted_root(A, Q_w, state.root))
        f, limits, period = self.flow.advance_points, self.limits, self.flow.x_period
        found = self.rule.moments(lambda x: f(k, x, u), state.x, state.root, limits, period)
        Q_root = np.broadcast_to(root_of(Q_w), (len(u), *Q_w.shape))
        both, indefinite = _without(np.concatenate([found.image, Q_root], axis=2), found.minus)
        return GaussianState(found.mean, lower_root(both), state.indefinite + indefinite)

    def _innovation(self, k: int, state: GaussianState, y: Float[Array, "runs ny"], *u: Array) -> Innovation:
        """Compare y(k) with its prediction."""
        C = self.flow.C_at(k)
        if C is not None:
            e = wrapped(innovation(y, self.flow.measure(k, state.x, *u)), self.flow.y_period)
            return Innovation(e, C @ state.root, state.root)

        def h(x: Array) -> Array:
            runs, points, n = x.shape
            every = [np.repeat(each, points, axis=0) for each in u]
            return self.flow.measure(k, x.reshape(-1, n), *every).reshape(runs, points, -1)

        found = self.rule.moments(h, state.x, state.root, self.limits, self.flow.y_period)
        return Innovation(wrapped(innovation(y, found.mean), self.flow.y_period), *found[1:])


def _corrected(before: GaussianState, given: Innovation, R_v: Array, missing: Array) -> GaussianState:
    """Correct with the outputs that are there: a missing one becomes one that does not depend on the state."""
    e, image, source, minus, _ = given
    R_root = root_of(R_v)
    if missing.any():
        e, R_root = np.where(missing, 0.0, e), root_of(without_missing(R_v, ~missing))
        image = np.where(missing[:, :, None], 0.0, image)
        minus = None if minus is None else np.where(missing, 0.0, minus)
    both, indefinite = _without(joint_root(image, R_root, source), minus)
    found = conditional(both[:, : e.shape[1]], both[:, e.shape[1] :])
    return GaussianState(before.x + mv(found.gain, e), found.root, before.indefinite + indefinite)


def _without(
    root: Float[Array, "runs n r"], minus: Float[Array, "runs m"] | None
) -> tuple[Float[Array, "runs n more"], Bool[Array, " runs"]]:
    """Return the root without the square of a vector in the first components, and whether that is indefinite."""
    if minus is None:
        return root, np.zeros(len(root), dtype=bool)
    m, P = minus.shape[1], covariance_of(root)
    P[:, :m, :m] -= np.einsum("ri,rj->rij", minus, minus)
    return covariance_root(P)


def gaussian_filter(
    model: Model, rule: MomentRule, n_steps: int, x0: Array, P0: Array, *, use_y0: bool
) -> GaussianFilter:
    """Return the filter of a design model with a rule for the moments."""
    flow = flow_of(model)
    if not all(has_root(flow.R_v_at(k)) for k in range(n_steps + 1 if model.varies else 1)):
        raise DesignError("R_v is singular: the filter needs measurement noise on every output", "")
    return GaussianFilter(flow, rule, *flow.start(x0, P0), model.nx, use_y0, flow.limits)
