"""Robust Kalman / H-infinity filter: bounds of the error's second moment and of its energy under model uncertainty.

Model   x(k+1) = (A + M1 F N) x(k) + w(k),  y(k) = (C + M2 F N) x(k) + v(k), with any F(k) of norm at most 1, M1 = H_A,
        M2 = H_C, N = G_x, and noises with mean zero and covariances Q_w, R_v and S_wv.  x_pred is x_hat.
        P is a bound of the second moment of x_pred - x for every F, and X of the second moment of x. theta^2 times the
        sum of |weight (x_pred - x)|^2 is at most the relative energy of noises and start.
Source  Simon, Optimal State Estimation (2006), section 12.2, after Hung and Yang, Automatica 39 (2003): P and X are P
        and P~ there, the equations are derived in numerics/robust_bounded_real.py.
Assumed S1 and S2 default to 2 P0 and 2 P0 + x0 x0', a bound that holds although x(0) and its error are correlated.
        Without this uncertainty it is the H-infinity predictor, with known inputs and means, and S1 defaults to P0.
        The filter ignores uncertainty in Bw, Bv, Dw and Dv.
Limit   Without uncertainty, theta = 0 and eps = 0 it is the one-step Kalman predictor.
Missing A run with gaps has its own gains and P from then on.  Where there is no bound with theta, this sample has no
        weight in the bound of the energy.
Cost    As every gain schedule.
Fails   Design error: alpha I > N X N' or I > theta^2 L P L' does not hold at some k, or a bound overflows.  With
        uncertainty also: A or S2 is singular, or the model has inputs or noises with a mean (F_hat draws the estimate
        towards zero).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from jaxtyping import Float

from rmpc_bench.estimators.bridging import Gains, RunByRun, with_outputs
from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, refuse_overflow, schedule_of
from rmpc_bench.models.uncertain_linear import DesignSystem, design_systems
from rmpc_bench.numerics.linalg import as_covariance, as_matrix
from rmpc_bench.numerics.robust_bounded_real import (
    BoundedRealStep,
    Bounds,
    Limits,
    OutOfRangeError,
    Uncertain,
    bounded_real_step,
)
from rmpc_bench.numerics.square_root import covariance_of, root_of
from rmpc_bench.types import Array, DesignError, Matrix, Model, NonNegative, Positive

EQUATION = r"\mathrm{E} (\hat x_k - x_k) (\hat x_k - x_k)^\top \le P_k \quad \mathrm{for\ all\ } F_k^\top F_k \le I"


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    alpha: Positive,
    theta: NonNegative = 0.0,
    weight: Matrix = 1.0,
    eps: NonNegative = 0.0,
    S1: Matrix | None = None,
    S2: Matrix | None = None,
) -> GainScheduleFilter:
    """Robust Kalman / H-infinity filter in one-step predictor form.

    Parameters
    ----------
    model : uncertain model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    alpha : weight of the uncertainty: alpha [M1; M2] [M1; M2]' is added to the covariance of the noises, and
        alpha I > N X N' must hold [unit of (N x)^2]
    theta : bound of the energy of the error, relative to that of the noises; 0 asks for none
    weight : (nx, nx) matrix L that multiplies the error in the bound of its energy
    eps : number added to the diagonal of both bounds at every step
    S1 : (nx, nx) bound P at k = 0 (default 2 P0, without uncertainty P0)
    S2 : (nx, nx) bound X at k = 0 (default 2 P0 + x0 x0'); not used without uncertainty

    Raises
    ------
    DesignError
        If a matrix has the wrong size or is singular, a bound does not exist at some k, or an uncertain model has
        inputs or noises with a mean.
    """
    systems, nx = design_systems(model, n_steps), len(x0)
    limits = Limits(alpha, theta, as_matrix(weight, nx, "weight"), eps)
    uncertain = any(_has_uncertainty(now) for now in systems)
    start = Bounds(
        root_of(_bound("S1", S1, (2.0 if uncertain else 1.0) * P0)),
        _bound("S2", S2, 2.0 * P0 + np.outer(x0, x0)) if uncertain else None,
    )
    if uncertain:
        _refuse(systems, start)
    steps = list(_steps(systems, start, limits))
    bounds = [start, *(step.after for step in steps)]
    P = list(covariance_of(np.array([each.root for each in bounds])))
    refuse_overflow(P, "bound")
    return schedule_of(
        [now.nominal for now in systems],
        x0,
        [step.K for step in steps],
        P[:-1],
        F=[step.F for step in steps],
        extra={"X": np.array([each.X for each in bounds[:-1]])} if uncertain else {},
        uncertainty_scale=1.0,
        root=np.array([each.root for each in bounds[:-1]]),
        recursion=RunByRun(partial(_of_one_run, systems, [each.X for each in bounds], limits)),
        P_is="bound",
    )


def _of_one_run(
    systems: list[DesignSystem], X: list[Array | None], limits: Limits, k: int, root: Array, there: Array
) -> Gains:
    """Return the gains of a run in which measurements are missing; X does not depend on them."""
    A, C, N, R = _uncertain(systems[k], limits.alpha)
    M, R = with_outputs(np.vstack([A, C]), R, there)
    outputs, bounds = Uncertain(A, M[len(A) :], N, R), Bounds(root, X[k])
    try:
        step = bounded_real_step(outputs, bounds, limits)
    except OutOfRangeError:
        step = bounded_real_step(outputs, bounds, limits._replace(theta=0.0))
    return Gains(step.K, step.K, step.after.root, covariance_of(root), F=step.F)


def _has_uncertainty(now: DesignSystem) -> bool:
    return bool((now.m.H_A.any() or now.m.H_C.any()) and now.m.G_x.any())


def _refuse(systems: list[DesignSystem], start: Bounds) -> None:
    """Refuse what an uncertain model does not go with."""
    if start.X is None or not np.linalg.cond(start.X) < 1e14:
        raise DesignError("is singular, but its inverse is needed; give a positive definite S2", "S2")
    if any(now.nominal.B.any() or now.nominal.f0.any() or now.nominal.d0.any() for now in systems):
        raise DesignError(
            "with an uncertain model this filter is defined without inputs and for noises with mean zero; choose "
            "another estimator, such as enhanced-robust"
        )


def _steps(systems: list[DesignSystem], bounds: Bounds, limits: Limits) -> Iterator[BoundedRealStep]:
    for k, now in enumerate(systems):
        try:
            step = bounded_real_step(_uncertain(now, limits.alpha), bounds, limits)
        except OutOfRangeError as error:
            raise _out_of_range(str(error), k) from None
        except np.linalg.LinAlgError:
            message = (
                f"A, X or the covariance of the innovation is singular at k = {k}; this filter needs their inverses"
            )
            raise DesignError(message) from None
        bounds = step.after
        yield step


def _uncertain(now: DesignSystem, alpha: float) -> Uncertain:
    nominal, M = now.nominal, np.vstack([now.m.H_A, now.m.H_C])
    noise = np.block([[nominal.Q_w, nominal.S_wv], [nominal.S_wv.T, nominal.R_v]])
    widened = noise + alpha * M.dot(M.T) if _has_uncertainty(now) else noise
    return Uncertain(now.m.A, now.m.C, now.m.G_x, widened)


def _out_of_range(parameter: str, k: int) -> DesignError:
    if parameter == "alpha":
        message = f"alpha I > N X N' does not hold at k = {k}: choose a larger alpha, or a smaller G_x or S2"
    else:
        message = f"I > theta^2 L P L' does not hold at k = {k}: choose a smaller theta, weight or S1"
    return DesignError(message, parameter)


def _bound(name: str, value: Matrix | None, default: Array) -> Float[Array, "n n"]:
    return default if value is None else as_covariance(value, len(default), name)
