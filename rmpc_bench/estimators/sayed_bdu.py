"""Robust filter by regularised least squares with bounded data uncertainty.

Model   x(k+1) = (A + M Delta E_f) x(k) + B u(k) + f0 + (Bw + M Delta E_g) w(k),  y(k) = C x(k) + d0 + v~(k), with any
        Delta of norm at most 1, M = [H_A H_Bw], E_f = [G_x; 0], E_g = [0; G_w]; w and v~ white and uncorrelated.
        Every step estimates (x(k), w(k)) from y(k+1) by least squares under the worst Delta.  P is the matrix of the
        quadratic form of this problem; it does not bound the error covariance.
Source  A. H. Sayed, A framework for state-space estimation with uncertain models, IEEE Trans. Automatic Control 46
        (2001) 998-1013: the filter in time- and measurement-update form; here E_f' E_g = 0, so that G does not change.
Assumed lam = (1 + alpha) lam_l with lam_l = |M' C' R^-1 C M|, the paper's approximation that avoids a search for lam.
        The filter ignores uncertainty in C, Bv, Dw and Dv; use R to account for H_Dv.  The paper's noises have mean
        zero; here means enter through f0 and d0 without uncertainty.
Limit   C M = 0 or no uncertainty gives the Kalman filter.
Cost    As every gain schedule.
Fails   Design error: R is singular although lam is needed, or w~ and v~ are correlated.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter, predictor_schedule, refuse_overflow
from rmpc_bench.models.design_noise import DesignSystem, design_systems
from rmpc_bench.numerics.kl_ball import LARGEST
from rmpc_bench.numerics.linalg import as_covariance, symmetrise
from rmpc_bench.numerics.riccati import filter_step
from rmpc_bench.types import Array, DesignError, Matrix, Model, NonNegative


class Multiplier(NamedTuple):
    """Terms of one step that follow from the uncertainty and do not depend on P."""

    lam: float
    """Multiplier; 0 if the uncertainty has no effect on y(k+1)."""
    surplus: Float[Array, "ny ny"]
    """Matrix subtracted from R at k+1, C M M' C' / lam."""
    noise: Float[Array, "nx nx"]
    """Covariance of the modified noise in x(k+1)."""


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    alpha: NonNegative = 0.5,
    R: Matrix | None = None,
    form: Form = "filter",
) -> GainScheduleFilter:
    """Sayed's robust filter; equal to the Kalman filter if the model has no uncertainty.

    Parameters
    ----------
    model : uncertain model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    alpha : relative excess of lam over its lower bound
    R : (ny, ny) covariance of the measurement noise in the design (default: that of the model)
    form : `filter` uses y(k) for x_hat(k), `predictor` does not

    Raises
    ------
    DesignError
        If R is not admissible or singular, the noises are correlated, or P overflows.
    """
    systems = design_systems(model, n_steps)
    if any(now.nominal.S_wv.any() for now in systems):
        raise DesignError("this filter needs uncorrelated process and measurement noise; use kalman-predictor")
    R_given = _given(R, systems[0].nominal.ny)
    noise = [now.nominal.R_v if R_given is None else R_given for now in systems]
    P_pred, P, L, K, F, lam = [P0], [], [], [], [], []
    last: tuple[DesignSystem, DesignSystem] | None = None
    R_hat = noise[0]
    for k, now in enumerate(systems):
        try:
            step = filter_step(now.m.A, now.m.C, now.nominal.Q_w, R_hat, P_pred[-1])
        except np.linalg.LinAlgError:
            refuse_overflow(P_pred)
            raise DesignError(f"the covariance of the innovation is singular at k = {k}: set R", "R") from None
        after = min(k + 1, n_steps)
        if last is None or now is not last[0] or systems[after] is not last[1]:
            last = now, systems[after]
            chosen = _multiplier(now, systems[after].m.C, noise[after], alpha)
        R_hat = noise[after] - chosen.surplus
        transition, P_next = _predict(now, chosen, step.P)
        P.append(step.P)
        L.append(step.L)
        F.append(transition)
        K.append(transition.dot(step.L))
        lam.append(chosen.lam)
        P_pred.append(P_next)
    refuse_overflow(P_pred)
    models = [now.nominal for now in systems]
    extra = {"P_pred": np.array(P_pred[:-1]), "lam": np.array(lam)}
    predictor = predictor_schedule(models, x0, K, P_pred[:-1], F=F, extra=extra)
    return predictor if form == "predictor" else replace(predictor, L=np.array(L), P=np.array(P))


def _given(R: Matrix | None, ny: int) -> Array | None:
    try:
        return None if R is None else as_covariance(R, ny)
    except ValueError as error:
        raise DesignError(str(error), "R") from None


def _multiplier(now: DesignSystem, C: Array, R: Array, alpha: float) -> Multiplier:
    """Compute lam, Step 1; C and R are those of k+1."""
    m = now.m
    CM = C.dot(np.hstack([m.H_A if m.G_x.any() else 0.0 * m.H_A, m.H_Bw if m.G_w.any() else 0.0 * m.H_Bw]))
    if not CM.any():
        return Multiplier(0.0, np.zeros_like(R), now.nominal.Q_w)
    try:
        lam = (1.0 + alpha) * float(np.linalg.norm(CM.T.dot(np.linalg.inv(R)).dot(CM), 2))
    except np.linalg.LinAlgError:
        raise DesignError(_SINGULAR, "R") from None
    if not 0.0 < lam < LARGEST:
        raise DesignError(_SINGULAR, "R")
    # Contribution of v to the covariance of the process noise.
    rest = now.nominal.Q_w - m.Bw.dot(now.W).dot(m.Bw.T)
    noise = symmetrise(m.Bw.dot(_shrunk(now.W, m.G_w, lam)).dot(m.Bw.T) + rest)
    return Multiplier(lam, symmetrise(CM.dot(CM.T)) / lam, noise)


def _predict(now: DesignSystem, chosen: Multiplier, P: Array) -> tuple[Array, Array]:
    """Return the transition matrix and P_pred of k+1 from P(k), Steps 2 and 3."""
    A, G = now.m.A, now.m.G_x
    F = A
    if chosen.lam:
        P = _shrunk(P, G, chosen.lam)
        F = A - chosen.lam * A.dot(P).dot(G.T).dot(G)
    return F, symmetrise(A.dot(P).dot(A.T) + chosen.noise)


_SINGULAR = "the covariance of the measurement noise is singular, but lam needs its inverse: set R of this filter"


def _shrunk(P: Float[Array, "n n"], G: Float[Array, "s n"], lam: float) -> Float[Array, "n n"]:
    """Return (P^-1 + lam G'G)^-1, also of a singular P."""
    PG = P.dot(G.T)
    shrunk: Array = symmetrise(P - PG.dot(np.linalg.solve(np.eye(len(G)) / lam + G.dot(PG), PG.T)))
    return shrunk
