"""Kalman and set-membership filter in one: a covariance for the stochastic part of the error, a set for the rest.

Model   x(k+1) = A_k x(k) + B_k u(k) + w,  y(k) = C_k x(k) + v,  every noise a Gaussian one, N(0, P_w) or N(0, P_v),
        plus one in an ellipsoid, E(0, M_w) or E(0, M_v); so is x(0) - x0, with P0 and M0.  Known means count.
        x_hat - x = e_s + e_b: P is the covariance of e_s, E(0, M) contains e_b.
Source  ma2025, Proposition 1, (16)-(24), with M_w at k-1 in (23) and I - L C in (24); L is the paper's Gamma.
Chosen  q of a correction is the fixed point of (22) and (24), which minimises tr P + tr M over gain and weight; the
        paper does not say how it solves the two equations.  Where the best q is 0 or infinite, or M_v nearly singular,
        the minimum is missed by up to 5e-5 of tr P_pred + tr M_pred.  p(k) belongs to the prediction from k to k+1.
Limit   without bounded noises (M = 0) the Kalman filter; without stochastic ones set-membership, not inflated.
Cost    as every gain schedule.
Fails   design error where the innovation is without noise in some direction, also where its values are consistent, as
        for P_v = 0 and M_v of rank 1 with ny > nx + 1.
"""

from __future__ import annotations

from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import GainScheduleFilter, mixed_schedule
from rmpc_bench.models.noise_sets import NoiseSets
from rmpc_bench.numerics.mixed_step import Rule
from rmpc_bench.types import Array, Model


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
    """Filter for stochastic and bounded noises, time varying from P0 and M0 on.

    Parameters
    ----------
    model : what the filter believes; one without sets has no bounded noise
    n_steps : number of control periods N; gains are made for k = 0..N
    x0 : (nx,) centre of the initial state
    P0 : (nx, nx) covariance of the stochastic part of its error
    M0 : (nx, nx) shape of the ellipsoid of the bounded part
    q : `fixed-point` solves (22) and (24) together; `lag` evaluates (24) once, for the weight of the step before;
        `one-pass` once, for the weight 1
    use_y0 : `false` takes x0, P0 and M0 for the estimate at k = 0 itself, as (16)-(18) do, and leaves y(0) out

    Raises
    ------
    DesignError
        If the innovation is without noise at some step, a matrix grows beyond 1e100, or the model's noises are
        correlated.
    """
    return mixed_schedule(model, n_steps, x0, P0, M0, NoiseSets(model), rule=q, use_y0=use_y0)
