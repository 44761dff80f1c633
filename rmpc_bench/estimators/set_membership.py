"""Set-membership filter: an ellipsoid that contains the state, for noises with known bounds.

Model   x(k+1) = A_k x(k) + B_k u(k) + w,  y(k) = C_k x(k) + v,  w in E(0, M_w), v in E(0, M_v), x(0) - x0 in E(0, M0),
        plus Gaussian noises.  With `inflate` every set is the ellipsoid of least trace that contains its sum with the
        confidence ellipsoid of the Gaussian noise. x_hat - x is in E(0, M); there is no P.
Source  ma2025, section V (ESM, from its [25]): (16)-(24) without the stochastic terms.  The paper does not mention the
        inflation, but its Table I agrees with it.  Maksarov and Norton (1996) for the other update.
Update  linear           corrects the centre with a gain that minimises tr M and does not depend on the data.
        maksarov-norton  computes the smallest fusion of the predicted set with the set of states that are consistent
                         with y.  It depends on the data: M shrinks more for a less likely y.
Missing maksarov-norton: a sample of which an output is missing (NaN) leaves the predicted set.  linear: the
        run has gains and sets of its own from then on, for the outputs that are there.
Limit   A measurement without information (M_v -> infinity) leaves the prediction.  Without stochastic noises and with q
        at its fixed point the linear update is the filter `mixed`.
Cost    linear: as every gain schedule.  maksarov-norton: two scalar searches, about 30 us per run and step.
Fails   linear: design error if the innovation has no noise in some direction, even if its values are always consistent,
        as for M_v of rank 1 with ny > nx + 1.  maksarov-norton: design error if M_v is singular; status `empty-set` if
        no predicted state is consistent with y, which Gaussian noise can cause without `inflate`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, mixed_schedule, over_time, uncorrelated
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import LEVEL, NoiseSets
from rmpc_bench.numerics.ellipsoid import Criterion, intersection, sum_shapes
from rmpc_bench.numerics.linalg import at_sample, driven, innovation, mv, symmetrise
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Model, Status

EQUATION = r"""(\hat x_k - x_k)^\top M_k^{-1} (\hat x_k - x_k) \le 1, \quad
M_{k|k} = (q_k^{-1} + 1) T M_{k|k-1} T^\top + (q_k + 1) L_k M_v L_k^\top, \quad T = I - L_k C"""


OK, EMPTY_SET = np.int8(Status.OK), np.int8(Status.EMPTY_SET)

Level: TypeAlias = Annotated[float, Gt(0), Lt(1)]


class SetState(NamedTuple):
    """State of the filter between steps."""

    x: Float[Array, "runs nx"]  # centre of the set: x_pred before a correction, x_hat after it
    M: Float[Array, "runs nx nx"]  # shape matrix of the set


@dataclass(frozen=True, eq=False)
class IntersectionFilter(Estimator):
    """A set-membership filter whose sets depend on the data."""

    x0: Float[Array, " nx"]  # x0, M0: centre and shape matrix of the set of x(0)
    M0: Float[Array, "nx nx"]
    models: tuple[LinearModel, ...]  # the model at k = 0..N, a single one if it is constant
    M_w: Float[Array, "kw nx nx"]  # M_w, M_v: shape matrices of the sets of the noises
    M_v: Float[Array, "kv ny ny"]
    sets: NoiseSets  # sets from which M_w and M_v are computed
    criterion: Criterion = "trace"  # size measure that a correction minimises
    use_y0: bool = True  # whether to use y(0)

    estimates_set = True
    bridges_missing = True

    def init(self, n_runs: int) -> SetState:
        """Start every run with the same set."""
        return SetState(np.tile(self.x0, (n_runs, 1)), np.tile(self.M0, (n_runs, 1, 1)))

    def correct(self, k: int, state: SetState, y: Float[Array, "runs ny"]) -> tuple[SetState, Estimate]:
        """Enclose the predicted states that are consistent with y(k)."""
        now: LinearModel = at_sample(self.models, k)
        e = innovation(y, mv(now.C, state.x)) - now.d0
        if k == 0 and not self.use_y0:
            lam, met = np.zeros(len(y)), np.ones(len(y), dtype=bool)
        else:
            # The predicted set contains the state whether or not something is measured.
            missing: Array = np.asarray(np.isnan(y).any(axis=1))
            used = np.where(missing[:, None], 0.0, e)
            found = intersection(state.M, now.C, at_sample(self.M_v, k), used, self.criterion)
            x, M = np.where(missing[:, None], state.x, state.x + found.centre), found.M
            state = SetState(x, np.where(missing[:, None, None], state.M, M))
            lam, met = np.where(missing, 0.0, found.lam), found.met | missing
        return state, Estimate(state.x, None, state.M, np.where(met, OK, EMPTY_SET), {"e": e, "lam": lam})

    def predict(self, k: int, state: SetState, u: Float[Array, "runs nu"]) -> SetState:
        """Predict k+1."""
        now: LinearModel = at_sample(self.models, k)
        x = mv(now.A, state.x) + driven(now.B, u) + now.f0
        moved = np.einsum("rik,jk->rij", np.einsum("ij,rjk->rik", now.A, state.M), now.A)
        return SetState(x, sum_shapes(symmetrise(moved), at_sample(self.M_w, k)))  # (18)


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    M0: Float[Array, "nx nx"],
    inflate: bool = True,
    level: Level = LEVEL,
    update: Literal["linear", "maksarov-norton"] = "linear",
    criterion: Criterion = "trace",
    use_y0: bool = True,
) -> GainScheduleFilter | IntersectionFilter:
    """Filter that computes an ellipsoid that contains the state.

    Parameters
    ----------
    model : design model; a model without sets has no bounded noise
    n_steps : number of control periods N
    x0 : (nx,) estimate of the initial state before y(0)
    P0 : (nx, nx) covariance of the stochastic part of its error, used if `inflate`
    M0 : (nx, nx) shape matrix of the ellipsoid of the bounded part of its error
    inflate : whether confidence ellipsoids represent the stochastic noises
    level : probability of these confidence ellipsoids
    update : `linear` uses gains that do not depend on the data; `maksarov-norton` fuses predicted and measured set
    criterion : size measure that `maksarov-norton` minimises, `trace` of the shape matrix or `volume`
    use_y0 : `false` starts from x0, P0 and M0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If the innovation has no noise at some step, a matrix exceeds 1e100, the noises of the model are correlated, or
        M_v is singular for `maksarov-norton`, or the model has disturbances, whose sets need `inflate`.
    """
    if model.n_disturbances and not inflate:
        message = (
            "the drift of a disturbance has a variance and no bound: without `inflate` the estimate of it stays at 0"
        )
        raise DesignError(message, "inflate")
    sets = NoiseSets(model, level if inflate else None)
    start = sets.of_parts(P0, M0)
    if update == "linear":
        if criterion != "trace":
            message = "the linear update minimises the trace; other criteria need `update: maksarov-norton`"
            raise DesignError(message, "criterion")
        return mixed_schedule(model, n_steps, x0, None, start, sets, use_y0=use_y0)
    models = uncorrelated(model, n_steps)
    M_w, M_v = ([made(k) for k in range(n_steps + 1)] for made in (sets.process, sets.measurement))
    for k, M in enumerate(M_v):
        # The rounding of eigvalsh is about n * 1e-16 * scale.
        if np.linalg.eigvalsh(M)[0] <= 1e-12 * np.abs(M).max():
            raise DesignError(f"M_v is singular at k = {k}; maksarov-norton needs a full-rank M_v")
    constant = all(each is models[0] for each in models)
    return IntersectionFilter(
        x0, start, tuple(models[:1] if constant else models), over_time(M_w), over_time(M_v), sets, criterion, use_y0
    )
