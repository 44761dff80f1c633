"""Fading-memory Kalman filter: the covariance of the prediction grows by a factor, so that old measurements fade.

Model   As `kalman`, with P_pred(k+1) = alpha^2 A P(k) A' + Q_w.  With Q_w = 0 and without information at the start,
        x_hat(k) minimises the sum over j of alpha^(-2 (k - j)) |y(j) - C x(j)|^2_{R_v^-1}. P and P_pred contain the
        factor: they are no covariances of the errors of the model.
Source  Sorenson and Sacks, Information Sciences 3 (1971); Simon, Optimal State Estimation (2006), section 7.4.
Assumed alpha is squared, and Q_w is not multiplied.
Limit   alpha = 1 gives the Kalman filter.
        A missing measurement (NaN) is left out of the correction.
Cost    As every gain schedule.
Fails   Design error if C P_pred C' + R_v is singular, or if P_pred grows beyond 1e100: alpha times the magnitude of an
        eigenvalue of A exceeds 1 for an unobservable mode.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

from annotated_types import Ge
from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter, riccati_schedule
from rmpc_bench.types import Array, Model

EQUATION = r"L_k = P_{k|k-1} C^\top (C P_{k|k-1} C^\top + R_v)^{-1}, \quad P_{k+1|k} = \alpha^2 A P_{k|k} A^\top + Q_w"
Alpha: TypeAlias = Annotated[float, Ge(1)]


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    alpha: Alpha,
    form: Form = "filter",
    use_y0: bool = True,
) -> GainScheduleFilter:
    """Kalman filter whose prediction covariance is alpha^2 A P A' + Q_w.

    Parameters
    ----------
    model : design model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    alpha : factor by which the standard deviations of the estimate grow per step
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    use_y0 : `false` starts from x0 and P0 as the estimate at k = 0 and does not use y(0)

    Raises
    ------
    DesignError
        If an innovation covariance is singular or P_pred exceeds 1e100.
    """
    return riccati_schedule(model, n_steps, x0, P0, form=form, use_y0=use_y0, growth=alpha**2)
