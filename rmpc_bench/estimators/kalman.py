"""Kalman filter on the nominal model.

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k),  w ~ N(0, Q_w), v ~ N(0, R_v), white, independent.
        P is the covariance of x_hat - x, P_pred that of x_pred - x (the paper's P_t).
Source  zenere2018, (5)-(8).
Limit   this is the limit the other filters are tested against.
Cost    as every gain schedule.
Fails   design error where C P_pred C' + R_v is singular.
"""

from __future__ import annotations

from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter, riccati_schedule
from rmpc_bench.models.linear import Model
from rmpc_bench.numerics.kl_ball import Inflation
from rmpc_bench.types import Array


def design(
    model: Model, n_steps: int, *, x0: Float[Array, " nx"], P0: Float[Array, "nx nx"], form: Form = "filter"
) -> GainScheduleFilter:
    """Kalman filter, time varying from P0 on.

    Parameters
    ----------
    model : what the filter believes
    n_steps : number of control periods N; gains are made for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) its covariance
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    """
    return riccati_schedule(model, n_steps, x0, P0, lambda k, P_pred: Inflation(P_pred, 0.0), form)
