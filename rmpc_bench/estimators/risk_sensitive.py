"""Risk-sensitive filter: the robust Kalman filter with a constant multiplier.

Model   As in robust_kalman.py, but the divergence is a penalty of weight 1/theta instead of a constraint.
        V, theta, P_pred, P and rho are defined there.
Source  zenere2018, Theorem 2, (17), (18); tau = 1 is (19), V = F exp(theta F'F) F' with P_pred = F F'.
Assumed theta as in (18), which follows from (17) with twice the divergence (10); (17) as printed gives V with 2 theta.
Limit   theta -> 0 gives the Kalman filter.  theta = steady multiplier of the robust filter gives its steady gains.
Missing A run with gaps has its own V from then on, with the same theta.  Where V is undefined in a gap, V = P_pred.
Cost    As every gain schedule; theta_from runs the robust filter until it is steady.
Fails   Design error at the first step with theta * (1 - tau) * lambda_max(P_pred) >= 1, where V is undefined
        (Remark 2), or where V overflows (possible for all tau).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from jaxtyping import Float

from rmpc_bench.estimators.gain_schedule import Form, GainScheduleFilter, riccati_schedule
from rmpc_bench.numerics.divergence import Inflation, Interpretation, Tau, inflate, inflate_to_radius, right_side
from rmpc_bench.numerics.riccati import filter_step
from rmpc_bench.numerics.square_root import root_of
from rmpc_bench.types import Array, DesignError, Model, Positive

EQUATION = r"""L_k = V_k C^\top (C V_k C^\top + R_v)^{-1}, \quad
V_k = (P_{k|k-1}^{-1} - \theta_k I)^{-1}, \quad \theta_k = \theta"""


# Relative change of theta per step that counts as rounding, which grows with c.
_STEADY = 1e-13
_MAX_STEPS = 100_000


@dataclass(frozen=True)
class Radius:
    """Radius of the robust filter whose steady multiplier is used as theta.

    Parameters
    ----------
    c : radius of the ball
    kl : `printed` is (16) as printed, `half` has the factor 1/2 of the divergence (10)
    """

    c: Positive
    kl: Interpretation = "printed"


def design(
    model: Model,
    n_steps: int,
    *,
    x0: Float[Array, " nx"],
    P0: Float[Array, "nx nx"],
    theta: Positive | None = None,
    theta_from: Radius | None = None,
    tau: Tau = 0.0,
    form: Form = "filter",
) -> GainScheduleFilter:
    """Risk-sensitive filter; give either theta or theta_from.

    Parameters
    ----------
    model : nominal model
    n_steps : number of control periods N; gains are computed for k = 0..N
    x0 : (nx,) mean of the initial state
    P0 : (nx, nx) covariance of the initial state
    theta : risk sensitivity [1 / unit of P_pred]
    theta_from : `{c: 0.1}` uses the steady theta of the robust Kalman filter with radius c, interpretation kl and tau
    tau : divergence of the penalty: 0 is the Kullback-Leibler divergence, (18); 1 is that of (19), defined for any P
    form : `filter` uses y(k) for x_hat(k), `predictor` does not

    Raises
    ------
    DesignError
        If both or neither of theta and theta_from are given, or V is undefined or overflows at some step.
    """
    if (theta is None) == (theta_from is None):
        raise DesignError("give either theta or theta_from: {c: ...}")
    chosen = theta
    if theta_from is not None:
        chosen = steady_theta(model, P0, right_side(theta_from.c, theta_from.kl), tau)
    assert chosen is not None

    return riccati_schedule(model, n_steps, x0, P0, partial(_penalised, theta=chosen, tau=tau), form)


def _penalised(k: int, root: Array, theta: float, tau: float) -> Inflation:
    """A module function, since workers get it by pickle."""
    try:
        return inflate(root, theta, tau)  # (18), first line, or (19)
    except ValueError as error:
        raise DesignError(
            f"V is undefined from step k = {k} on: {error} (theta = {theta:.9g}); "
            "choose a smaller theta or a smaller initial P"
        ) from None


def steady_theta(model: Model, P0: Float[Array, "nx nx"], c: float, tau: float = 0.0) -> float:
    """Return the steady multiplier of the robust Kalman filter, for the model at k = 0 and right side ``c`` of (16)."""
    now, root, last, quiet = model.at(0), root_of(P0), 0.0, 0
    for _ in range(_MAX_STEPS):
        V_root, theta = inflate_to_radius(root, c, tau)  # (13), (16)
        root = filter_step(now.A, now.C, now.Q_w, now.R_v, V_root).root_next  # (14), (15)
        quiet = quiet + 1 if abs(theta - last) <= _STEADY * max(1.0, c) * theta else 0
        # A single small change may be an extremum of theta over k.
        if quiet == 10:
            return theta
        last = theta
    raise DesignError(f"the robust filter with c = {c:g} has no steady theta after {_MAX_STEPS} steps; give theta")
