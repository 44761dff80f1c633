"""Model predictive control: a linear law computed once, and quadratic programs where limits are constraints.

Model   Minimise  sum_{j=1..Hp} |y(k+j) - r(k+j)|^2_Q + sum_{j=0..Hu-1} |du(k+j)|^2_R  over the input increments
        du(k+j) = u(k+j) - u(k+j-1), du = 0 after Hu.  Predictions start at x_hat(k); the reference is known in advance.
        Law: u(k) = u(k-1) - K_u u(k-1) + K_r [r(k+1); ..; r(k+Hp)] - K_x x_hat(k), u(k-1) the applied input.
        u(-1) is the input u_op of the operating point of the model, 0 without one.
        A model that varies with k has gains for every k, and stays as it is beyond its last k.  With constant parts f0
        and d0 of the model, or an estimated mean d_hat of the process noise (`w_mean`), u(k) has the further terms -
        u_0 - K_d d_hat(k).
Limits  `u` is the input saturation, `du` the rate limit of the actuator (slew rate), as a change per call.
        `enforce: clip` clips the increment of that input, then the input.  `enforce: qp` adds the constraints
            u_low <= u(k+j) <= u_high,  du_low <= du(k+j) <= du_high                     for j = 0..Hu-1
            z_low - eps <= z(k+j) <= z_high + eps,  eps >= 0                             for j = 1..steps, `soft`
        and, for every slack, linear eps / scale + quadratic / 2 (eps / scale)^2 to the cost.  Where no limit acts, the
        law is the linear one.
Source  zenere2018, cost (2).  The printed solution (4) minimises |u|^2 instead of |du|^2: `law: printed`.
Assumed `law: increment`, because the text states (2).  `law: printed` holds the input after Hu, as (2) does, so that
        the last block column of Theta is a step response; its printed entry C A^(Hp-Hu-1) B agrees with no
        interpretation.  The printed law does not depend on u(k-1): K_u = I. `law: printed` weighs u - u_op.  `Q`, `R`
        weigh the scaled signals y / scale.y and u / scale.u.
Limit   R -> 0 with Hp = Hu = 1 and CB square: y(k+1) = r(k+1) exactly, with either law.  `enforce: qp` with limits that
        never act is the linear law.
Cost    Three small matrix-vector products per run and step; with `enforce: qp` about 1 us, and 10 us where limits act.
Fails   Design error if the moves are not determined (R = 0 and an input without effect).  With `enforce: qp` a step for
        which no moves satisfy the hard limits, or for which the solver fails, applies `fallback` and is counted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.constrained import ConstrainedMoves, Rows
from rmpc_bench.controllers.limits import (
    Bounds,
    Limits,
    SoftLimit,
    SoftRows,
    bounds_of,
    key_of,
    one_for_all,
    refuse_unused,
    require_effect,
    soft_rows,
)
from rmpc_bench.controllers.mpc_law import ConstrainedMpc, Mpc, VaryingMpc
from rmpc_bench.controllers.prediction import of_inputs, of_moves
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import as_covariance, as_vector, psd_sqrt
from rmpc_bench.numerics.tracking import Problem, Stage
from rmpc_bench.types import Array, DesignError, Estimator, Horizon, Matrix, Model, PlantInfo, Positive

EQUATION = r"""\min \sum_{j=1}^{H_p} \Vert \hat y_{k+j} -
r_{k+j} \Vert_Q^2 + \sum_{j=0}^{H_u - 1} \Vert \Delta u_{k+j} \Vert_R^2"""
DIGITS = 1e-9
"""Largest relative rounding of a predicted signal."""


def increment_program(
    model: LinearModel,
    problem: Problem,
    stages: Sequence[Stage],
    bounds: tuple[Bounds, Bounds],
    scale: Float[Array, " nu"],
    soft: Mapping[str, SoftRows],
) -> ConstrainedMoves:
    """Return the program with bounds of the input and of its increment, whose unit is `scale`, and soft limits.

    The moves are [du(k); ..; du(k+Hu-1)], the parameters p = [x_hat; u(k-1); d_hat] of every run, d_hat only with an
    estimated mean of the process noise, and [r(k+1); ..; r(k+Hp); 1], which all runs share.  Moves, inputs and limited
    signals are functions of p and of the unknowns V of tracking.py: those of the closed loop without limits, in which
    V = 0, so that an unstable plant leaves no powers of A in the first Hu samples.
    """
    Hu, nx, nu, n_own = problem.moves, model.nx, model.nu, len(problem.A)
    known = n_own + problem.N * model.ny + 1
    U, X = problem.responses(stages)
    for each in (U, X):  # The desired outputs are r - d0.
        of_w = each[:, :, n_own : known - 1].reshape(*each.shape[:2], problem.N, model.ny)
        each[:, :, known - 1] -= np.einsum("jiny,y->ji", of_w, model.d0)
    parts = [
        _rows(answer, known, *(np.tile(each, Hu) for each in (*bound, scale)))
        for answer, bound in zip((X[:Hu, nx : nx + nu], U), bounds, strict=True)
    ]
    for name, limit in soft.items():
        (Z, constant), steps = limit.signal, limit.steps
        z = np.einsum("im,jmn->jin", Z, X[:steps, :nx])
        z[:, :, known - 1] += constant
        _refuse_lost_digits(name, problem, Z, X[Hu - 1], z)
        row = _rows(z, known, *(np.tile(each, steps) for each in (*limit.bounds, limit.scale)))
        every = np.ones(len(row.A))
        parts.append(row._replace(soft=every > 0.0, linear=limit.linear * every, quadratic=limit.quadratic * every))
    moves = U.reshape(Hu * nu, -1)
    return ConstrainedMoves(moves[:, :known], moves[:, known:], Rows.stacked(parts), n_own)


def _rows(answer: Float[Array, "samples n columns"], known: int, low: Array, high: Array, unit: Array) -> Rows:
    """Return rows of parameters and unknowns as hard limits."""
    rows = answer.reshape(len(unit), -1)
    return Rows.hard(rows[:, known:], rows[:, :known], low, high, unit)


def _refuse_lost_digits(name: str, problem: Problem, Z: Array, x: Array, z: Float[Array, "steps nz columns"]) -> None:
    """Raise a DesignError where what the constant input after Hu makes of the rounding of x hides the signal."""
    grown, lost = np.pad(Z, ((0, 0), (0, len(x) - Z.shape[1]))), np.finfo(float).eps * np.abs(x).max()
    for j in range(problem.moves, len(z)):
        grown = grown @ problem.A
        if not lost * np.abs(grown).max() <= DIGITS * max(np.abs(z[j]).max(), 1.0 / DIGITS * np.finfo(float).tiny):
            raise DesignError(
                f"cannot be predicted over {j + 1} samples: the design model is unstable and the input constant after "
                f"Hu = {problem.moves}, so that rounding errors grow; use at most {j} steps, or a larger Hu",
                f"{key_of('soft', name)}.steps",
            )


@dataclass(frozen=True)
class Scale:
    """Scales that make the weighted signals dimensionless.

    Parameters
    ----------
    u : scale of the input
    y : scale of the output
    """

    u: Positive | list[Positive] = 1.0
    y: Positive | list[Positive] = 1.0


def design(
    model: Model,
    estimator: Estimator | None = None,
    plant_info: PlantInfo | None = None,
    n_steps: int = 0,
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
    model : prediction model; the nominal part of an uncertain model; one that varies with k needs `enforce: clip` and
        `law: increment`
    estimator : estimator of the method; the predictions use the mean of the process noise if it estimates one
    plant_info : names of the states and outputs, which soft limits may use
    n_steps : number of control periods, for a model that varies with k
    Hp : length of the prediction horizon [samples]
    Hu : control horizon [samples], at most Hp
    Q : weight of the scaled output error
    R : weight of the scaled input increment (of the scaled input for `law: printed`)
    scale : divisors `u` and `y` of the signals in the cost
    limits : bounds of the input and of its increment
    soft : limits of predicted signals, measured or not, which may be exceeded at a cost; they need `enforce: qp`
    law : `increment` minimises (2); `printed` is (4), which weighs the inputs

    Raises
    ------
    DesignError
        If Hu > Hp, a weight is not positive semidefinite, the bounds are in the wrong order, the cost does not
        determine the moves, a soft limit names no signal of the design model, or constraints are combined with
        `law: printed`.
    """
    if Hu > Hp:
        raise DesignError(f"must be at most Hp = {Hp} (got {Hu})", "Hu")
    models = _models(model, n_steps, Hp)
    model = models[0]
    require_effect(model.B)
    if len(models) > 1 or law == "printed":
        model.refuse_feedthrough("a model that varies with k, or `law: printed`,")
    if limits is not None or soft:
        refuse_unused(limits or Limits(), soft)
    limits = Limits() if limits is None else limits
    if limits.enforce == "qp" and law == "printed":
        raise DesignError("qp needs `law: increment`: the printed law does not depend on u(k-1)", "limits.enforce")
    u, du = bounds_of(limits.u, model.nu, "limits.u"), bounds_of(limits.du, model.nu, "limits.du")
    root_Q = _scaled_root(Q, scale.y, model.ny, ("Q", "scale.y"))
    root_R = _scaled_root(R, scale.u, model.nu, ("R", "scale.u"))
    uses_mean = estimator is not None and estimator.estimates_mean
    bounds, printed = (u, None if limits.du is None else du), law == "printed"
    if len(models) > 1:
        if limits.enforce == "qp" or printed:
            raise DesignError("qp and `law: printed` need a constant prediction model; this model varies with k")
        ahead = [models[k : k + Hp + 1] for k in range(n_steps)]
        problems = [of_moves(each, root_Q, root_R, Hp, Hu, uses_mean=uses_mean) for each in ahead]
        laws = [_law(*each, bounds)[0] for each in zip(problems, ahead, strict=True)]
        return VaryingMpc(**vars(laws[0]), laws=laws)
    problem = (of_inputs if printed else of_moves)(models, root_Q, root_R, Hp, Hu, uses_mean=uses_mean)
    made, stages = _law(problem, models, bounds, printed=printed)
    if limits.enforce == "clip":
        return made
    rows = soft_rows(soft or {}, model, Hp, plant_info)
    program = increment_program(model, problem, stages, (u, du), as_vector(scale.u, model.nu), rows)
    return ConstrainedMpc(**vars(made), program=program, fallback=limits.fallback)


