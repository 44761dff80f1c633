"""Model predictive control: a linear law computed once, and quadratic programs where limits are constraints.

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

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.constrained import ConstrainedMoves, with_fallback
from rmpc_bench.controllers.increments import IncrementCost, increment_program
from rmpc_bench.controllers.limits import (
    Bounds,
    Fallback,
    Limits,
    SoftLimit,
    bounds_of,
    one_for_all,
    refuse_unused,
    soft_rows,
)
from rmpc_bench.controllers.prediction import predict_disturbance, predict_inputs, predict_moves
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import as_covariance, as_vector, mv, psd_sqrt
from rmpc_bench.types import (
    Array,
    Command,
    CompiledLaw,
    Controller,
    DesignError,
    Estimate,
    Estimator,
    Horizon,
    LinearLaw,
    Matrix,
    Model,
    OptimisedStep,
    PlantInfo,
    Positive,
    Status,
)

OK = np.int8(Status.OK)


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


class MpcState(NamedTuple):
    """State of the controller between steps."""

    u_previous: Float[Array, "runs nu"]


@dataclass(frozen=True, eq=False)
class Mpc(Controller):
    """The receding-horizon law; create it with `design`."""

    K_x: Float[Array, "nu nx"]
    K_u: Float[Array, "nu nu"]
    K_r: Float[Array, "nu rows"]
    low: float | Float[Array, " nu"]
    """A number where it is the same for all inputs."""
    high: float | Float[Array, " nu"]
    preview: int
    K_d: Float[Array, "nu nx"] | None = None
    """Gain of the estimated mean of the process noise, None if the estimator does not estimate it."""
    u_0: Float[Array, " nu"] | None = None
    """Input that compensates the constant parts of the model, None if they are zero."""
    u_op: Float[Array, " nu"] | None = None
    """Input before k = 0; None for 0."""
    du: Bounds | None = None
    """Bounds of the increment; None without."""

    @property
    def input_limits(self) -> tuple[float | Float[Array, " nu"], float | Float[Array, " nu"]]:
        """Lower and upper limit of all inputs, or of each."""
        return self.low, self.high

    @property
    def has_compiled_form(self) -> bool:
        """A law that uses an estimated mean, limits the increment or has different limits of its inputs has none."""
        return self.K_d is None and self.du is None and isinstance(self.low, float)

    def compiled_form(self, r: Float[Array, "known ny"], n_steps: int, runs: Sequence[int]) -> CompiledLaw:
        """Return the gains and what the reference adds at every k."""
        ahead = np.array([r[k + 1 : k + self.preview].ravel() for k in range(n_steps)])
        given = mv(self.K_r, ahead)[None]
        u_0 = None if self.u_0 is None else self.u_0[None]
        low, high = float(self.low), float(self.high)
        return CompiledLaw(given, self.K_x[None], self.K_u, u_0, low, high, self.u_op)

    def init(self, n_runs: int) -> MpcState:
        """Start from the input of the operating point, or 0."""
        nu = len(self.K_x)
        return MpcState(np.tile(np.zeros(nu) if self.u_op is None else self.u_op, (n_runs, 1)))

    def control(
        self,
        k: int,
        state: MpcState,
        y: Float[Array, "runs ny"],
        estimate: Estimate,
        r: Float[Array, "preview ny"],
    ) -> tuple[MpcState, Command]:
        """Apply the first input of the minimiser, clipped."""
        u = self._clipped(self._minimiser(state.u_previous, estimate, r), state.u_previous)
        return MpcState(u), Command(u, np.full(len(u), OK), {})

    def _minimiser(
        self, u_previous: Float[Array, "runs nu"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> Float[Array, "runs nu"]:
        """Return the first input of the minimiser without limits."""
        # The reference is the same for all runs.
        ahead = mv(self.K_r, r[1:].reshape(1, -1))
        # Exactly 0 if K_u = I.
        kept = u_previous - mv(self.K_u, u_previous)
        u = kept + ahead - mv(self.K_x, estimate.x_hat)
        if self.u_0 is not None:
            u = u - self.u_0
        if self.K_d is not None:
            u = u - mv(self.K_d, estimate.info["w_mean"])
        return u

    def _clipped(self, u: Float[Array, "runs nu"], u_previous: Float[Array, "runs nu"]) -> Float[Array, "runs nu"]:
        """Clip the increment, then the input."""
        if self.du is not None:
            # An increment within its bounds keeps the bits of u.
            u = np.clip(u, u_previous + self.du.low, u_previous + self.du.high)
        return np.clip(u, self.low, self.high)

    def linear_law(self) -> LinearLaw | None:
        """Return the gains; the law is linear as long as no input is clipped, and affine with constant parts."""
        if self.u_0 is not None or self.K_d is not None:
            return None
        return LinearLaw(self.K_x, self.K_u, self.K_r)


@dataclass(frozen=True, eq=False)
class ConstrainedMpc(Mpc):
    """The law whose limits are constraints of the optimisation; create it with `design`."""

    program: ConstrainedMoves = field(kw_only=True)
    fallback: Fallback | None = field(kw_only=True)

    @property
    def has_compiled_form(self) -> bool:
        """It is not linear."""
        return False

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """How the moves were found: values of `OptimisedStep`."""
        return {"qp": ()}

    @property
    def cost_per_step(self) -> float:
        """Time of a step for which a share of the programs is solved [s]."""
        return 2e-6

    def control(
        self,
        k: int,
        state: MpcState,
        y: Float[Array, "runs ny"],
        estimate: Estimate,
        r: Float[Array, "preview ny"],
    ) -> tuple[MpcState, Command]:
        """Apply the first input of the constrained minimiser."""
        before, nu = state.u_previous, len(self.K_x)
        mean = () if self.K_d is None else (estimate.info["w_mean"],)
        found = self.program.moves(np.hstack([estimate.x_hat, before, *mean]), np.append(r[1:].ravel(), 1.0))
        clipped = self._clipped(self._minimiser(before, estimate, r), before)
        u, solved = clipped, found.steps != OptimisedStep.SKIPPED
        if solved.any():
            # The input of a skipped run has the bits of `enforce: clip`.
            u = np.where(solved[:, None], self._clipped(before + found.V[:, :nu], before), clipped)
        command = with_fallback(u, clipped, before, found.steps, self.fallback)
        return MpcState(command.u), command


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
    root_Q = _scaled_root(Q, scale.y, model.ny, ("Q", "scale.y"))
    root_R = _scaled_root(R, scale.u, model.nu, ("R", "scale.u"))
    root_Q, root_R = np.kron(np.eye(Hp), root_Q), np.kron(np.eye(Hu), root_R)
    if law == "printed":
        Psi, Theta = predict_inputs(model, Hp, Hu)
        first = _moves(root_Q @ Theta, root_R)[: model.nu] @ root_Q  # u(k) = first (r - Psi x), (4)
        K_u = np.eye(model.nu)
        # The minimiser of |u - u_op|^2: what u_op held over the horizon adds to the outputs, and u_op itself.
        weighed = first @ Theta @ np.tile(model.u_op, Hu) - model.u_op
    else:
        Psi, Upsilon, Theta = predict_moves(model, Hp, Hu)
        moves = _moves(root_Q @ Theta, root_R)
        first = moves[: model.nu] @ root_Q  # du(k) = first (r - Psi x - Upsilon u(k-1))
        K_u, weighed = first @ Upsilon, np.zeros(model.nu)
    Phi, constant = predict_disturbance(model, Hp)
    uses_mean = estimator is not None and estimator.estimates_mean
    K_d = first @ Phi if uses_mean else None
    u_0 = first @ constant + weighed if constant.any() or weighed.any() else None
    u_op = None if model.operating_point is None else model.u_op
    law_of_u: dict[str, Any] = {"preview": Hp + 1, "K_d": K_d, "u_0": u_0, "u_op": u_op}
    law_of_u["du"] = None if limits.du is None else du
    gains = (first @ Psi, K_u, first, *one_for_all(u))
    if limits.enforce == "clip":
        return Mpc(*gains, **law_of_u)
    rows = soft_rows(soft or {}, model, Hp, plant_info)
    cost = IncrementCost(Hp, Hu, root_Q, root_R, moves @ root_Q, as_vector(scale.u, model.nu))
    program = increment_program(model, cost, u, du, rows, uses_mean=uses_mean)
    return ConstrainedMpc(*gains, **law_of_u, program=program, fallback=limits.fallback)


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
