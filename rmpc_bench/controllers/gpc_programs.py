"""Quadratic programs of generalised predictive control in the inputs u(k)..u(k+Np-1).

Problem  The cost of gpc.py, subject to the rows of gpc_rows.py: hard limits of the inputs and of their increments, the
         first of which is u(k) - u(k-1) with the applied input u(k-1), and soft limits of predicted signals.
Skip     As in constrained.py: the inputs without limits are the minimum if all of them and all limited predictions
         satisfy the limits.  Then u(k) has the bits of the law without limits.
Scale    The unknowns are those of condensed.py.
Laws     A constant model has one program (ConstantProgram).  Otherwise the matrices differ from run to run or from
         sample to sample: the recursion of tracking.py gives all inputs and predictions for the test, and a program of
         its own is made for every run in which a limit acts (VaryingProgram).
Shared   By the laws of gpc_law.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int8

from rmpc_bench.controllers.constrained import STEPS, ConstrainedMoves, Rows
from rmpc_bench.controllers.gpc_rows import Limited
from rmpc_bench.controllers.prediction import Frozen
from rmpc_bench.numerics.condensed import Responses, residuals, responses, unit_rows
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.qp import QuadraticProgram
from rmpc_bench.numerics.tracking import Path, paths
from rmpc_bench.types import Array, OptimisedStep


@dataclass(frozen=True, eq=False)
class ConstantProgram:
    """The program of a constant model with constant weights; create it with `constant_program`.

    Parameters
    ----------
    moves : program in the unknowns of condensed.py
    matrix : inputs of the horizon for the unknowns: U = matrix V
    """

    moves: ConstrainedMoves
    matrix: Float[Array, "inputs inputs"]

    def inputs(
        self,
        free: Float[Array, "runs nu"],
        x: Float[Array, "runs nx"],
        u_previous: Float[Array, "runs nu"],
        w: Float[Array, "N ny"],
    ) -> tuple[Float[Array, "runs nu"], Int8[Array, " runs"]]:
        """Return the first inputs and how they were found; `free` are those without limits.

        Parameters
        ----------
        free : first inputs of the minima without limits
        x : states
        u_previous : inputs before them
        w : desired outputs
        """
        V, steps = self.moves.moves(np.hstack([x, u_previous]), np.append(w.ravel(), 1.0))
        return np.where((steps == OptimisedStep.SKIPPED)[:, None], free, mv(self.matrix[: free.shape[1]], V)), steps


def constant_program(
    now: Frozen, Q_yw: Float[Array, "ny ny"], Q_u: Float[Array, "nu nu"], limited: Limited, *, skips: bool = True
) -> ConstantProgram:
    """Return the program of a constant model; its parameters are x, u(k-1), the desired outputs and 1.

    Parameters
    ----------
    now : model
    Q_yw, Q_u : roots of the weights
    limited : rows of the horizon
    skips : whether no program is solved where no limit acts
    """
    N, (nx, nu), ny = len(limited.signals.limited), now.B.shape, len(now.C)
    answers = responses(now.A, now.B, now.f, N)
    orthogonal, R = np.linalg.qr(residuals(answers.Theta, now.C, Q_yw, Q_u))
    a = limited.rows(answers.Theta)
    _, R_inverse, g = unit_rows(a / limited.unit[:, None], R)
    # V* = g Q' b of the residuals b = Q_yw (w - C (Psi x + held)) of zero inputs.
    weighted = g * np.einsum("jip,im->pjm", orthogonal[: N * ny].reshape(N, ny, -1), Q_yw)
    M_w, M_x = weighted.reshape(-1, N * ny), -np.einsum("pji,im,jmn->pn", weighted, now.C, answers.Psi)
    M_1 = -np.einsum("pji,im,jm->p", weighted, now.C, answers.held)
    M = np.hstack([M_x, np.zeros((N * nu, nu)), M_w, M_1[:, None]])
    E = np.hstack([_of_parameters(limited, answers), np.zeros((len(a), N * ny)), _constants(limited, answers)[:, None]])
    low, high, unit = limited.low, limited.high, limited.unit
    rows = Rows(a @ R_inverse, E, low, high, unit, limited.soft, *limited.weights(0.5 * g * g))
    moves = ConstrainedMoves(np.eye(N * nu), -M, M, rows, np.ones(N * nu), nx + nu, skips)
    return ConstantProgram(moves, R_inverse)


def _of_parameters(limited: Limited, answers: Responses) -> Float[Array, "rows parameters"]:
    """Return what x and u(k-1) add to the rows."""
    z = np.einsum("im,jmn->jin", limited.signals.Z, answers.Psi)[limited.signals.limited]
    before, nu = limited.hard.before, limited.hard.before.shape[1]
    return np.block([[np.zeros((len(before), z.shape[1])), before], [z, np.zeros((len(z), nu))]])


def _constants(limited: Limited, answers: Responses) -> Float[Array, " rows"]:
    """Return what the constant parts of the model and of the signals add to the rows."""
    z = np.einsum("im,jm->ji", limited.signals.Z, answers.held) + limited.signals.constant
    return np.concatenate([np.zeros(len(limited.hard.unit)), z[limited.signals.limited]])


@dataclass(frozen=True, eq=False)
class VaryingProgram:
    """Programs of models or weights that differ from run to run, or from sample to sample.

    Parameters
    ----------
    R_u : upper triangular root of the input weight
    skips : whether no program is solved where no limit acts
    """

    R_u: Float[Array, "nu nu"]
    skips: bool = True

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

        Parameters
        ----------
        now : model, whose A and B have axis 0 = run, of length 1 if shared
        Q_yw : roots of the output weight, one for every run or one for all
        limited : rows of the horizon
        x : states
        u_previous : inputs before them
        w : desired outputs
        """
        path = paths(now.A, now.B, now.f, now.C, Q_yw, self.R_u, w, x)
        values, u = limited.values(path, u_previous), path.U[:, 0].copy()
        steps = np.full(len(x), OptimisedStep.SKIPPED, dtype=np.int8)
        free = ((values >= limited.low) & (values <= limited.high)).all(axis=1) & np.isfinite(path.U).all(axis=(1, 2))
        for run in np.flatnonzero(~free) if self.skips else range(len(x)):
            if not (np.isfinite(path.U[run]).all() and np.isfinite(values[run]).all()):
                steps[run] = OptimisedStep.NOT_CONVERGED
                continue
            A, B, weight = (each[run] if len(each) > 1 else each[0] for each in (now.A, now.B, Q_yw))
            frozen = Frozen(A, B, now.f, now.C, now.d)
            moved, step = self.moved(frozen, weight, limited, values[run])
            steps[run] = step
            if not step.failed:
                u[run] += moved[: u.shape[1]]
        return path, u, steps

    def moved(
        self, now: Frozen, Q_yw: Float[Array, "ny ny"], limited: Limited, values: Float[Array, " rows"]
    ) -> tuple[Float[Array, " inputs"], OptimisedStep]:
        """Return how the limits move the inputs of the horizon, and how this was found.

        Parameters
        ----------
        now, Q_yw : model and root of the output weight of one run
        limited : rows of the horizon
        values : the rows at the minimum without limits
        """
        N, nu = len(limited.signals.limited), len(self.R_u)
        Theta = responses(now.A, now.B, now.f, N).Theta
        R = np.linalg.qr(residuals(Theta, now.C, Q_yw, self.R_u)).R
        rows, R_inverse, g = unit_rows(limited.rows(Theta) / limited.unit[:, None], R)
        program = QuadraticProgram(np.eye(N * nu), rows, limited.soft, *limited.weights(0.5 * g * g))
        low, high = (limited.low - values) / limited.unit, (limited.high - values) / limited.unit
        answer = program.solve(np.zeros(N * nu), low, high)
        return mv(R_inverse, answer.x[None])[0], STEPS[answer.status]
