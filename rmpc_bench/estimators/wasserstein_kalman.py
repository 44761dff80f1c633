"""Kalman filter for the least favourable joint density in a Wasserstein ball around the nominal one.

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k), nominally w ~ N(0, Q_w), v ~ N(0, R_v).  At every step
        the joint density of (x(k), y(k)) given the past may be any density within Wasserstein distance `radius` (type
        2) of the nominal one, whose covariance is Sigma = [P_pred, P_pred C'; C P_pred, C P_pred C' + R_v].  S is the
        least favourable covariance, L = S_xy S_yy^-1, P = S_xx - L S_yx and P_pred(k+1) = A P A' + Q_w.
        V is S_xx, which may exceed P_pred.  S_xy and S_yy differ from the nominal ones, too: it is no Kalman filter
        with another P_pred.
Source  Shafieezadeh-Abadeh, Nguyen, Kuhn, Mohajerin Esfahani, Wasserstein distributionally robust Kalman filtering,
        NeurIPS 2018, Algorithms 1-3.
Assumed The step of Frank-Wolfe maximises the objective; see numerics/wasserstein.py.  The tolerance of the relative
        duality gap is 1e-10; the authors' 1e-4 leaves P 1.8 % too small on their example.  The gap bounds the error of
        tr P of a step, its root that of L and P: with 1e-10 tr P of the stationary filter on wkf2018 with radius 0.2 is
        off by 2e-6.
Limit   radius = 0 is the Kalman filter.  If y does not depend on x, tr P = ((tr P_pred)^1/2 + radius)^2.
        If Sigma is multiplied by c and the radius by c^1/2, L stays as it is.
Missing The ball of a run with missing measurements is that around x(k) and the outputs that are there.  Without any,
        P = (1 + radius / (tr P_pred)^1/2)^2 P_pred.
Cost    As every gain schedule.  The design solves one saddle point per step, until P_pred of a model that does not
        depend on k is steady.
Fails   Design error if S_yy is singular.  With R_v = 0 the gain relies on measurements without error.
        The radius has the unit of x and y, and is shared by all of them: scale the states if their units differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.bridging import Gains, Outputs, RunByRun
from rmpc_bench.estimators.gain_schedule import (
    Form,
    GainScheduleFilter,
    over_time,
    refuse_overflow,
    schedule_of,
    singular_innovation,
    uncorrelated,
)
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import stochastic_sets
from rmpc_bench.numerics.linalg import nearly_equal
from rmpc_bench.numerics.riccati import filter_step, predicted_root
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.numerics.wasserstein import joint_factor, least_favourable
from rmpc_bench.types import Array, Model, NonNegative, Positive

EQUATION = r"""\max_S \mathrm{tr} (S_{xx} - S_{xy} S_{yy}^{-1} S_{yx}) \quad \mathrm{with} \quad \mathrm{tr}
\left( S + \Sigma - 2 (\Sigma^{1/2} S \Sigma^{1/2})^{1/2} \right) \le \rho^2, \quad L_k = S_{xy} S_{yy}^{-1}"""
_STEADY = 1e-13
"""Change of P_pred per step, relative to the standard deviations, that counts as rounding."""


class WassersteinStep(NamedTuple):
    """One period of the covariances."""

    L: Float[Array, "nx ny"]
    root: Float[Array, "nx nx"]  # root of P
    V: Float[Array, "nx nx"]
    S: Float[Array, "ny ny"]  # least favourable covariance of the innovation
    gap: float


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    radius: NonNegative,
    tolerance: Positive = 1e-10,
    form: Form = "filter",
    use_y0: bool = True,
) -> GainScheduleFilter:
    """Wasserstein distributionally robust Kalman filter.

    Parameters
    ----------
    model : nominal model, the centre of the ball
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state; may be singular
    radius : radius of the ball in the unit of x and y, the tolerance of model error per step
    tolerance : relative duality gap at which a step ends; the gap is in the series of the design
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If the covariance of the innovation is singular at some step, a covariance exceeds 1e100, or the noises of the
        model are correlated.
    """
    models = uncorrelated(model, n_steps)
    saddle, roots, steps = SaddlePoints(models, radius, tolerance), [root_of(P0)], list[WassersteinStep]()
    is_steady = False
    for k, now in enumerate(models):
        if is_steady:
            steps.append(steps[-1])
            roots.append(roots[-1])
            continue
        try:
            steps.append(saddle.step(k, roots[-1], measured=k > 0 or use_y0))
        except np.linalg.LinAlgError:
            refuse_overflow(covariance_of(np.array(roots)))
            raise singular_innovation(k) from None
        roots.append(predicted_root(now.A, now.Q_w, steps[-1].root))
        # P_pred of a steady filter is the same; a constant model is one object.
        is_steady = (
            k > 0
            and not model.varies
            and bool(nearly_equal(covariance_of(roots[-2]), covariance_of(roots[-1]), _STEADY))
        )
    P_pred = covariance_of(np.array(roots))
    refuse_overflow(P_pred)
    V, corrects = [each.V for each in steps], form == "filter"
    return schedule_of(
        models,
        x0,
        [now.A.dot(each.L) for now, each in zip(models, steps, strict=True)],
        covariance_of(np.array([each.root for each in steps])) if corrects else V,
        L=[each.L for each in steps] if corrects else None,
        extra={"P_pred": P_pred[:-1], "V": np.array(V), "gap": np.array([each.gap for each in steps])},
        sets=stochastic_sets(model),
        S=over_time([each.S for each in steps]),
        root=np.array(roots[:-1]),
        recursion=RunByRun(partial(saddle.of_one_run, corrects, use_y0)),
    )


class SaddlePoints:
    """The least favourable covariances of a recursion, each started from the gain of the one before."""

    def __init__(self, models: Sequence[LinearModel | Outputs], radius: float, tolerance: float) -> None:
        self.models, self.radius, self.tolerance = models, radius, tolerance
        self._L: tuple[Array, Array] | None = None
        """The gains of the last two steps; the next computation starts from their extrapolation."""

    def step(self, k: int, root: Float[Array, "nx nx"], *, measured: bool) -> WassersteinStep:
        """Return gain and covariances at k; raise a LinAlgError if the covariance of the innovation is singular."""
        now = self.models[k]
        if not measured or self.radius == 0.0:
            nominal = filter_step(now.A, now.C, now.Q_w, now.R_v, root, measured=measured)
            S = covariance_of(now.C.dot(root)) + now.R_v
            return WassersteinStep(nominal.L, nominal.root, covariance_of(root), S, 0.0)
        if self._L is None:
            nominal = filter_step(now.A, now.C, now.Q_w, now.R_v, root)
            self._L = nominal.L, nominal.L
        G, nx = joint_factor(now.C, root, root_of(now.R_v)), len(root)
        before, last = self._L
        found = least_favourable(G, self.radius, 2.0 * last - before, self.tolerance)
        self._L = last, found.L
        S = found.S
        return WassersteinStep(found.L, found.root, S[:nx, :nx], S[nx:, nx:], found.gap)

    def of_one_run(self, corrects: bool, use_y0: bool, k: int, root: Array, there: Array) -> Gains:
        """Return the gains of a run in which measurements are missing, from the ball around what is there."""
        now: Any = self.models[k]
        alone = SaddlePoints([Outputs.of(now, there)], self.radius, self.tolerance)
        step, S = alone.step(0, root, measured=k > 0 or use_y0), covariance_of(now.C.dot(root)) + now.R_v
        S[np.ix_(there, there)] = step.S
        P = covariance_of(step.root) if corrects else step.V
        return Gains(step.L, now.A.dot(step.L), predicted_root(now.A, now.Q_w, step.root), P, S)
