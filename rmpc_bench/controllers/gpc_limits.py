"""Limits of generalised predictive control: clipping, quadratic programs in the inputs u(k)..u(k+Np-1), the fallback.

Problem  The cost of gpc.py, subject to the rows of gpc_rows.py: hard limits of the inputs and of their increments, the
         first of which is u(k) - u(k-1) with the applied input u(k-1), and soft limits of predicted signals.
Skip     As in constrained.py: the inputs without limits are the minimum if all of them and all limited predictions
         satisfy the limits.  Then u(k) has the bits of the law without limits.
Scale    The unknowns V are those of tracking.py, in which inputs and signals are those of the closed loop.
Laws     A constant model with constant weights has one program.  Otherwise the matrices differ from run to run or from
         sample to sample: the recursion of tracking.py gives all inputs and predictions for the test, and a program of
         its own is made for every run in which a limit acts.
Shared   By the laws of gpc_law.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int8

from rmpc_bench.controllers.constrained import STEPS, ConstrainedMoves, Rows, unit_program, with_fallback
from rmpc_bench.controllers.gpc_rows import HardRows, Limited, LimitedHorizon
from rmpc_bench.controllers.limits import Bounds, Fallback, Limits, SoftLimit, bounds_of, refuse_unused
from rmpc_bench.controllers.prediction import Frozen
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.tracking import Problem, RunProblems, moved_by
from rmpc_bench.types import Array, Command, OptimisedStep, PlantInfo


@dataclass(frozen=True, eq=False)
class GpcLimits:
    """Limits of a law; create them with `limits_of`."""

    u: Bounds  # u, du: bounds of u - u_op and of its increment
    du: Bounds
    fallback: Fallback | None  # as in `Limits`
    horizon: LimitedHorizon | None = None  # rows of every sample; None where the limits clip
    # of a constant model with constant weights, whose moves are all inputs; None where the limits clip or for others
    program: ConstrainedMoves | None = None
    skips: bool = True  # whether the other programs are not solved where no limit acts

    @property
    def optimised(self) -> bool:
        """Whether the limits are constraints of the optimisation."""
        return self.horizon is not None

    def clipped(self, u: Float[Array, "runs nu"], u_previous: Float[Array, "runs nu"]) -> Float[Array, "runs nu"]:
        """Return inputs with the increment clipped first, then the input; inputs within the limits keep their bits."""
        if np.isfinite(self.du).any():
            u = np.clip(u, u_previous + self.du.low, u_previous + self.du.high)
        return np.clip(u, *self.u)

    def constant(
        self,
        free: Float[Array, "runs nu"],
        x: Float[Array, "runs nx"],
        u_previous: Float[Array, "runs nu"],
        w: Float[Array, "N ny"],
    ) -> Command:
        """Return the command of a constant law for its inputs without limits and the desired outputs w."""
        if self.program is None:
            return Command(self.clipped(free, u_previous))
        U, steps = self.program.moves(np.hstack([x, u_previous]), np.append(w.ravel(), 1.0))
        u = np.where((steps == OptimisedStep.SKIPPED)[:, None], free, U[:, : free.shape[1]])
        return self._command(u, free, steps, u_previous)

    def varying(
        self,
        now: Frozen,
        roots: tuple[Float[Array, "weights ny ny"], Float[Array, "nu nu"]],
        limited: Limited,
        x: Float[Array, "runs nx"],
        u_previous: Float[Array, "runs nu"],
        w: Float[Array, "N ny"],
    ) -> tuple[Command, Float[Array, " runs"]]:
        """Return the command of any other law and the minimal costs without limits.

        A and B of the model have axis 0 = run, of length 1 if shared, and so have the roots of the output weight.
        """
        path = RunProblems(now.A, now.B, now.f, now.C, *roots, w, x).paths()
        values, free = limited.values(path, u_previous), path.U[:, 0]
        u, steps = free.copy(), np.full(len(x), OptimisedStep.SKIPPED, dtype=np.int8)
        kept = ((values >= limited.low) & (values <= limited.high)).all(axis=1) & np.isfinite(path.U).all(axis=(1, 2))
        for run in np.flatnonzero(~kept) if self.skips else range(len(x)):
            if not (np.isfinite(path.U[run]).all() and np.isfinite(values[run]).all()):
                steps[run] = OptimisedStep.NOT_CONVERGED
                continue
            A, B = (each[run] if len(each) > 1 else each[0] for each in (now.A, now.B))
            moved, step = moved_inputs(A, B, path.laws[run], limited, values[run])
            steps[run] = step
            if not step.failed:
                u[run] += moved[: u.shape[1]]
        return self._command(u, free, steps, u_previous), path.loss

    def _command(
        self, u: Float[Array, "runs nu"], free: Float[Array, "runs nu"], steps: Int8[Array, " runs"], u_previous: Array
    ) -> Command:
        """Return the command; the solver satisfies the limits to its tolerance only, clipping to the last bit."""
        clipped = self.clipped(free, u_previous)
        return with_fallback(self.clipped(u, u_previous), clipped, u_previous, steps, self.fallback)


def moved_inputs(
    A: Array, B: Array, laws: Float[Array, "N nu columns"], limited: Limited, values: Float[Array, " rows"]
) -> tuple[Float[Array, " inputs"], OptimisedStep]:
    """Return how the limits move the inputs of one run, whose rows are `values` without limits, and the result."""
    U, X = moved_by(laws, A, B)
    rows = limited.rows(U, X) / limited.unit[:, None]
    program, g = unit_program(rows, limited.soft, *limited.weights)
    x, (status,) = program.nearest(*((end - values)[None] / limited.unit for end in (limited.low, limited.high)))
    return mv(U.reshape(-1, U.shape[2]) / g, x)[0], STEPS[status]


def constant_program(
    now: Frozen, Q_yw: Float[Array, "ny ny"], Q_u: Float[Array, "nu nu"], limited: Limited
) -> ConstrainedMoves:
    """Return the program of a constant model and roots of weights; its parameters are x, u(k-1), w and 1."""
    N, (nx, nu) = len(limited.signals.limited), now.B.shape
    problem = Problem(now.A, now.B, now.f, now.C, Q_yw, Q_u, N, N)
    U, X = problem.responses(problem.stages()[0])
    known = U.shape[2] - N * nu
    rows, moves, hard, signals = limited.rows(U, X), U.reshape(N * nu, -1), limited.hard, limited.signals
    rows[len(hard.unit) :, known - 1] += signals.spread(signals.constant)
    before = np.pad(hard.before, ((0, len(rows) - len(hard.before)), (0, 0)))
    E, M = (
        np.hstack([each[:, :nx], of_u, each[:, nx:known]])
        for each, of_u in ((rows, before), (moves, np.zeros((len(moves), nu))))
    )
    low, high, unit = limited.low, limited.high, limited.unit
    every = Rows(rows[:, known:], E, low, high, unit, limited.soft, *limited.weights)
    return ConstrainedMoves(M, moves[:, known:], every, nx + nu)


def limits_of(
    limits: Limits | None, soft: dict[str, SoftLimit] | None, model: Any, nx: int, N: int, plant_info: PlantInfo | None
) -> GpcLimits | None:
    """Return the limits without a program, None without limits."""
    if limits is None and not soft:
        return None
    limits = limits or Limits()
    refuse_unused(limits, soft)
    u = bounds_of(limits.u, model.nu, "limits.u")
    # The inputs of the laws are deviations from the operating point.
    u, du = Bounds(u.low - model.u_op, u.high - model.u_op), bounds_of(limits.du, model.nu, "limits.du")
    if limits.enforce == "clip":
        return GpcLimits(u, du, limits.fallback)
    horizon = LimitedHorizon(model, nx, HardRows.of(u, du, N), soft or {}, N, plant_info)
    # Wrong names and sizes are reported now.
    horizon.at(0)
    return GpcLimits(u, du, limits.fallback, horizon)
