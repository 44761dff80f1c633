"""The quadratic program of predictive control in increments of the input.

Model   The moves are [du(k); ..; du(k+Hu-1)], the parameters p = [x_hat; u(k-1); d_hat] of every run, d_hat only with
        an estimated mean of the process noise, and [r(k+1); ..; r(k+Hp); 1], which all runs share.
Form    Moves, inputs and limited signals are functions of p and of the unknowns V of tracking.py: those of the closed
        loop without limits, in which V = 0, so that an unstable plant leaves no powers of A in the first Hu samples.
Shared  By the controller mpc, which has the law without limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.constrained import ConstrainedMoves, Rows
from rmpc_bench.controllers.limits import Bounds, SoftRows, key_of
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.tracking import Problem, Stage
from rmpc_bench.types import Array, DesignError

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
    """Return the program with bounds of the input and of its increment, whose unit is `scale`, and soft limits."""
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
