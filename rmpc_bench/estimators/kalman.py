"""Kalman filter on the nominal model, or on a state-dependent model linearised at the latest estimate.

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k),  w ~ N(0, Q_w), v ~ N(0, R_v), white, independent.
        P is the covariance of x_hat - x, P_pred that of x_pred - x (the paper's P_t).  A and B that depend on the state
        are those at x_hat(k) of each run; R_v may then depend on k.  With a model linearised along the trajectory it is
        the extended Kalman filter: x_pred and y_pred are those of the nonlinear model, A is its linearisation at
        x_hat(k) and u(k), C that at x_pred(k).
Source  zenere2018, (5)-(8).
Limit   The other filters are tested against this one.  With a state-dependent model whose A and B do not change it is
        the filter of the linear model.  With constant matrices the gain converges to the steady-state Kalman gain of
        `control-lqe`.
        A missing measurement (NaN) is left out of the correction; not with a state-dependent model.
Cost    As every gain schedule; a Riccati step per run and step with a state-dependent model.
Fails   Design error: C P_pred C' + R_v is singular, or R_v for a state-dependent model.  With a state-dependent model a
        run gets status `diverged` if its estimate exceeds the model's limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.bridging import RiccatiRecursion
from rmpc_bench.estimators.gain_schedule import (
    Form,
    GainScheduleFilter,
    riccati_schedule,
    schedule_of,
    singular_innovation,
    uncorrelated,
)
from rmpc_bench.models.noise_sets import NoiseKind, stochastic_sets, with_noise_kind
from rmpc_bench.models.state_dependent import StateDependentModel
from rmpc_bench.numerics.linalg import check_signal, driven, has_root, innovation, mv, symmetrise
from rmpc_bench.numerics.riccati import filter_step, predicted_root
from rmpc_bench.numerics.square_root import corrected, covariance_of, root_of
from rmpc_bench.types import Array, DesignError, Estimate, Estimator, Model, Status, as_estimate

EQUATION = r"""\hat x_{k|k} = \hat x_{k|k-1} + L_k (y_k - C \hat x_{k|k-1}), \quad
L_k = P_{k|k-1} C^\top (C P_{k|k-1} C^\top + R_v)^{-1}, \quad P_{k+1|k} = A (I - L_k C) P_{k|k-1} A^\top + Q_w"""


OK, DIVERGED = np.int8(Status.OK), np.int8(Status.DIVERGED)


class RelinearisedState(NamedTuple):
    """State of the filter between steps; before a correction x_hat and the root of P are those of the prediction."""

    x_hat: Float[Array, "runs nx"]
    root: Float[Array, "runs nx nx"]


@dataclass(frozen=True, eq=False)
class RelinearisedFilter(Estimator):
    """Kalman filter that evaluates a state-dependent model at every estimate."""

    model: StateDependentModel  # state-dependent model
    x0: Float[Array, " nx"]  # x0, P0: prediction before the first measurement and covariance of its error
    P0: Float[Array, "nx nx"]
    use_y0: bool = True  # whether to use y(0)

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """The innovation."""
        return {"e": (self.model.ny,)}

    def warm_up(self) -> None:
        """Compile the kernel of the model."""
        self.model.warm_up()

    def init(self, n_runs: int) -> RelinearisedState:
        """Start every run at ``x0``."""
        return RelinearisedState(np.tile(self.x0, (n_runs, 1)), np.tile(root_of(self.P0), (n_runs, 1, 1)))

    def correct(
        self, k: int, state: RelinearisedState, y: Float[Array, "runs ny"]
    ) -> tuple[RelinearisedState, Estimate]:
        """Use y(k) with the gain of the run."""
        C, (x_pred, root) = self.model.C, state
        e = innovation(y, mv(C, x_pred))
        after = state
        if k > 0 or self.use_y0:
            found = corrected(C, root_of(self.model.R_v_at(k)), root)
            after = RelinearisedState(x_pred + mv(found.gain, e), found.root)
        # True for NaN, which the closed loop detects itself.
        sound = ~(np.abs(after.x_hat) > self.model.largest).any(axis=1)
        P = covariance_of(after.root)
        return after, Estimate(after.x_hat, P, None, np.where(sound, OK, DIVERGED), {"e": e})

    def predict(self, k: int, state: RelinearisedState, u: Float[Array, "runs nu"]) -> RelinearisedState:
        """Predict k+1 with the model at x_hat(k)."""
        A, B = self.model.at_state(state.x_hat)
        return RelinearisedState(mv(A, state.x_hat) + driven(B, u), predicted_root(A, self.model.Q_w, state.root))


class TrajectoryState(NamedTuple):
    """State of the filter between steps; before a correction x_hat and the root of P are those of the prediction."""

    x_hat: Float[Array, "runs nx"]
    root: Float[Array, "runs nx nx"]
    u: Float[Array, "runs nu"]  # input at which the output is linearised, the last one that was applied


@dataclass(frozen=True, eq=False)
class TrajectoryFilter(RelinearisedFilter):
    """Extended Kalman filter: it predicts with the nonlinear model and linearises at every estimate."""

    @property
    def cost_per_step(self) -> float:
        """Time of two linearisations and a prediction, run by run [s]."""
        return 7e-4

    def init(self, n_runs: int) -> Any:
        """Start every run at ``x0``."""
        return TrajectoryState(*super().init(n_runs), np.zeros((n_runs, self.model.nu)))

    def correct(self, k: int, state: Any, y: Float[Array, "runs ny"]) -> tuple[Any, Estimate]:
        """Use y(k) with the output linearised at the prediction of the run."""
        e, after = innovation(y, self.model.measure(state.x_hat)), state
        if k > 0 or self.use_y0:
            C = self.model.around(k, state.x_hat, state.u).C
            found = corrected(C, root_of(self.model.R_v_at(k)), state.root)
            after = TrajectoryState(state.x_hat + mv(found.gain, e), found.root, state.u)
        return after, as_estimate(Estimate(after.x_hat, covariance_of(after.root), info={"e": e}))

    def predict(self, k: int, state: Any, u: Float[Array, "runs nu"]) -> Any:
        """Predict k+1 with the nonlinear model; P with its linearisation at x_hat(k) and u(k)."""
        check_signal("u", u, len(state.x_hat), self.model.nu)
        A = self.model.around(k, state.x_hat, u).A
        root = predicted_root(A, self.model.Q_w, state.root)
        return TrajectoryState(self.model.advance(k, state.x_hat, u), root, u)


def design(
    model: Model | StateDependentModel,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    M0: Float[Array, "nx nx"] | None = None,
    form: Form = "filter",
    noise: NoiseKind = "nominal",
    use_y0: bool = True,
) -> GainScheduleFilter | RelinearisedFilter:
    """Time-varying Kalman filter; a state-dependent model is evaluated at the latest estimate.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    M0 : (nx, nx) shape matrix of the ellipsoid of a bounded part of x(0) - x0 (default: no bounded part)
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    noise : `nominal`: stochastic noises only; `matched` adds the covariance M / (n + 2) of bounded noises
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If an innovation covariance is singular, or a key is not available for a state-dependent model.
    """
    if isinstance(model, StateDependentModel):
        return _relinearised(model, n_steps, x0, P0, form, noise, use_y0)
    design_model, P0 = with_noise_kind(model, P0, M0, noise)
    return riccati_schedule(design_model, n_steps, x0, P0, form=form, use_y0=use_y0)


def _relinearised(
    model: StateDependentModel, n_steps: int, x0: Array, P0: Array, form: Form, noise: NoiseKind, use_y0: bool
) -> RelinearisedFilter:
    for name, value, wanted in (("form", form, "filter"), ("noise", noise, "nominal")):
        if value != wanted:
            raise DesignError(f"{value} is not available for a state-dependent model; choose {wanted}", name)
    if not has_root(np.array([model.R_v_at(k) for k in range(n_steps + 1)])):
        raise DesignError("R_v is singular: the state-dependent model needs measurement noise", "")
    return (TrajectoryFilter if model.has_offsets else RelinearisedFilter)(model, x0, P0, use_y0)


def stationary_filter(
    model: Model,
    x0: Float[Array, " nx"],
    K: Float[Array, "nx ny"],
    P_pred: Float[Array, "nx nx"],
    form: Form,
) -> GainScheduleFilter:
    """Return the filter with the gain K and the solution P_pred of the Riccati equation of its one-step predictor.

    A run has gains of its own after a missing measurement.  A DesignError says that the model depends on k, its noises
    are correlated, or the covariance of the innovation is singular.
    """
    if model.varies:
        raise DesignError("stationary gains need a design model that does not depend on k; use kalman")
    now = uncorrelated(model, 0)[0]
    try:
        step = filter_step(now.A, now.C, now.Q_w, now.R_v, root_of(P_pred))
    except np.linalg.LinAlgError:
        raise singular_innovation(0) from None
    S = symmetrise(now.C @ P_pred @ now.C.T + now.R_v)
    P, L = (P_pred, None) if form == "predictor" else (step.P, [step.L])
    others: dict[str, Any] = {"sets": stochastic_sets(model), "S": S[None], "root": root_of(P_pred)[None]}
    return schedule_of([now], x0, [K], [P], L=L, recursion=RiccatiRecursion([now], corrects=form == "filter"), **others)
