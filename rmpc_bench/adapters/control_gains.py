"""Stationary gains of python-control: Kalman filter (`dlqe`) and linear-quadratic regulator (`dlqr`).

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k) of the design model, which must not depend on k.
        control-lqe  `dlqe` gives the covariance P of x_pred - x and the gain of the predictor, K = A P C' (C P C' +
                     R_v)^-1; the filter has L = P C' (C P C' + R_v)^-1.
        control-lqr  u = u_op - K_x (x_hat - x_op) with the gain of `dlqr`, which minimises the sum over all k of
                     x' Q_x x + u' R_u u.  It regulates to 0, or to the operating point, as `lqr`.  Disturbances of the
                     model, which no input changes, are held over the horizon, as by `lqr`.
Limit   The gains of `kalman` after convergence, and of `lqr` with a long horizon.
Cost    As every gain schedule, and one small product per run and step.
Fails   Design error: no stationary gain, a model that depends on k, correlated noises, or a known mean of the noise
        (lqr).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.state_feedback import Lqr, refuse_mean, stages_of
from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter
from rmpc_bench.estimators.kalman import stationary_filter
from rmpc_bench.estimators.kalman_predictor import STABLE
from rmpc_bench.extras import library
from rmpc_bench.types import Array, DesignError, Estimator, Matrix, Model

EQUATION = {
    "lqe": r"""\hat x_{k|k} = \hat x_{k|k-1} + L (y_k - C \hat x_{k|k-1}), \quad
P = A (I - L C) P A^\top + Q_w, \quad L = P C^\top (C P C^\top + R_v)^{-1}""",
    "lqr": r"\min_u \sum_{k=0}^{\infty} x_k^\top Q_x x_k + u_k^\top R_u u_k",
}


def lqe(model: Model, n_steps: int, *, x0: Float[Array, " nx"], form: Form = "filter") -> GainScheduleFilter:
    """Stationary Kalman filter with the gain of python-control's `dlqe`.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods N
    x0 : (nx,) prediction of x(0)
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    """
    now, solve = model.at(0), library("control").dlqe
    K, P_pred, _ = _solved(lambda: solve(now.A, np.eye(now.nx), now.C, now.Q_w, now.R_v, method="scipy"))
    _refuse_unstable(now.A - K @ now.C, "A - K C", "use kalman")
    return stationary_filter(model, x0, K, P_pred, form)


def lqr(model: Model, n_steps: int, estimator: Estimator, *, Q_x: Matrix, R_u: Matrix) -> Lqr:
    """Linear-quadratic regulator with the gain of python-control's `dlqr`.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods N
    estimator : estimator of the method
    Q_x : weight of the state: a number, a diagonal or a matrix
    R_u : weight of the input, positive definite
    """
    if model.varies:
        raise DesignError("stationary gains need a design model that does not depend on k; use lqr")
    of_x = model.undisturbed
    stages, solve = stages_of(of_x, 1, 1, Q_x, R_u), library("control").dlqr
    refuse_mean(of_x, estimator, stages)
    A, B, Q, R = (matrices[0] for matrices in stages)
    K, P, _ = _solved(lambda: solve(A, B, Q, R, method="scipy"))
    _refuse_unstable(A - B @ K, "A - B K", "use lqr, or weigh every mode that is not stable in Q_x")
    if model.n_disturbances:
        B_d = model.at(0).A[: of_x.nx, of_x.nx :]
        K = np.hstack([K, _held(A, B, R, K, P) @ B_d])
    return Lqr(K[None], None, np.zeros((1, len(K))), point=model.operating_point)


def _held(A: Array, B: Array, R: Array, K: Array, P: Array) -> Float[Array, "nu nx"]:
    """Return the gain of a constant part of x(k+1) that is held without end: the limit of `lqr` for a long horizon."""
    # With a constant part v the value of x is x' P x + 2 g' x and a constant, where g = (A - B K)' (g + P v); hence g +
    # P v = (I - (A - B K)')^-1 P v.
    held = np.linalg.solve(np.eye(len(A)) - (A - B @ K).T, P)
    gain: Array = np.linalg.solve(R + B.T @ P @ B, B.T @ held)
    return gain


def _refuse_unstable(closed: Float[Array, "nx nx"], name: str, way_out: str) -> None:
    """Raise a DesignError if a gain is not that of the stabilising solution."""
    radius = float(np.abs(np.linalg.eigvals(closed)).max())
    if not radius < STABLE:
        why = f"the spectral radius of {name} is {radius:.9g}"
        raise DesignError(f"the Riccati equation has no stabilising solution: {why}; {way_out}")


def _solved(call: Callable[[], Any]) -> Any:
    try:
        return call()
    # The library raises errors of its own and of NumPy, SciPy and slycot.
    except Exception as error:
        raise DesignError(f"python-control finds no stationary gain: {error}") from error
