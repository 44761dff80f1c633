"""The control loop without its nonlinear parts: neither friction nor limits of the input.

Model   x(k+1) = A~ x + B~ u, y = C~ x + v; a filter with given gains, x_hat = x_pred + L e, e = y - C x_pred,
        x_pred(k+1) = F x_pred + B u + K e; the law u(k) = u(k-1) + K_r [r(k+1); ..] - K_x x_hat(k) - K_u u(k-1), of
        some laws with + K_s s(k) + K_y y(k) and a state s(k+1) = A_s s + B_x x_hat(k) + B_y y(k).
Input   the `gain_schedule` of the estimator and the `linear_law` of the controller; other pairs are not analysed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import (
    Array,
    Controller,
    DesignError,
    Estimator,
    GainSchedule,
    LawState,
    LinearLaw,
    LinearPlant,
    Model,
)

UNSTABLE = 1.0 - 1e-9
"""Spectral radius from which on a loop counts as not stable."""


class LoopGains(NamedTuple):
    """The matrices of filter and law at one k."""

    F: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    K: Float[Array, "nx ny"]
    L: Float[Array, "nx ny"]
    J: Float[Array, "nu ny"]  # u(k) = a(k) + J y(k), where a(k) depends on the past only
    from_x_pred: Float[Array, "nu nx"]
    from_u: Float[Array, "nu nu"]  # a(k) = from_x_pred x_pred(k) + from_u u(k-1) + what the reference adds


class LinearPair(NamedTuple):
    """An estimator-controller pair that can be written with gains."""

    schedule: GainSchedule
    law: LinearLaw

    def at(self, k: int) -> LoopGains:
        """Gains at k; -1 stands for the last ones."""
        filter_ = self.schedule
        over_time = (filter_.F, filter_.B, filter_.C, filter_.K, filter_.L)
        F, B, C, K, L = (matrices[k] if len(matrices) > 1 else matrices[0] for matrices in over_time)
        J = -self.law.K_x @ L  # u = .. - K_x x_hat, x_hat = (I - L C) x_pred + L y
        return LoopGains(F, B, C, K, L, J, -self.law.K_x - J @ C, np.eye(len(J)) - self.law.K_u)


def linear_pair(estimator: Estimator, controller: Controller) -> LinearPair | None:
    """Write a pair with gains; None where the filter is no gain schedule or the law is not linear."""
    schedule, law = estimator.gain_schedule, controller.linear_law()
    return None if schedule is None or law is None else LinearPair(schedule, law)


def constant_model(model: Model | None) -> Any:
    """Return the linear model of x at all k, without disturbances; None of one that varies, follows x or has a D."""
    if model is None or model.varies or model.feedthrough:
        return None
    try:
        return model.undisturbed.at(0)
    except DesignError:
        return None


def design_radius(model: Any, pair: LinearPair) -> float:
    """Spectral radius of the loop with a constant design model in place of the plant."""
    return spectral_radius(LinearPlant(model.A, model.B, model.C, np.eye(len(model.A))), pair)


def loop_remarks(model: Model, estimator: Estimator, controller: Controller) -> tuple[str, ...]:
    """Return a remark on a linear pair that leaves the design model unstable."""
    pair = linear_pair(estimator, controller)
    of_x = None if pair is None else constant_model(model)
    radius = 0.0 if pair is None or of_x is None else design_radius(of_x, pair)
    # A law without any effect on outputs keeps its input; the remark of the controller names the cause.
    idle = pair is not None and pair.law.K_r.size > 0 and not pair.law.K_r.any()
    if radius < UNSTABLE or idle:
        return ()
    return (
        f"the closed loop with the design model, without limits, is not stable: its spectral radius is {radius:.9g} "
        "and must be below 1, although outputs may look well for a time; choose other weights or a longer horizon",
    )


def spectral_radius(plant: LinearPlant, pair: LinearPair) -> float:
    """Largest modulus of the poles of the loop with the last gains; it decays in the long run if below 1."""
    g, state = pair.at(-1), pair.law.state
    if state is not None:
        g = g._replace(J=g.J + state.K_y)
    from_x = g.J @ plant.C
    loop = np.block(  # on [x, x_pred, u(k-1)]
        [
            [plant.A + plant.B @ from_x, plant.B @ g.from_x_pred, plant.B @ g.from_u],
            [g.B @ from_x + g.K @ plant.C, g.F + g.B @ g.from_x_pred - g.K @ g.C, g.B @ g.from_u],
            [from_x, g.from_x_pred, g.from_u],
        ]
    )
    if state is not None:
        loop = _with_state(loop, plant, g, state)
    return float(np.abs(np.linalg.eigvals(loop)).max())


def _with_state(
    loop: Float[Array, "q q"], plant: LinearPlant, g: LoopGains, state: LawState
) -> Float[Array, "all all"]:
    """Return the matrix of a loop whose law has a state s, on [x, x_pred, u(k-1), s]."""
    # s(k+1) = A_s s + B_x x_hat + B_y y with x_hat = (I - L C) x_pred + L y, y = C~ x.
    x_hat_of_x_pred = np.eye(len(g.F)) - g.L @ g.C
    from_u = np.zeros((len(state.A_s), len(g.from_u)))
    driven = np.hstack([(state.B_x @ g.L + state.B_y) @ plant.C, state.B_x @ x_hat_of_x_pred, from_u])
    by_state = np.vstack([plant.B @ state.K_s, g.B @ state.K_s, state.K_s])
    return np.block([[loop, by_state], [driven, state.A_s]])