def _law(
    problem: Problem, models: Sequence[LinearModel], bounds: tuple[Bounds, Bounds | None], *, printed: bool = False
) -> tuple[Mpc, list[Stage]]:
    """Return the law that clips, and all moves; the models are those of k..k+Hp, or a constant one."""
    model, (nx, nu) = models[0], models[0].B.shape
    try:
        stages, _ = problem.stages()
    except ValueError as error:
        raise DesignError(_undetermined(str(error), problem.Q_u, problem.N, problem.moves), "R") from None
    K, K_r = stages[0].K_x, stages[0].K_w[:, :-1]
    d0 = np.concatenate([each.d0 for each in models[1:]] or [model.d0] * problem.N)
    u_0 = K_r @ d0 - stages[0].K_w[:, -1] - printed * model.u_op
    low, high = one_for_all(bounds[0])
    made = Mpc(
        K[:, :nx],
        np.eye(nu) if printed else K[:, nx : nx + nu],
        K_r,
        low,
        high,
        preview=problem.N + 1,
        K_d=K[:, nx + nu :] if K.shape[1] > nx + nu else None,
        u_0=u_0 if u_0.any() else None,
        u_op=None if model.operating_point is None else model.u_op,
        du=bounds[1],
    )
    return made, stages


def _models(model: Model, n_steps: int, Hp: int) -> list[LinearModel]:
    """Return the models of k = 0..n_steps-1+Hp, or a constant one; the nominal part of an uncertain model."""
    if isinstance(model, LinearModel):
        return [model]
    # A state-dependent model raises a DesignError here.
    found: list[LinearModel] = [model.at(0)]
    for k in range(1, n_steps + Hp if model.varies else 1):
        try:
            found.append(model.at(k))
        except DesignError:
            if k < n_steps:
                raise
            found.append(found[-1])
    return found


def _scaled_root(weight: Matrix, span: float | list[float], n: int, names: tuple[str, str]) -> Float[Array, "n n"]:
    """Return the root of a weight divided by the scale of its signal; ``names`` are the keys for error messages."""
    return psd_sqrt(as_covariance(weight, n, names[0])) / as_vector(span, n, names[1])


def _undetermined(error: str, root_R: Array, Hp: int, Hu: int) -> str:
    """Return the message for moves that the cost does not determine, with its cause."""
    if np.linalg.matrix_rank(root_R) < len(root_R):
        return (
            f"{error}: R is singular, and the outputs within Hp = {Hp} do not determine Hu = {Hu} moves; choose R > 0"
        )
    return f"{error}: R is lost beside the effect of the inputs within Hp = {Hp}; choose a larger R or Hu"
