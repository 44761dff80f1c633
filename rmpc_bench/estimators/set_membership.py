"""Set-membership filter: an ellipsoid that contains the state, for noises of which only bounds are known.

Model   x(k+1) = A_k x(k) + B_k u(k) + w,  y(k) = C_k x(k) + v,  w in E(0, M_w), v in E(0, M_v), x(0) - x0 in E(0, M0),
        plus Gaussian noises, which `inflate` counts as noises in their confidence ellipsoids: every set becomes the
        ellipsoid of least trace around the sum of both.  x_hat - x is in E(0, M); there is no P.
Source  ma2025, section V (ESM, from its [25]): (16)-(24) without what is stochastic; the inflation, which the paper
        does not mention, is what its Table I fits.  Maksarov and Norton (1996) for the other update.
Update  linear: y moves the centre with a gain that minimises tr M and is known before any data.
        maksarov-norton: the smallest combination of the predicted set and of the states that y allows, which depends on
        the data; y shrinks M the more, the less likely it was.
Limit   a measurement without information (M_v -> infinity) leaves the prediction; without stochastic noises and with
        q at its fixed point, the linear update is the filter `mixed`.
Cost    linear: as every gain schedule; maksarov-norton: two searches over one number, about 30 us per run and step.
Fails   linear: design error where the innovation is without noise in some direction, also where its values are
        consistent, as for M_v of rank 1 with ny > nx + 1.  maksarov-norton: design error where M_v is flat, empty-set
        where no predicted state explains y; without `inflate` Gaussian noise leads there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, mixed_schedule, over_time, uncorrelated
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import NoiseSets
from rmpc_bench.numerics.ellipsoid import Criterion, intersection, sum_shapes
from rmpc_bench.numerics.linalg import at_sample, mv, symmetrise
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Model, Status

OK, EMPTY_SET = np.int8(Status.OK), np.int8(Status.EMPTY_SET)

Level: TypeAlias = Annotated[float, Gt(0), Lt(1)]


class SetState(NamedTuple):
    """What the next step needs."""

    x: Float[Array, "runs nx"]
    """Centre of the set: before a correction x_pred, after it x_hat."""
    M: Float[Array, "runs nx nx"]
    """Its shape."""


@dataclass(frozen=True, eq=False)
class IntersectionFilter(Estimator):
    """A set-membership filter whose sets depend on the data.

    Parameters
    ----------
    x0, M0 : (nx,), (nx, nx) centre and shape of the set of x(0)
    models : the model at k = 0..N, once where nothing varies
    M_w, M_v : (1 or samples, ...) shapes of the sets of the noises
    sets : what these sets are made of
    criterion : what a correction makes smallest
    use_y0 : whether y(0) counts
    """

    x0: Float[Array, " nx"]
    M0: Float[Array, "nx nx"]
    models: tuple[LinearModel, ...]
    M_w: Float[Array, "kw nx nx"]
    M_v: Float[Array, "kv ny ny"]
    sets: NoiseSets
    criterion: Criterion = "trace"
    use_y0: bool = True

    estimates_set = True

    def init(self, n_runs: int) -> SetState:
        """Start every run with the same set."""
        return SetState(np.tile(self.x0, (n_runs, 1)), np.tile(self.M0, (n_runs, 1, 1)))

    def correct(self, k: int, state: SetState, y: Float[Array, "runs ny"]) -> tuple[SetState, Estimate]:
        """Enclose the predicted states that explain y(k)."""
        now = self._at(k)
        e = y - mv(now.C, state.x) - now.d0
        if k == 0 and not self.use_y0:
            lam, met = np.zeros(len(y)), np.ones(len(y), dtype=bool)
        else:
            found = intersection(state.M, now.C, at_sample(self.M_v, k), e, self.criterion)
            state, lam, met = SetState(state.x + found.centre, found.M), found.lam, found.met
        return state, Estimate(state.x, None, state.M, np.where(met, OK, EMPTY_SET), {"e": e, "lam": lam})

    def predict(self, k: int, state: SetState, u: Float[Array, "runs nu"]) -> SetState:
        """Go to k+1."""
        now = self._at(k)
        x = mv(now.A, state.x) + mv(now.B, u) + now.f0
        moved = np.einsum("rik,jk->rij", np.einsum("ij,rjk->rik", now.A, state.M), now.A)
        return SetState(x, sum_shapes(symmetrise(moved), at_sample(self.M_w, k)))  # (18)

    def _at(self, k: int) -> LinearModel:
        return self.models[k] if len(self.models) > 1 else self.models[0]


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    M0: Float[Array, "nx nx"],
    inflate: bool = True,
    level: Level = 0.95,
    update: Literal["linear", "maksarov-norton"] = "linear",
    criterion: Criterion = "trace",
    use_y0: bool = True,
) -> GainScheduleFilter | IntersectionFilter:
    """Ellipsoid that contains the state.

    Parameters
    ----------
    model : what the filter believes; one without sets has no bounded noise
    n_steps : number of control periods N
    x0 : (nx,) centre of the initial state
    P0 : (nx, nx) covariance of the stochastic part of its error, which counts if `inflate`
    M0 : (nx, nx) shape of the ellipsoid of the bounded part
    inflate : whether stochastic noises count as bounded ones
    level : confidence of the ellipsoids that then stand for them
    update : `linear` corrects with gains known before any data; `maksarov-norton` intersects predicted and measured set
    criterion : what `maksarov-norton` makes smallest, the `trace` of the shape or the `volume`
    use_y0 : `false` takes x0, P0 and M0 for the estimate at k = 0 itself and leaves y(0) out

    Raises
    ------
    DesignError
        If the innovation is without noise at some step, a matrix grows beyond 1e100, the model's noises are correlated,
        or a measurement that `maksarov-norton` shall intersect has no noise in some direction.
    """
    sets = NoiseSets(model, level if inflate else None)
    start = sets.initial(P0, M0)
    if update == "linear":
        if criterion != "trace":
            raise DesignError("the linear update minimises the trace; only maksarov-norton has a choice", "criterion")
        return mixed_schedule(model, n_steps, x0, None, start, sets, use_y0=use_y0)
    models = uncorrelated(model, n_steps)
    M_w, M_v = ([made(k) for k in range(n_steps + 1)] for made in (sets.process, sets.measurement))
    for k, M in enumerate(M_v):
        if np.linalg.eigvalsh(M)[0] <= 1e-12 * np.abs(M).max():  # rounding of eigvalsh is about n * 1e-16 * scale
            raise DesignError(
                f"the set of the measurement noise is flat at k = {k}; maksarov-norton needs one that is not"
            )
    constant = all(each is models[0] for each in models)
    return IntersectionFilter(
        x0, start, tuple(models[:1] if constant else models), over_time(M_w), over_time(M_v), sets, criterion, use_y0
    )
