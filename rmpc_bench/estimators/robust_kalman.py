"""Robust Kalman filter for model errors in a divergence ball around the nominal density.

Model   x(k+1) = A x(k) + B u(k) + w(k),  y(k) = C x(k) + v(k), nominally w ~ N(0, Q_w), v ~ N(0, R_v).  At every step
        the conditional density of (x(k+1), y(k)) given the past may be any density within divergence `c` of the nominal
        one.  V is the covariance of the prediction error under the least favourable density, theta the multiplier of
        the constraint, P_pred the paper's P_t, P the covariance of x_hat - x that follows from V, and rho the spectral
        radius of A - K C.
Source  zenere2018, Theorem 1, (5), (6), (13)-(16); without input Levy and Nikoukhah (2013).  tau > 0 replaces the
        Kullback-Leibler divergence by the tau-divergence; tau = 1 gives V as in (19).
Assumed (16) as printed, although half of its left side is the divergence (10) between Gaussians; see `kl: half`.
Limit   c -> 0 gives the Kalman filter.
Missing A run with gaps has its own V from then on.  Without any output P = V.
Cost    As every gain schedule; the design solves one scalar equation per step.
Fails   Design error if C V C' + R_v is singular.
"""

from __future__ import annotations

from functools import partial

from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter, riccati_schedule
from rmpc_bench.numerics.divergence import Inflation, Interpretation, Tau, inflate_to_radius, right_side
from rmpc_bench.types import Array, Model, Positive

EQUATION = r"""L_k = V_k C^\top (C V_k C^\top + R_v)^{-1}, \quad V_k = (P_{k|k-1}^{-1} - \theta_k I)^{-1}, \quad
\log \det (I - \theta_k P_{k|k-1}) + \mathrm{tr} \left[ (I - \theta_k P_{k|k-1})^{-1} - I \right] = c"""


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
    """Robust Kalman filter for a divergence ball of radius c.

    Parameters
    ----------
    model : nominal model, the centre of the ball
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state; may be singular
    c : radius of the ball, the tolerance of model error per step
    kl : `printed` is (16) as printed; `half` has the factor 1/2 of the divergence (10), which is equivalent to 2 c
    tau : divergence of the ball: 0 is the Kullback-Leibler divergence, 1 is that of (19)
    form : `filter` uses y(k) for x_hat(k), `predictor` does not
    """
    return riccati_schedule(model, n_steps, x0, P0, partial(_worst, c=right_side(c, kl), tau=tau), form)


def _worst(k: int, root: Array, c: float, tau: float) -> Inflation:
    """A module function, since workers get it by pickle."""
    return inflate_to_radius(root, c, tau)  # (13), (16)
