"""Mixed filter: a covariance for the stochastic part of the error and an ellipsoid for the bounded part.

Model   x(k+1) = A_k x(k) + B_k u(k) + w,  y(k) = C_k x(k) + v.  Every noise is the sum of a Gaussian one, N(0, P_w) or
        N(0, P_v), and a noise bounded by an ellipsoid, E(0, M_w) or E(0, M_v), plus a known mean.  x(0) - x0 is such a
        sum with P0 and M0.  x_hat - x = e_s + e_b: P is the covariance of e_s, E(0, M) contains e_b.
Source  ma2025, Proposition 1, (16)-(24), with M_w at k-1 in (23) and I - L C in (24); L is the paper's Gamma.
Assumed The weight q of a correction is the fixed point of (22) and (24), which minimises tr P + tr M over gain and
        weight; the paper does not say how.  If the optimal q is 0 or infinite, or M_v is nearly singular, tr P + tr M
        exceeds its minimum by up to 5e-5 of tr P_pred + tr M_pred. p(k) belongs to the prediction from k to k+1.
Limit   Without bounded noises (M = 0) the Kalman filter; without stochastic noises `set-membership` without `inflate`.
Missing A run with gaps has its own gains, P and M from then on.
Cost    As every gain schedule.
Fails   Design error if the innovation has no noise in some direction, even if its values are always consistent, as for
        P_v = 0 and M_v of rank 1 with ny > nx + 1.
"""

from __future__ import annotations

from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, mixed_schedule
from rmpc_bench.models.noise_sets import NoiseSets
from rmpc_bench.numerics.mixed_step import Rule
from rmpc_bench.types import Array, Model

EQUATION = r"""P_{k|k} = T P_{k|k-1} T^\top + L_k P_v L_k^\top, \quad
M_{k|k} = (q_k^{-1} + 1) T M_{k|k-1} T^\top + (q_k + 1) L_k M_v L_k^\top, \quad T = I - L_k C"""


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    M0: Float[Array, "nx nx"],
    q: Rule = "fixed-point",
    use_y0: bool = True,
) -> GainScheduleFilter:
    """Time-varying filter for stochastic and bounded noises.

    Parameters
    ----------
    model : design model; a model without sets has no bounded noise
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) estimate of the initial state before y(0)
    P0 : (nx, nx) covariance of the stochastic part of its error
    M0 : (nx, nx) shape matrix of the ellipsoid of the bounded part of its error
    q : `fixed-point` solves (22) and (24) together; `lag` evaluates (24) once with the weight of the previous step,
        `one-pass` with the weight 1
    use_y0 : `false` starts from x0, P0 and M0 as the estimate at k = 0, as in (16)-(18), and does not use y(0)

    Raises
    ------
    DesignError
        If the innovation has no noise at some step, a matrix exceeds 1e100, or the noises of the model are correlated.
    """
    return mixed_schedule(model, n_steps, x0, P0, M0, NoiseSets(model), rule=q, use_y0=use_y0)
