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
from rmpc_bench.models.noise_sets import NoiseKind, counted
from rmpc_bench.numerics.kl_ball import Inflation
from rmpc_bench.types import Array


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    M0: Float[Array, "nx nx"] | None = None,
    form: Form = "filter",
    noise: NoiseKind = "nominal",
    use_y0: bool = True,
) -> GainScheduleFilter:
    """Kalman filter, time varying from P0 on.

    Parameters
    ----------
    model : what the filter believes
    n_steps : number of control periods N; gains are made for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) its covariance
    M0 : (nx, nx) shape of the ellipsoid of a bounded part of x(0) - x0, none unless given
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    noise : `nominal` knows the stochastic noises only; `matched` adds the covariance of bounded ones that are uniform
        on their ellipsoids, M / (n + 2)
    use_y0 : `false` takes x0 and P0 for the estimate at k = 0 itself and leaves y(0) out
    """
    believed, P0 = counted(model, P0, M0, noise)
    return riccati_schedule(believed, n_steps, x0, P0, lambda k, P_pred: Inflation(P_pred, 0.0), form, use_y0)
