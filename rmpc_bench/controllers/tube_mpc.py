"""Robust model predictive control of a linear model with bounded noise: limits hold for every noise in a box.

Model   x(k+1) = A x(k) + B u(k) + w(k), every w(k) in the box W; limits on inputs, states, outputs and other signals.
        Law: u(k) = K x(k) + c_0(k), where K is the gain of the infinite horizon and c_0 the first correction of
        min sum_{j<N} |z(j)|^2_Qx + |v(j)|^2_Ru + |z(N)|^2_P  over the nominal predictions z(j+1) = A z(j) + B v(j),
        v(j) = K z(j) + c_j, which meet tightened limits; after N they do so with c = 0.
        `tube`     z(0) is free in x(k) - Z.  Z is a robust invariant set of x+ = (A + B K) x + w: the error x - z stays
                   in it, and every limit is tightened by what Z reaches.
        `growing`  z(0) = x(k).  The limits of step j are tightened by what the noise of j samples reaches.
        `none`     z(0) = x(k), and no limit is tightened: predictive control that ignores the noise.
        Regulates to x = 0, or to the operating point of the model.
Source  tube: Mayne, Seron and Rakovic (2005), Z by Rakovic, Kerrigan, Kouramas and Mayne (2005); growing: Chisci,
        Rossiter and Zappa (2001), with the largest terminal set (Gilbert and Tan 1991).
Holds   If the problem is feasible at k = 0, it stays feasible and no limit is violated, for x measured without noise
        and w in W.  With an estimated state the law uses x_hat as x, and W does not contain the error of the estimate.
Assumed The design is made for W (1 + `margin`).  Without it x can come to a point with exactly one z(0), where an error
        of the solver of 1e-10 makes the next problem infeasible.
Limit   Without an active limit lqr with an infinite horizon.  With W -> 0 all three laws are one.
Cost    A matrix-vector product per run and step where no limit acts; otherwise a quadratic program, 20 to 30 us.
Fails   Design error: W leaves no room inside the limits, no input reaches an unstable mode, or Z has too many facets.
        Where no c satisfies the limits, `fallback` selects the input.  If this happens at k = 0, a longer `horizon`
        or a smaller W may make the problem feasible.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float

from rmpc_bench.controllers.constrained import ConstrainedMoves, with_fallback
from rmpc_bench.controllers.limits import Bounds, Fallback, common_limits
from rmpc_bench.controllers.tube_design import LimitRows, Tightening, TubeDesign, feedback, limit_rows
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.intervals import Pairs
from rmpc_bench.numerics.linalg import as_vector, mv
from rmpc_bench.types import (
    Array,
    Command,
    Controller,
    DesignError,
    Estimate,
    Estimator,
    Horizon,
    Matrix,
    Model,
    NonNegative,
    OperatingPoint,
    OptimisedStep,
    PlantInfo,
    Positive,
)

EQUATION = r"""\min \sum_{j=0}^{N-1} \Vert z_j \Vert_{Q_x}^2 + \Vert v_j \Vert_{R_u}^2 + \Vert z_N \Vert_P^2, \quad
z_0 \in x_k - Z, \quad u_k = v_0 + K (x_k - z_0)"""
FAILED = [each for each in OptimisedStep if each.failed]
ESTIMATED = (
    "The limits are guaranteed for a measured state only; this design model has measurement noise or does not measure "
    "every state, and W does not contain the error of the estimate"
)


class TubeState(NamedTuple):
    """State of the controller between steps."""

    u_previous: Float[Array, "runs nu"]  # previous input, for `fallback: hold`


@dataclass(frozen=True, eq=False)
class TubeMpc(Controller):
    """The law u = K x + c_0; create it with `design`."""

    plan: TubeDesign
    u_limits: Bounds  # lower and upper limits of the deviations u - u_op
    fallback: Fallback
    point: OperatingPoint  # operating point; 0 for a model without one
    is_at_zero: bool
    measured: bool  # whether the model measures every state without noise

    regulates = True
    allows_delay = False
    allows_late_outputs = False

    @property
    def regulates_to(self) -> Float[Array, " ny"] | None:
        """Output at the operating point."""
        return None if self.is_at_zero else self.point.y

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """Result of the step, the minimum of the cost, and with a tube the start of the nominal predictions."""
        start = {"s_0": (len(self.point.x),)} if self.plan.free_start else {}
        return {"qp": (), "V": (), **start}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Say where the guarantee does not hold."""
        return () if self.measured or self.plan.tightening == "none" else (ESTIMATED,)

    @property
    def input_limits(self) -> tuple[float, float] | Bounds | None:
        """Lower and upper limit that no input exceeds."""
        return common_limits(Bounds(*(bound + self.point.u for bound in self.u_limits)))

    @cached_property
    def program(self) -> ConstrainedMoves:
        """The quadratic programs of the samples: the point of a polytope, moved by x, that is closest to 0."""
        rows = self.plan.rows
        n, nx = rows.A.shape[1], rows.E.shape[1]
        return ConstrainedMoves(np.zeros((n, nx)), np.eye(n), rows, nx)

    @cached_property
    def first(self) -> Float[Array, "nu unknowns"]:
        """What the unknowns contribute to c_0."""
        return self.plan.correction(0)

    def init(self, n_runs: int) -> TubeState:
        """Start from the input of the operating point."""
        return TubeState(np.tile(self.point.u, (n_runs, 1)))

    def control(
        self, k: int, state: TubeState, y: Float[Array, "runs ny"], estimate: Estimate, r: Float[Array, "preview ny"]
    ) -> tuple[TubeState, Command]:
        """Apply K x + c_0, or the fallback where no corrections satisfy the limits."""
        x = estimate.x_hat - self.point.x
        found = self.program.moves(x, np.zeros(0))
        closed = mv(self.plan.feedback.K, x)
        u = closed + mv(self.first, found.V) + self.point.u
        clipped = np.clip(closed, *self.u_limits) + self.point.u
        command = with_fallback(u, clipped, state.u_previous, found.steps, self.fallback)
        failed = np.isin(found.steps, FAILED)
        V = np.where(failed[:, None], np.nan, found.V)
        return TubeState(command.u), command._replace(info={**command.info, **self._info(x, V)})

    def applied(self, k: int, state: TubeState, u: Float[Array, "runs nu"]) -> TubeState:
        """Keep the input that acts, for `hold`."""
        return TubeState(u)

    def _info(self, x: Array, V: Array) -> dict[str, Array]:
        """Return the minimum of the cost and the start of the nominal predictions; NaN where the step failed."""
        nx, P = len(self.point.x), self.plan.feedback.P
        squares = np.einsum("ri,ri->r", V, V)
        if not self.plan.free_start:
            return {"V": squares + np.einsum("ri,ri->r", mv(P, x), x)}
        return {"V": squares, "s_0": mv(self.plan.nominal[0][0][:, :nx], V[:, :nx]) + self.point.x}

    def series(self) -> Mapping[str, Array]:
        """Gain of the feedback, u = -L_u x + c_0."""
        return {"L_u": -self.plan.feedback.K[None]}


