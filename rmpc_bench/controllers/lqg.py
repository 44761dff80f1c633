"""Linear-quadratic control of the estimate with integrals of the control error: follows a reference without offset.

Model   The design model without noise is augmented by the sums q of the control errors,
            x(k+1) = A x(k) + B u(k) + f,   q(k+1) = q(k) + y(k) - r(k),  y = C x + D u,
        and, with x_s and u_s the steady state of the model with y = r, the law is
            u = u_s - K_x (x_hat - x_s) - K_q (q - q_s(r)).
        [K_x, K_q] minimises the sum over all k of x' Q_x x + q' Q_i q + u' R_u u of the augmented model (the stationary
        Riccati equation); x, u and q stand for deviations from the steady state. f has the constant part of the model,
        a reported mean of the process noise (`w_mean`) and estimated disturbances, which change x_s and u_s only.  Of
        several steady states with y = r, the one with the least u' R_u u is taken.  `feedforward` selects what a step
        of the reference does at once.  K_q q_s(r) does not change the final value.
            optimal  q_s(r) = - S x_s(r), the q with the least remaining cost after a step of the reference at rest:
                     S = P_qq^-1 P_qx of the solution P of the Riccati equation.
            target   q_s = 0.  The sum of all errors then ends at 0 on an exact model, so every step overshoots.
            none     x_s and u_s do not depend on r: only the integrals bring y to r.
        The input is clipped to `limits`, and then to the bounds of the plant.  Where the result u differs from the
        input v of the law, `anti_windup` selects q(k+1):
            clamping          an error is not summed where it drives an input further beyond its limit,
            back-calculation  q is corrected by (Ts / Tt) K_q^+ (v - u), with the pseudo-inverse K_q^+,
            none              q has no correction.
        The error of an output whose measurement is missing (NaN) is not summed.
Source  Integral action: Kwakernaak and Sivan, Linear Optimal Control Systems (1972); textbook.
Limit   Q_i -> 0, and Q_i: 0 exactly, is `lqr` with a long horizon, for the deviation from the steady state.
Cost    Three small matrix-vector products per run and step.
Fails   Design error: not every reference has a steady state (more outputs than inputs, or a zero at 1), a weight is not
        admissible, or the Riccati equation has no stabilising solution.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.limits import AntiWindup, InputLimits, bounds_of
from rmpc_bench.controllers.lqg_law import Lqg
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import as_covariance, as_positive
from rmpc_bench.numerics.lq_tracking import IntegralGain, integral_gain, steady_map, steady_rank
from rmpc_bench.types import Array, DesignError, Estimator, Matrix, Model, Positive

EQUATION = r"""u_k = u_s - K_x (\hat x_k - x_s) - K_q (q_k - q_s), \quad
q_{k+1} = q_k + y_k - r_k, \quad \min_u \sum_{k=0}^{\infty} x_k^\top Q_x x_k + q_k^\top Q_i q_k + u_k^\top R_u u_k"""
Feedforward: TypeAlias = Literal["optimal", "target", "none"]


def design(
    model: Model,
    Ts: float,
    estimator: Estimator,
    *,
    R_u: Matrix,
    Q_i: Matrix,
    Q_x: Matrix | None = None,
    Q_y: Matrix | None = None,
    outputs: list[int] | None = None,
    on: Literal["y", "estimate"] = "y",
    feedforward: Feedforward = "optimal",
    limits: InputLimits | None = None,
    anti_windup: AntiWindup = "clamping",
    Tt: Positive | None = None,
) -> Lqg:
    """Linear-quadratic-Gaussian control (LQG) with integral action: integrals of the control error.

    Parameters
    ----------
    model : design model, the same at all k
    Ts : sampling time [s]
    estimator : estimator of the method; the steady state uses the mean of the process noise if it estimates one
    R_u : weight of the input, positive definite
    Q_i : weight of the sums of the control errors; positive definite, or 0 for no integrals
    Q_x : weight of the state without disturbances; exactly one of `Q_x` and `Q_y` is given
    Q_y : weight of the output y = C x in place of that of the state
    outputs : outputs that follow the reference, counted from 0, at most as many as inputs (default: all)
    on : `y` sums the errors of the measured output, `estimate` those of C x_hat + d0, with the offset of the estimate
    feedforward : what a step of the reference does at once
    limits : bounds of the input, `{u: [low, high]}` or one pair per input
    anti_windup : treatment of the sums while a limit acts
    Tt : tracking time of the back-calculation [s], at least Ts (default: Ts)

    Raises
    ------
    DesignError
        If a weight is not admissible, the limits do not fit, not every reference has a steady state, or there is no
        stabilising gain.
    """
    if model.varies:
        raise DesignError("needs a design model that does not depend on k; use lqr, or another model")
    constant: LinearModel = model.at(0)
    rows = np.eye(model.ny)[_tracked(outputs, model.ny)]
    R = as_positive(R_u, model.nu, "R_u")
    n = constant.nx - model.n_disturbances
    Q, sums = _weight_of_states(Q_x, Q_y, constant.C[:, :n]), _weight_of_sums(Q_i, len(rows))
    if Q_y is not None:
        model.refuse_feedthrough("`Q_y`")
    if Tt is not None and anti_windup != "back-calculation":
        raise DesignError("has no effect without `anti_windup: back-calculation`", "Tt")
    if Tt is not None and Tt < Ts:
        raise DesignError(f"must be at least the sampling time {Ts:g} (got {Tt:g})", "Tt")
    if feedforward == "none" and not len(sums):
        raise DesignError(
            "does not use the reference with Q_i = 0; choose Q_i > 0 or another feedforward", "feedforward"
        )
    A, B, C, D = constant.A[:n, :n], constant.B[:n], rows @ constant.C[:, :n], rows @ constant.D
    _refuse_rank(A, B, C, D)
    gain = _gain(A, B, C[: len(sums)], D[: len(sums)], Q, sums, R)
    T = steady_map(A, B, C, R, D)
    # Of [f; z]: the input that holds the state, and keeps x_hat at x_s.
    held = T[n:] + gain.K_x @ T[:n]
    # Disturbances d are the last states: f = A[:n, n:] d and z = r - C[:, n:] d.
    K_x = np.hstack([gain.K_x, -held @ np.vstack([constant.A[:n, n:], -rows @ constant.C[:, n:]])])
    free = model.deviation
    return Lqg(
        K_x,
        gain.K_q,
        _reference_gain(feedforward, held[:, n:], gain, T[:n, n:]),
        held @ np.concatenate([free.f0[:n], -(rows @ free.d0)]),
        -held[:, :n] @ np.eye(n, constant.nx) if estimator.estimates_mean else None,
        rows,
        bounds_of(None if limits is None else limits.u, model.nu, "limits.u"),
        anti_windup,
        (1.0 if Tt is None else Ts / Tt) * np.linalg.pinv(gain.K_q),
        None if on == "y" else constant.C,
        None if on == "y" else constant.d0,
        model.operating_point,
    )


def _tracked(outputs: list[int] | None, ny: int) -> list[int]:
    """Return the outputs that follow the reference."""
    if outputs is None:
        return list(range(ny))
    if not outputs or len(set(outputs)) != len(outputs) or not all(0 <= each < ny for each in outputs):
        raise DesignError(f"must be different numbers from 0 to {ny - 1} (got {outputs})", "outputs")
    return outputs


def _weight_of_states(Q_x: Matrix | None, Q_y: Matrix | None, C: Float[Array, "ny nx"]) -> Float[Array, "nx nx"]:
    """Return the weight of the state, which one of two keys gives."""
    if Q_x is not None and Q_y is not None:
        raise DesignError("is given beside `Q_x`; choose one of the two", "Q_y")
    if Q_y is not None:
        weighed: Array = C.T @ as_covariance(Q_y, len(C), "Q_y") @ C
        return weighed
    if Q_x is None:
        raise DesignError("needs a weight: `Q_x` of the state or `Q_y` of the output", "Q_x")
    return as_covariance(Q_x, C.shape[1], "Q_x")


def _weight_of_sums(Q_i: Matrix, n: int) -> Float[Array, "nq nq"]:
    """Return the weight of the sums, of size 0 where it is 0."""
    weight = as_covariance(Q_i, n, "Q_i")
    if not weight.any():
        return np.zeros((0, 0))
    if np.linalg.eigvalsh(weight)[0] <= 0.0:
        raise DesignError("must be positive definite, or 0 for no integrals", "Q_i")
    return weight


def _refuse_rank(A: Array, B: Array, C: Array, D: Array) -> None:
    """Raise a DesignError if not every value of the tracked outputs has a steady state."""
    found, needed = steady_rank(A, B, C, D)
    if found < needed:
        raise DesignError(
            f"not every reference has a steady state: rank [A - I, B; C, D] is {found} and must be {needed} (more "
            "outputs than inputs, or a zero at 1); choose fewer by `outputs`",
            "outputs",
        )


def _gain(A: Array, B: Array, C: Array, D: Array, Q: Array, sums: Array, R: Array) -> IntegralGain:
    """Return the stationary gain."""
    try:
        return integral_gain(A, B, C, Q, sums, R, D)
    except np.linalg.LinAlgError as error:
        reason = "no stabilising gain: an unstable mode is not controllable, or a mode at 1 has no weight"
        raise DesignError(f"{reason} ({error})", "R_u") from None


def _reference_gain(
    feedforward: Feedforward, held: Float[Array, "nu nz"], gain: IntegralGain, x_s: Float[Array, "nx nz"]
) -> Float[Array, "nu nz"]:
    """Return K_r of u = .. + K_r r, which contains the shift of the sums."""
    if feedforward == "none":
        return np.zeros_like(held)
    if feedforward == "target" or gain.K_q.shape[1] == 0:
        return held
    nx = len(x_s)
    S = np.linalg.solve(gain.P[nx:, nx:], gain.P[nx:, :nx])
    shifted: Array = held - gain.K_q @ S @ x_s  # - K_q (q + S x_s)
    return shifted
