"""The quadratic program of predictive control in increments of the input.

Model   The moves are V = [du(k); ..; du(k+Hu-1)], the parameters p = [x_hat; u(k-1); d_hat] of every run, d_hat only
        with an estimated mean of the process noise, and [r(k+1); ..; r(k+Hp); 1], which all runs share.
        Y = Psi x_hat + Upsilon u(k-1) + Phi d_hat + constant + Theta V, and the same for every limited signal.
Shared  By the controller mpc, which has the law without limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.controllers.constrained import ConstrainedMoves, Rows
from rmpc_bench.controllers.limits import Bounds, SoftRows
from rmpc_bench.controllers.prediction import predict_disturbance, predict_moves
from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import Array


class IncrementCost(NamedTuple):
    """Cost |root_Q (Y - r)|^2 + |root_R V|^2."""

    Hp: int
    Hu: int
    root_Q: Float[Array, "rows rows"]
    root_R: Float[Array, "moves moves"]
    minimiser: Float[Array, "moves rows"]
    """Moves without limits for the error of the outputs without moves: V = minimiser (r - Y)."""
    scale: Float[Array, " nu"]
    """Unit of every input."""


def increment_program(
    model: LinearModel,
    cost: IncrementCost,
    u: Bounds,
    du: Bounds,
    soft: Mapping[str, SoftRows],
    *,
    uses_mean: bool,
) -> ConstrainedMoves:
    """Return the program.

    Parameters
    ----------
    model : prediction model
    cost : horizons and weights
    u, du : bounds of the input and of its increment; infinite where there are none
    soft : name -> soft limit of a signal
    uses_mean : whether the estimator estimates the mean of the process noise
    """
    Hp, Hu, nx, nu = cost.Hp, cost.Hu, model.nx, model.nu
    free, Theta = _free(model, model.C, model.d0, Hp, Hu, uses_mean=uses_mean)
    n_own, n_r = free.shape[1] - 1, Hp * model.ny
    # The outputs without moves minus the reference, for the parameters [own; r; 1].
    error = np.hstack([free[:, :n_own], -np.eye(n_r), free[:, n_own:]])
    weighted = cost.root_Q @ Theta
    H = 2.0 * (weighted.T @ weighted + cost.root_R.T @ cost.root_R)
    F = 2.0 * weighted.T @ (cost.root_Q @ error)
    scale = np.tile(cost.scale, Hu)
    applied, nothing = np.zeros((Hu * nu, n_own + n_r + 1)), np.zeros((Hu * nu, n_own + n_r + 1))
    applied[:, nx : nx + nu] = np.tile(np.eye(nu), (Hu, 1))
    sums = np.kron(np.tril(np.ones((Hu, Hu))), np.eye(nu))
    parts = [
        Rows.hard(sums, applied, np.tile(u.low, Hu), np.tile(u.high, Hu), scale),
        Rows.hard(np.eye(Hu * nu), nothing, np.tile(du.low, Hu), np.tile(du.high, Hu), scale),
    ]
    for limit in soft.values():
        (Z, constant), steps = limit.signal, limit.steps
        ahead, A = _free(model, Z, constant, steps, Hu, uses_mean=uses_mean)
        E = np.hstack([ahead[:, :n_own], np.zeros((len(ahead), n_r)), ahead[:, n_own:]])
        every = np.ones(len(A))
        low, high, unit = (np.tile(each, steps) for each in (*limit.bounds, limit.scale))
        parts.append(Rows(A, E, low, high, unit, every > 0.0, limit.linear * every, limit.quadratic * every))
    return ConstrainedMoves(H, F, -cost.minimiser @ error, Rows.stacked(parts), scale, n_own)


def _free(
    model: LinearModel, Z: Float[Array, "nz nx"], constant: Float[Array, " nz"], Hp: int, Hu: int, *, uses_mean: bool
) -> tuple[Float[Array, "rows own_and_1"], Float[Array, "rows moves"]]:
    """Return what the parameters [own; 1] and the moves add to the predictions of z = Z x + constant."""
    seen = LinearModel(model.A, model.B, Z, model.Q_w, np.eye(len(Z)), f0=model.f0, d0=constant)
    Psi, Upsilon, Theta = predict_moves(seen, Hp, Hu)
    Phi, rest = predict_disturbance(seen, Hp)
    mean = (Phi,) if uses_mean else ()
    return np.hstack([Psi, Upsilon, *mean, rest[:, None]]), Theta