def design(
    model: Model,
    estimator: Estimator | None = None,
    plant_info: PlantInfo | None = None,
    *,
    Q_x: Matrix,
    R_u: Matrix,
    horizon: Horizon,
    limits: dict[str, Pairs],
    W: Positive | list[Positive] | None = None,
    tightening: Tightening = "tube",
    fallback: Fallback = "clip",
    margin: NonNegative = 1e-6,
    alpha: Annotated[float, Gt(0), Lt(1)] = 1e-5,
) -> TubeMpc:
    """Robust model predictive control with limits that hold for all noise in a box.

    Parameters
    ----------
    model : constant design model
    plant_info : names of the states and outputs of the plant
    estimator : estimator of the method; must not estimate a mean of the process noise
    Q_x : weight of the state
    R_u : weight of the input, positive definite
    horizon : N, number of corrections of the feedback [samples]
    limits : [low, high] by signal: `u` (one pair for all inputs, or one per input), `u.0`, `x.1`, `y.0`, or a signal
        that the design model names; `null` for none
    W : half widths of the box of the process noise; not for `tightening: none`
    tightening : `tube` tightens every limit by a robust invariant set, `growing` that of step j by the noise of j
        samples, `none` no limit
    fallback : input where no corrections satisfy the limits: `clip` is the clipped feedback, `hold` the previous input,
        `stop` ends the run
    margin : relative margin by which the box of the design is larger than W
    alpha : accuracy of the robust invariant set, which is at most 1/(1 - alpha) times as large as its finite sum

    Raises
    ------
    DesignError
        If a weight, a limit or W is not admissible, the model is not constant or has a constant part, no input reaches
        an unstable mode, or W leaves no room inside the limits.
    """
    model.refuse_feedthrough("tube-mpc")
    at_zero = constant_model(model, estimator)
    point = OperatingPoint(model.x_op, model.u_op, model.y_op)
    rows = limit_rows(model, limits, plant_info)
    if W is None and tightening != "none":
        raise DesignError(f"`W` is needed with tightening: {tightening}", "W")
    half_widths = as_vector(0.0 if tightening == "none" or W is None else W, at_zero.nx, "W")
    gains = feedback(at_zero.A, at_zero.B, Q_x, R_u)
    plan = TubeDesign(at_zero.B, gains, rows, horizon, tightening, half_widths * (1.0 + margin), alpha)
    # Computed here, so that an error is one of the design.
    _ = plan.rows
    measured = not at_zero.R_v.any() and np.linalg.matrix_rank(at_zero.C) == at_zero.nx
    u_limits = input_bounds(rows)
    return TubeMpc(plan, u_limits, fallback, point, model.operating_point is None, bool(measured))


def constant_model(model: Model, estimator: Estimator | None) -> LinearModel:
    """Return the model of deviations from the operating point; it must not vary with k or have a constant part."""
    # A state-dependent model raises a DesignError here.
    found: LinearModel = model.deviation.at(0)
    if model.varies:
        raise DesignError("needs a constant design model; this model varies with k")
    if found.f0.any():
        if model.operating_point is not None:
            raise DesignError("needs an operating point that is a steady state; use another `at` of the model")
        raise DesignError("does not support a known mean of the process noise; use lqr, or a model without this mean")
    if estimator is not None and estimator.estimates_mean:
        raise DesignError("does not support an estimated mean of the process noise; use lqr, mpc or another estimator")
    return found


def input_bounds(rows: LimitRows) -> Bounds:
    """Return the tightest limits of every input alone."""
    low, high = np.full(rows.H_u.shape[1], -np.inf), np.full(rows.H_u.shape[1], np.inf)
    for of_u, least, largest in zip(rows.H_u, rows.low, rows.high, strict=True):
        low, high = (
            np.where(of_u != 0.0, np.maximum(low, least), low),
            np.where(of_u != 0.0, np.minimum(high, largest), high),
        )
    return Bounds(low, high)
