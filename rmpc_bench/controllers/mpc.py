"""Model predictive control: a linear law computed once, and quadratic programs where limits are constraints.

This file checks the keys and computes the gains. The laws are in mpc_law.py, their limits in limits.py, increments.py
and constrained.py.

Model   Minimise  sum_{j=1..Hp} |y(k+j) - r(k+j)|^2_Q + sum_{j=0..Hu-1} |du(k+j)|^2_R  over the input increments
        du(k+j) = u(k+j) - u(k+j-1), du = 0 after Hu.  Predictions start at x_hat(k); the reference is known in advance.
        Law: u(k) = u(k-1) - K_u u(k-1) + K_r [r(k+1); ..; r(k+Hp)] - K_x x_hat(k), u(k-1) the applied input.
        u(-1) is the input u_op of the operating point of the model, 0 without one.
        With constant parts f0 and d0 of the model, or an estimated mean d_hat of the process noise (`w_mean` of the
        estimate), the predictions include them and u(k) has the further terms - u_0 - K_d d_hat(k).
Limits  `enforce: clip` clips the increment of that input, then the input.  `enforce: qp` adds the constraints
            u_low <= u(k+j) <= u_high,  du_low <= du(k+j) <= du_high                     for j = 0..Hu-1
            z_low - eps <= z(k+j) <= z_high + eps,  eps >= 0                             for j = 1..steps, `soft`
        and, for every slack, linear eps / scale + quadratic / 2 (eps / scale)^2 to the cost.  Runs for which no limit
        acts have the input of the linear law.
Source  zenere2018, cost (2).  The printed solution (4) minimises |u|^2 instead of |du|^2: `law: printed`.
Assumed `law: increment`, because the text states (2).  `law: printed` holds the input after Hu, as (2) does (du = 0),
        so that the last block column of Theta is a step response; the printed entry C A^(Hp-Hu-1) B of that column
        agrees with no interpretation.  The printed law does not depend on u(k-1): K_u = I.
        `law: printed` weighs u - u_op.
        `Q`, `R` weigh the scaled signals y / scale.y and u / scale.u.
Limit   R -> 0 with Hp = Hu = 1 and CB square: y(k+1) = r(k+1) exactly, with either law.  `enforce: qp` with limits that
        never act is the linear law.
Cost    Three small matrix-vector products per run and step; with `enforce: qp` about 1 us, and 10 us where limits act.
Fails   Design error if the moves are not determined (R = 0 and an input without effect).  With `enforce: qp` a step for
        which no moves satisfy the hard limits, or for which the solver fails, applies `fallback` and is counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.increments import IncrementCost, increment_program
from rmpc_bench.controllers.limits import Limits, SoftLimit, bounds_of, one_for_all, refuse_unused, soft_rows
from rmpc_bench.controllers.mpc_law import ConstrainedMpc, Mpc
from rmpc_bench.controllers.prediction import predict_disturbance, predict_inputs, predict_moves
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import as_covariance, as_vector, psd_sqrt
from rmpc_bench.types import Array, DesignError, Estimator, Horizon, Matrix, Model, PlantInfo, Positive


@dataclass(frozen=True)
class Scale:
    """Scales that make the weighted signals dimensionless.

    Parameters
    ----------
    u : scale of the input, a number or one per input
    y : scale of the output, a number or one per output
    """

    u: Positive | list[Positive] = 1.0
    y: Positive | list[Positive] = 1.0


def design(
    model: Model,
    estimator: Estimator | None = None,
    plant_info: PlantInfo | None = None,
    *,
    Hp: Horizon,
    Hu: Horizon,
    Q: Matrix,
    R: Matrix,
    scale: Scale = Scale(),  # noqa: B008 - frozen, so it cannot be shared by mistake
    limits: Limits | None = None,
    soft: dict[str, SoftLimit] | None = None,
    law: Literal["increment", "printed"] = "increment",
) -> Mpc:
    """Model predictive controller: in closed form, or with its limits as constraints of the optimisation.

    Parameters
    ----------
    model : prediction model; the nominal part of an uncertain model
    estimator : estimator of the method; the predictions use the mean of the process noise if it estimates one
    plant_info : names of the states and outputs, which soft limits may use
    Hp : prediction horizon [samples]
    Hu : control horizon [samples], at most Hp
    Q : weight of the scaled output error: a number, a diagonal or a matrix
    R : weight of the scaled input increment (of the scaled input for `law: printed`): a number, a diagonal or a matrix
    scale : divisors `u` and `y` of the signals in the cost
    limits : bounds of the input and of its increment, `{u: [low, high], du: [low, high], enforce: clip}`; with
        `enforce: qp` they are constraints of the optimisation
    soft : limits of predicted signals of the design model, measured or not, which may be exceeded at a cost; they need
        `enforce: qp`
    law : `increment` minimises (2); `printed` is (4), which weighs the inputs; both hold the input after Hu

    Raises
    ------
    DesignError
        If Hu > Hp, a weight is not positive semidefinite, the bounds are in the wrong order, the cost does not
        determine the moves, a soft limit names no signal of the design model, or constraints are combined with
        `law: printed`.
    """
    if Hu > Hp:
        raise DesignError(f"must be at most Hp = {Hp} (got {Hu})", "Hu")
    model = _constant(model)
    if limits is not None or soft:
        refuse_unused(limits or Limits(), soft)
    limits = Limits() if limits is None else limits
    if limits.enforce == "qp" and law == "printed":
        raise DesignError("qp needs `law: increment`: the printed law does not depend on u(k-1)", "limits.enforce")
    u, du = bounds_of(limits.u, model.nu, "limits.u"), bounds_of(limits.du, model.nu, "limits.du")
    root_Q = np.kron(np.eye(Hp), _scaled_root(Q, scale.y, model.ny, ("Q", "scale.y")))
    root_R = np.kron(np.eye(Hu), _scaled_root(R, scale.u, model.nu, ("R", "scale.u")))
    first = (_first_printed if law == "printed" else _first_increment)(model, root_Q, root_R)
    K_x, K_u, K_r = first.move @ first.Psi, first.K_u, first.move
    Phi, constant = predict_disturbance(model, Hp)
    uses_mean = estimator is not None and estimator.estimates_mean
    u_0 = first.move @ constant + first.u_0 if constant.any() or first.u_0.any() else None
    law_of_u: dict[str, Any] = {
        "preview": Hp + 1,
        "K_d": first.move @ Phi if uses_mean else None,
        "u_0": u_0,
        "u_op": None if model.operating_point is None else model.u_op,
        "du": None if limits.du is None else du,
    }
    if limits.enforce == "clip":
        return Mpc(K_x, K_u, K_r, *one_for_all(u), **law_of_u)
    rows = soft_rows(soft or {}, model, Hp, plant_info)
    cost = IncrementCost(Hp, Hu, root_Q, root_R, first.moves @ root_Q, as_vector(scale.u, model.nu))
    program = increment_program(model, cost, u, du, rows, uses_mean=uses_mean)
    return ConstrainedMpc(K_x, K_u, K_r, *one_for_all(u), **law_of_u, program=program, fallback=limits.fallback)


class FirstMove(NamedTuple):
    """How the first move follows from what the predictions lack: move (r - Psi x) - K_u u(k-1) - u_0."""

    moves: Float[Array, "all_moves outputs"]
    """All moves of the horizon for errors times root_Q."""
    move: Float[Array, "nu outputs"]
    Psi: Float[Array, "outputs nx"]
    K_u: Float[Array, "nu nu"]
    u_0: Float[Array, " nu"]


def _first_increment(
    model: LinearModel, root_Q: Float[Array, "outputs outputs"], root_R: Float[Array, "all_moves all_moves"]
) -> FirstMove:
    """Return the first increment of the minimiser of (2)."""
    Psi, Upsilon, Theta = predict_moves(model, len(root_Q) // model.ny, len(root_R) // model.nu)
    moves = _moves(root_Q @ Theta, root_R)
    move = moves[: model.nu] @ root_Q
    return FirstMove(moves, move, Psi, move @ Upsilon, np.zeros(model.nu))


def _first_printed(
    model: LinearModel, root_Q: Float[Array, "outputs outputs"], root_R: Float[Array, "all_moves all_moves"]
) -> FirstMove:
    """Return the first input of the minimiser with |u - u_op|^2 in place of |du|^2, (4)."""
    Hu = len(root_R) // model.nu
    Psi, Theta = predict_inputs(model, len(root_Q) // model.ny, Hu)
    moves = _moves(root_Q @ Theta, root_R)
    move = moves[: model.nu] @ root_Q
    # What u_op held over the horizon adds to the outputs, and u_op itself.
    u_0 = move @ Theta @ np.tile(model.u_op, Hu) - model.u_op
    return FirstMove(moves, move, Psi, np.eye(model.nu), u_0)


def _constant(model: Model) -> LinearModel:
    """Return the constant model; the nominal part of an uncertain model."""
    if isinstance(model, LinearModel):
        return model
    # A state-dependent model raises a DesignError here.
    nominal: LinearModel = model.at(0)
    if model.varies:
        raise DesignError("needs a constant prediction model; this model varies with k")
    return nominal


def _scaled_root(weight: Matrix, span: float | list[float], n: int, names: tuple[str, str]) -> Float[Array, "n n"]:
    """Return the root of a weight divided by the scale of its signal; ``names`` are the keys for error messages."""
    blamed = names[0]
    try:
        root = psd_sqrt(as_covariance(weight, n))
        blamed = names[1]
        return root / as_vector(span, n)
    except ValueError as error:
        raise DesignError(str(error), blamed) from None


def _moves(weighted: Float[Array, "rows moves"], root_R: Float[Array, "moves moves"]) -> Float[Array, "moves rows"]:
    """Return the columns of the pseudo-inverse for b in min |weighted dU - b|^2 + |root_R dU|^2.

    QR factorisation of the stacked matrix, because the normal equations would square its condition number.
    """
    stacked = np.vstack([weighted, root_R])
    orthogonal, upper = np.linalg.qr(stacked)
    pivots = np.abs(np.diag(upper))
    # A smaller pivot is rounding of the factorisation.
    if pivots.min() <= 1e-13 * pivots.max():
        raise DesignError("the cost does not determine the input moves; choose R > 0 or a smaller Hu", "R")
    inverse: Array = np.linalg.solve(upper, orthogonal.T)[:, : len(weighted)]
    return inverse
