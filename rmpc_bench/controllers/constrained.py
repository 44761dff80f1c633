"""Moves of a predictive controller under limits: one quadratic program per run and sample, skipped where no limit acts.

Problem  minimise |V|^2 + cost of the slacks   over low <= A V + E p <= high, hard rows and soft ones; the moves are
         M p + L V.  p = [own; shared] are the parameters: those of every run, such as x_hat and u(k-1), and those that
         all runs share, such as the reference.  M p minimises the cost without rows.
Skip     If low <= E p <= high in every row, then V = 0 with multipliers and slacks of 0 satisfies the conditions of the
         minimum, so that it is the minimum, and no program is solved.  The test is exact: all moves and all predicted
         samples count, without a tolerance.
Scale    With V / g as unknowns the longest row, in its unit, has the length 1: a violation of a tolerance of the solver
         is then at most as large in units of the row, whatever the size of the cost is.
Bits     All products are summed by einsum (`mv`), and every program starts cold: a run has the same bytes in any block.
Missing  A parameter that is not a number makes every comparison false: the run is not skipped, and is not solved.
Shared   By the controllers mpc, gpc and tube-mpc.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int8

from rmpc_bench.controllers.limits import Fallback
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.qp import MOST_ITERATIONS, QpStatus, QuadraticProgram
from rmpc_bench.types import Array, Command, OptimisedStep, Status

STEPS = {
    QpStatus.OPTIMAL: OptimisedStep.SOLVED,
    QpStatus.SOFTENED: OptimisedStep.SOFTENED,
    QpStatus.INFEASIBLE: OptimisedStep.INFEASIBLE,
    QpStatus.ITERATION_LIMIT: OptimisedStep.NOT_CONVERGED,
    QpStatus.FAILED: OptimisedStep.NOT_CONVERGED,
}
"""Status of the solver -> result of the step."""
STATUSES = {OptimisedStep.INFEASIBLE: Status.INFEASIBLE, OptimisedStep.NOT_CONVERGED: Status.NOT_CONVERGED}
"""Result of a failed step -> status of the step, or of a run that ends with it."""


class Rows(NamedTuple):
    """Rows low <= A V + E p <= high of a program; `stacked` joins several."""

    A: Float[Array, "rows n"]
    E: Float[Array, "rows np"]
    low: Float[Array, " rows"]
    high: Float[Array, " rows"]
    unit: Float[Array, " rows"]  # unit of a row and of its slack: the solver has absolute tolerances
    soft: Bool[Array, " rows"]
    linear: Float[Array, " rows"]  # cost of a slack of one unit; not used in hard rows
    quadratic: Float[Array, " rows"]  # cost of half the square of a slack of one unit; not used in hard rows

    @classmethod
    def hard(
        cls,
        A: Float[Array, "rows n"],
        E: Float[Array, "rows np"],
        low: Float[Array, " rows"],
        high: Float[Array, " rows"],
        unit: Float[Array, " rows"],
    ) -> Rows:
        """Return rows that the moves must satisfy."""
        nothing = np.zeros(len(A))
        return cls(A, E, low, high, unit, np.zeros(len(A), dtype=bool), nothing, nothing + 1.0)

    @classmethod
    def stacked(cls, parts: Sequence[Rows]) -> Rows:
        """Return the rows of several parts; those without a finite bound are left out."""
        whole = cls(*(np.concatenate(each) for each in zip(*parts, strict=True)))
        limited = np.isfinite(whole.low) | np.isfinite(whole.high)
        return cls(*(np.ascontiguousarray(each[limited]) for each in whole))


class Moves(NamedTuple):
    """Moves of every run, and how they were found."""

    V: Float[Array, "runs n"]  # the minimum; where the step failed, M p
    steps: Int8[Array, " runs"]  # values of `OptimisedStep`


@dataclass(frozen=True, eq=False)
class ConstrainedMoves:
    """Programs that differ in their parameters."""

    M: Float[Array, "n np"]  # moves of the minimum without rows
    L: Float[Array, "n unknowns"]  # moves for the unknowns V
    rows: Rows  # the limits, whose A belongs to V
    n_own: int  # number of parameters of every run; the other ones are shared by all runs
    skips: bool = True  # whether no program is solved where no limit acts; otherwise every program is
    iteration_limit: int = MOST_ITERATIONS  # largest number of iterations of the solver

    def moves(self, own: Float[Array, "runs own"], shared: Float[Array, " shared"]) -> Moves:
        """Return the moves of a block of runs for the parameters of every run and those that all runs share."""
        own, shared, rows = np.ascontiguousarray(own), np.ascontiguousarray(shared)[None], self.rows
        of_own, of_shared = self._moves_and_rows
        found = mv(of_own, own) + mv(of_shared, shared)
        n = len(self.M)
        V, tested = found[:, :n], found[:, n:]
        # A comparison with NaN is false, so that the run is not skipped.
        free = np.asarray(((tested >= rows.low) & (tested <= rows.high)).all(axis=1))
        steps = np.zeros(len(own), dtype=np.int8)
        if not (self.skips and free.all()):
            acting = np.flatnonzero(~free) if self.skips else np.arange(len(own))
            low, high = ((end - tested[acting]) / rows.unit for end in (rows.low, rows.high))
            program, L = self._program
            x, statuses = program.nearest(low, high)
            steps[acting] = [STEPS[status] for status in statuses]
            solved = [status.solved for status in statuses]
            V[acting[solved]] += mv(L, x[solved])
        return Moves(V, steps)

    @cached_property
    def _moves_and_rows(self) -> tuple[Array, Array]:
        """Gains of the moves without rows and, below them, of the rows, for the own and the shared parameters."""
        gains = np.vstack([self.M, self.rows.E])
        return np.ascontiguousarray(gains[:, : self.n_own]), np.ascontiguousarray(gains[:, self.n_own :])

    @cached_property
    def _program(self) -> tuple[QuadraticProgram, Float[Array, "n unknowns"]]:
        rows = self.rows
        program, g = unit_program(
            rows.A / rows.unit[:, None], rows.soft, rows.linear, rows.quadratic, self.iteration_limit
        )
        return program, np.ascontiguousarray(self.L / g)


def unit_program(
    A: Array, soft: Array, linear: Array, quadratic: Array, limit: int = MOST_ITERATIONS
) -> tuple[QuadraticProgram, float]:
    """Return the program of g V for rows in their units, and g."""
    # Without an effect of the moves on any row, every unit will do.
    g = float(np.sqrt((A * A).sum(axis=1).max(initial=0.0))) or 1.0
    weights = 0.5 * g * g * linear, np.where(soft, 0.5 * g * g * quadratic, 1.0)
    return QuadraticProgram(np.eye(A.shape[1]), A / g, soft, *weights, limit), g


def with_fallback(
    u: Float[Array, "runs nu"],
    clipped: Float[Array, "runs nu"],
    u_previous: Float[Array, "runs nu"],
    steps: Int8[Array, " runs"],
    fallback: Fallback | None,
) -> Command:
    """Return the command of a constrained law, with the entry `qp` and the statuses of failed steps.

    `clipped` is the clipped unconstrained minimiser, for `clip` and `stop`; `u_previous` is u(k-1), for `hold`.
    """
    statuses, info = np.zeros(len(u), dtype=np.int8), {"qp": steps.astype(float)}
    if not (steps >= OptimisedStep.INFEASIBLE).any():
        return Command(u, statuses, info)
    for step, status in STATUSES.items():
        statuses[steps == step] = status
    failed = (statuses != Status.OK)[:, None]
    # A missing estimate gives no input, not the previous one.
    held = np.where(np.isnan(clipped), clipped, u_previous)
    u = np.where(failed, held if fallback == "hold" else clipped, u)
    if fallback == "stop":
        return Command(u, statuses, info)
    return Command(u, np.zeros_like(statuses), info, statuses)
