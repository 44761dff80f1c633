"""Robust Kalman filter over a Kullback-Leibler ball.

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k), nominally w ~ N(0, Q_w), v ~ N(0, R_v).  At every step
        nature may choose any density of (x(k+1), y(k)) given the past within divergence `c` of the nominal one.
        V is the covariance of the prediction error under the worst density, theta the multiplier of the constraint,
        P_pred the paper's P_t; P is the covariance of x_hat - x that follows from V.
Source  zenere2018, Theorem 1, (5), (6), (13)-(16); without input Levy and Nikoukhah (2013).
Limit   c -> 0 gives the Kalman filter.
Cost    as every gain schedule; the design solves one scalar equation per step.
Fails   design error where C V C' + R_v is singular.
"""

from __future__ import annotations

from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, riccati_schedule
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.kl_ball import inflate_to_radius
from rmpc_bench.types import Array, Positive


def design(
    model: LinearModel, n_steps: int, *, x0: Float[Array, " nx"], P0: Float[Array, "nx nx"], c: Positive
) -> GainScheduleFilter:
    """Robust Kalman filter over a ball of radius c.

    Parameters
    ----------
    model : nominal model, the centre of the ball
    n_steps : number of control periods N; gains are made for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) its covariance, singular allowed
    c : radius of the Kullback-Leibler ball: the tolerance for model error, per step
    """
    return riccati_schedule(model, n_steps, x0, P0, lambda k, P_pred: inflate_to_radius(P_pred, c))  # (13), (16)
