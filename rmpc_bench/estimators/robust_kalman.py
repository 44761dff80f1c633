"""Robust Kalman filter over a ball of densities.

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k), nominally w ~ N(0, Q_w), v ~ N(0, R_v).  At every step
        nature may choose any density of (x(k+1), y(k)) given the past within divergence `c` of the nominal one.
        V is the covariance of the prediction error under the worst density, theta the multiplier of the constraint,
        P_pred the paper's P_t; P is the covariance of x_hat - x that follows from V; rho is the spectral radius of
        A - K C.
Source  zenere2018, Theorem 1, (5), (6), (13)-(16); without input Levy and Nikoukhah (2013).  With tau > 0 the
        Kullback-Leibler divergence gives way to the tau-divergence; tau = 1 leads to the form of V in (19).
Chosen  (16) as printed, although half of its left side is the divergence (10) between Gaussians: `kl: half`.
Limit   c -> 0 gives the Kalman filter.
Cost    as every gain schedule; the design solves one scalar equation per step.
Fails   design error where C V C' + R_v is singular.
"""

from __future__ import annotations

from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter, riccati_schedule
from rmpc_bench.numerics.kl_ball import Interpretation, Tau, inflate_to_radius, right_side
from rmpc_bench.types import Array, Model, Positive


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    c: Positive,
    kl: Interpretation = "printed",
    tau: Tau = 0.0,
    form: Form = "filter",
) -> GainScheduleFilter:
    """Robust Kalman filter over a ball of radius c.

    Parameters
    ----------
    model : nominal model, the centre of the ball
    n_steps : number of control periods N; gains are made for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) its covariance, singular allowed
    c : radius of the ball: the tolerance for model error, per step
    kl : `printed` is (16) as printed; `half` has the factor 1/2 of the divergence (10), as if c were twice as large
    tau : divergence that the ball is made of: 0 is Kullback and Leibler's, 1 the one of (19)
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    """
    bound = right_side(c, kl)
    return riccati_schedule(
        model,
        n_steps,
        x0,
        P0,
        lambda k, P_pred: inflate_to_radius(P_pred, bound, tau),  # (13), (16)
        form,
    )
