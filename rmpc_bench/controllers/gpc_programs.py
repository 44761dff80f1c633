"""Quadratic programs of generalised predictive control in the inputs u(k)..u(k+Np-1).

Problem  The cost of gpc.py, subject to the rows of gpc_rows.py: hard limits of the inputs and of their increments, the
         first of which is u(k) - u(k-1) with the applied input u(k-1), and soft limits of predicted signals.
Skip     As in constrained.py: the inputs without limits are the minimum if all of them and all limited predictions
         satisfy the limits.  Then u(k) has the bits of the law without limits.
Scale    The unknowns V are those of tracking.py, in which inputs and signals are those of the closed loop.
Laws     A constant model has one program (ConstantProgram).  Otherwise the matrices differ from run to run or from
         sample to sample: the recursion of tracking.py gives all inputs and predictions for the test, and a program of
         its own is made for every run in which a limit acts (VaryingProgram).
Shared   By the laws of gpc_law.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int8

from rmpc_bench.controllers.constrained import STEPS, ConstrainedMoves, Rows, unit_program
from rmpc_bench.controllers.gpc_rows import Limited
from rmpc_bench.controllers.prediction import Frozen
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.tracking import Path, Problem, moved_by, paths
from rmpc_bench.types import Array, OptimisedStep


@dataclass(frozen=True, eq=False)
class ConstantProgram:
    """The program of a constant model with constant weights, whose moves are all inputs."""

    moves: ConstrainedMoves

    def inputs(
        self,
        free: Float[Array, "runs nu"],
        x: Float[Array, "runs nx"],
        u_previous: Float[Array, "runs nu"],
        w: Float[Array, "N ny"],
    ) -> tuple[Float[Array, "runs nu"], Int8[Array, " runs"]]:
        """Return the first inputs and how they were found; `free` are those without limits, w the desired outputs."""
        U, steps = self.moves.moves(np.hstack([x, u_previous]), np.append(w.ravel(), 1.0))
        return np.where((steps == OptimisedStep.SKIPPED)[:, None], free, U[:, : free.shape[1]]), steps


def constant_program(
    now: Frozen, Q_yw: Float[Array, "ny ny"], Q_u: Float[Array, "nu nu"], limited: Limited, *, skips: bool = True
) -> ConstantProgram:
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
    return ConstantProgram(ConstrainedMoves(M, moves[:, known:], every, nx + nu, skips))


@dataclass(frozen=True, eq=False)
class VaryingProgram:
    """Programs of models or weights that differ from run to run, or from sample to sample."""

    R_u: Float[Array, "nu nu"]  # upper triangular root of the input weight
    skips: bool = True  # whether no program is solved where no limit acts

    def inputs(
        self,
        now: Frozen,
        Q_yw: Float[Array, "weights ny ny"],
        limited: Limited,
        x: Float[Array, "runs nx"],
        u_previous: Float[Array, "runs nu"],
        w: Float[Array, "N ny"],
    ) -> tuple[Path, Float[Array, "runs nu"], Int8[Array, " runs"]]:
        """Return the minima without limits, the first inputs with limits and how they were found.

        A and B of the model have axis 0 = run, of length 1 if shared, and so have the roots of the output weight.
        """
        path = paths(now.A, now.B, now.f, now.C, Q_yw, self.R_u, w, x)
        values, u = limited.values(path, u_previous), path.U[:, 0].copy()
        steps = np.full(len(x), OptimisedStep.SKIPPED, dtype=np.int8)
        free = ((values >= limited.low) & (values <= limited.high)).all(axis=1) & np.isfinite(path.U).all(axis=(1, 2))
        for run in np.flatnonzero(~free) if self.skips else range(len(x)):
            if not (np.isfinite(path.U[run]).all() and np.isfinite(values[run]).all()):
                steps[run] = OptimisedStep.NOT_CONVERGED
                continue
            A, B = (each[run] if len(each) > 1 else each[0] for each in (now.A, now.B))
            moved, step = self.moved(A, B, path.laws[run], limited, values[run])
            steps[run] = step
            if not step.failed:
                u[run] += moved[: u.shape[1]]
        return path, u, steps

    def moved(
        self, A: Array, B: Array, laws: Float[Array, "N nu columns"], limited: Limited, values: Float[Array, " rows"]
    ) -> tuple[Float[Array, " inputs"], OptimisedStep]:
        """Return how the limits move the inputs of one run, whose rows are `values` without limits, and the result."""
        U, X = moved_by(laws, A, B)
        rows = limited.rows(U, X) / limited.unit[:, None]
        program, g = unit_program(rows, limited.soft, *limited.weights)
        x, (status,) = program.nearest(*((end - values)[None] / limited.unit for end in (limited.low, limited.high)))
        return mv(U.reshape(-1, U.shape[2]) / g, x)[0], STEPS[status]
