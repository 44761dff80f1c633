"""Kalman filter with precomputed gains that predicts where a measurement is missing (NaN).

Model   As `gain_schedule`.  Outputs that are missing at k are left out of the correction.  From then on P and the gains
        of this run are computed by the same Riccati recursion, run by run; the other runs keep the precomputed ones.
Cost    As `gain_schedule` until a measurement is missing; then a Riccati step per run and step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rmpc_bench.estimators.gain_schedule import FilterState, GainScheduleFilter, over_time
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import at_sample, mv
from rmpc_bench.numerics.riccati import predicted_root
from rmpc_bench.numerics.square_root import corrected, covariance_of, root_of
from rmpc_bench.types import Array, Estimate


class BridgingState(NamedTuple):
    """State of the filter between steps."""

    x_pred: Float[Array, "runs nx"]
    e: Float[Array, "runs ny"]
    """Innovation of the last correction."""
    own: Bool[Array, " runs"]
    """Whether a measurement of the run has been missing, so that it has gains of its own."""
    root: Float[Array, "runs nx nx"]
    """Roots of the covariances of x_pred - x of these runs; not used for others."""
    shift: Float[Array, "runs nx"]
    """K e of these runs."""


class Step(NamedTuple):
    """A correction of the runs with gains of their own."""

    L: Float[Array, "own nx ny"]
    root: Float[Array, "own nx nx"]
    S: Float[Array, "own ny ny"]


@dataclass(frozen=True, eq=False)
class BridgingFilter(GainScheduleFilter):
    """A gain schedule of a Kalman filter that bridges missing measurements: it predicts where one is missing.

    Parameters
    ----------
    Q_w, R_v : (1 or samples, ...) covariances of the noises
    use_y0 : whether to use y(0)
    growth : factor of A P A' in the covariance of the prediction
    """

    Q_w: Float[Array, "kQ nx nx"] = field(default_factory=lambda: np.zeros((1, 0, 0)))
    R_v: Float[Array, "kR ny ny"] = field(default_factory=lambda: np.zeros((1, 0, 0)))
    use_y0: bool = True
    growth: float = 1.0
    bridges_missing = True

    @classmethod
    def of(
        cls, schedule: GainScheduleFilter, models: Sequence[LinearModel], *, use_y0: bool, growth: float = 1.0
    ) -> BridgingFilter:
        """Return a schedule as a filter that bridges missing measurements.

        Parameters
        ----------
        schedule : with the roots of the recursion without an inflated covariance
        models : the model at k = 0..N
        use_y0, growth : as in the design of the schedule
        """
        given = {each.name: getattr(schedule, each.name) for each in fields(schedule)}
        Q_w, R_v = over_time([each.Q_w for each in models]), over_time([each.R_v for each in models])
        return cls(**given, Q_w=Q_w, R_v=R_v, use_y0=use_y0, growth=growth)

    def init(self, n_runs: int) -> Any:
        """Start every run at ``x0``."""
        nx = len(self.x0)
        none = np.zeros(n_runs, dtype=bool)
        return BridgingState(*super().init(n_runs), none, np.zeros((n_runs, nx, nx)), np.zeros((n_runs, nx)))

    def correct(self, k: int, state: Any, y: Float[Array, "runs ny"]) -> tuple[Any, Estimate]:
        """Use what was measured of y(k)."""
        missing = np.isnan(y)
        own = state.own | missing.any(axis=1)
        after, estimate = super().correct(k, FilterState(state.x_pred, state.e), y)
        if not own.any():
            return BridgingState(*after, own, state.root, state.shift), estimate
        rows = np.flatnonzero(own)
        assert self.root is not None
        root = np.where(state.own[rows, None, None], state.root[rows], at_sample(self.root, k))
        step = self._step(k, root, missing[rows])
        e = np.where(missing[rows], 0.0, after.e[rows])
        x_hat = estimate.x_hat.copy()
        x_hat[rows] = state.x_pred[rows] + (mv(step.L, e) if self._corrects else 0.0)
        P = _with_rows(self.P, k, rows, covariance_of(step.root if self._corrects else root), len(y))
        S = _with_rows(self.S, k, rows, step.S, len(y))
        F = at_sample(self.F, k)
        root_next, shift = state.root.copy(), state.shift.copy()
        root_next[rows] = predicted_root(F, at_sample(self.Q_w, k), step.root, self.growth)
        shift[rows] = mv(F, mv(step.L, e))
        info = {**estimate.info, "S": S}
        return (
            BridgingState(*after, own, root_next, shift),
            estimate._replace(x_hat=x_hat, P=P, info=info),
        )

    def predict(self, k: int, state: Any, u: Float[Array, "runs nu"]) -> Any:
        """Predict k+1: x_pred+ = F x_pred + B u + K e."""
        if not state.own.any():
            return state._replace(x_pred=super().predict(k, FilterState(state.x_pred, state.e), u).x_pred)
        # The common gains do not count for these runs: their K e is known already.
        e = np.where(state.own[:, None], 0.0, state.e)
        x_pred = super().predict(k, FilterState(state.x_pred, e), u).x_pred
        x_pred[state.own] += state.shift[state.own]
        return state._replace(x_pred=x_pred)

    def _step(self, k: int, root: Float[Array, "own nx nx"], missing: Bool[Array, "own ny"]) -> Step:
        """Correct with the outputs that are there."""
        C, R_v = at_sample(self.C, k), at_sample(self.R_v, k)
        S = covariance_of(C @ root) + R_v
        if k == 0 and not self.use_y0:
            return Step(np.zeros((len(root), C.shape[1], C.shape[0])), root, S)
        there = ~missing
        # A missing output becomes one that does not depend on the state.
        C_run = np.where(missing[:, :, None], 0.0, C)
        R_run = np.where(there[:, :, None] & there[:, None, :], R_v, np.eye(len(C)))
        found = corrected(C_run, root_of(R_run), root)
        return Step(found.gain, found.root, S)


def _with_rows(schedule: Array | None, k: int, rows: Int[Array, " own"], own: Array, n_runs: int) -> Array:
    """Return the matrix of every run: the common one, and that of its own for some rows."""
    assert schedule is not None
    matrices = np.repeat(at_sample(schedule, k)[None], n_runs, axis=0)
    matrices[rows] = own
    return matrices
