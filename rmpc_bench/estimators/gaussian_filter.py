"""Filter of a nonlinear design model that keeps mean and covariance of the state, shared by the nonlinear filters.

Model   As models/flow.py, with additive noise.  The moments of f(x) and h(x) come from a rule of
        numerics/moment_transform.py:  x_pred = mean of f,  P_pred = covariance of f + Q_w;  before the correction the
        points are placed anew:  S = covariance of h + R_v,  L = cross-covariance of x and h times S^-1.  With a linear
        output the correction is that of the Kalman filter and needs no points.
        A missing measurement (NaN) is left out of the correction; without any, the filter predicts only.
        Where the flow has more states than the design model, the estimate has those of the design model, and all are in
        the info `x_all`.
Fails   A run gets status `singular` when its covariance has had a negative eigenvalue twice; the positive part is used
        until then.  A point where the model is not defined makes the run `diverged`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.models.flow import Flow, flow_of
from rmpc_bench.numerics.correction import Corrected, cross_correction, joseph_correction
from rmpc_bench.numerics.linalg import congruence, symmetrise
from rmpc_bench.numerics.moment_transform import MomentRule
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Model, Status

OK, SINGULAR = np.int8(Status.OK), np.int8(Status.SINGULAR)
INDEFINITE_TWICE = 2
"""So many indefinite covariances give a run the status `singular`."""
OVERHEAD = 5e-6
"""Time of a prediction and a correction per run, besides the points, in a block of 50 runs [s]."""


class GaussianState(NamedTuple):
    """State of the filter between steps; before a correction x and P are those of the prediction."""

    x: Float[Array, "runs n"]
    P: Float[Array, "runs n n"]
    indefinite: Int[Array, " runs"]
    """How often the covariance of the run was indefinite."""


class Innovation(NamedTuple):
    """Measurement against its prediction; the entries of a missing measurement have no effect."""

    e: Float[Array, "runs ny"]
    S: Float[Array, "runs ny ny"]
    C: Float[Array, "runs ny n"] | None
    """Output matrix of every run; None where the rule gives none."""
    cross: Float[Array, "runs n ny"] | None
    R_v: Float[Array, "runs ny ny"]


@dataclass(frozen=True, eq=False)
class GaussianFilter(Estimator):
    """A filter of mean and covariance.

    Parameters
    ----------
    flow : the design model as maps of many states
    rule : how the moments of f(x) and h(x) are computed
    x0, P0 : prediction of the first state of the flow and covariance of its error
    nx : number of states of the design model, the first ones of the flow
    use_y0 : whether to use y(0)
    """

    flow: Flow
    rule: MomentRule
    x_start: Float[Array, " n"]
    P_start: Float[Array, "n n"]
    nx: int
    use_y0: bool = True

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
        return self.rule.points_of(len(self.x_start)) * self.flow.cost_per_point + OVERHEAD

    def warm_up(self) -> None:
        """Compile the flow."""
        self.flow.warm_up()

    def init(self, n_runs: int) -> GaussianState:
        """Start every run at ``x0``."""
        P = np.tile(self.P_start, (n_runs, 1, 1))
        return GaussianState(np.tile(self.x_start, (n_runs, 1)), P, np.zeros(n_runs, dtype=int))

    def correct(self, k: int, state: GaussianState, y: Float[Array, "runs ny"]) -> tuple[GaussianState, Estimate]:
        """Use what was measured of y(k)."""
        given, count = self._innovation(k, state, y)
        after = Corrected(state.x, state.P)
        if k > 0 or self.use_y0:
            after = _corrected(after, given, np.isnan(y))
        info = {"e": given.e, "S": given.S}
        if len(self.x_start) > self.nx:
            info["x_all"] = after.x
        status = np.where(count >= INDEFINITE_TWICE, SINGULAR, OK).astype(np.int8)
        nx = self.nx
        return GaussianState(*after, count), Estimate(after.x[:, :nx], after.P[:, :nx, :nx], None, status, info)

    def predict(self, k: int, state: GaussianState, u: Float[Array, "runs nu"]) -> GaussianState:
        """Predict k+1 by the moments of f."""

        def f(x: Array) -> Array:
            runs, points, n = x.shape
            return self.flow.advance(k, x.reshape(-1, n), np.repeat(u, points, axis=0)).reshape(runs, points, n)

        found = self.rule.moments(f, state.x, state.P)
        P = symmetrise(found.covariance + self.flow.Q_w_at(k))
        return GaussianState(found.mean, P, state.indefinite + found.indefinite)

    def _innovation(
        self, k: int, state: GaussianState, y: Float[Array, "runs ny"]
    ) -> tuple[Innovation, Int[Array, " runs"]]:
        """Compare y(k) with its prediction; also how often the covariance was indefinite."""
        C, R_v = self.flow.C_at(k), self.flow.R_v_at(k)
        R = np.broadcast_to(R_v, (len(y), *R_v.shape))
        if C is not None:
            e, S = y - self.flow.measure(k, state.x), congruence(C, state.P) + R_v
            return Innovation(e, symmetrise(S), np.broadcast_to(C, (len(y), *C.shape)), None, R), state.indefinite

        def h(x: Array) -> Array:
            runs, points, n = x.shape
            return self.flow.measure(k, x.reshape(-1, n)).reshape(runs, points, -1)

        found = self.rule.moments(h, state.x, state.P)
        given = Innovation(y - found.mean, symmetrise(found.covariance + R_v), found.J, found.cross, R)
        return given, state.indefinite + found.indefinite


def _corrected(before: Corrected, given: Innovation, missing: Array) -> Corrected:
    """Correct with the outputs that are there: a missing one becomes one that does not depend on the state."""
    e, S, C, cross, R_v = given
    if missing.any():
        e, there = np.where(missing, 0.0, e), ~missing
        both = there[:, :, None] & there[:, None, :]
        S, R_v = (np.where(both, each, np.eye(e.shape[1])) for each in (S, R_v))
        C = None if C is None else np.where(missing[:, :, None], 0.0, C)
        cross = None if cross is None else np.where(missing[:, None, :], 0.0, cross)
    if C is not None:
        return joseph_correction(*before, e, C, R_v)
    assert cross is not None
    return cross_correction(*before, e, S, cross)


def gaussian_filter(
    model: Model, rule: MomentRule, n_steps: int, x0: Array, P0: Array, *, use_y0: bool
) -> GaussianFilter:
    """Return the filter of a design model with a rule for the moments.

    Parameters
    ----------
    model : linear or nonlinear design model
    rule : how the moments of f(x) and h(x) are computed
    n_steps : number of control periods N
    x0, P0 : mean and covariance of the initial state
    use_y0 : whether to use y(0)

    Raises
    ------
    DesignError
        If the model has no map f(x, u), or R_v is singular.
    """
    flow = flow_of(model)
    try:
        for k in range(n_steps + 1 if model.varies else 1):
            np.linalg.cholesky(flow.R_v_at(k))
    except np.linalg.LinAlgError:
        raise DesignError("R_v is singular: the filter needs measurement noise on every output", "") from None
    return GaussianFilter(flow, rule, *flow.start(x0, P0), model.nx, use_y0)
