"""Condensed prediction, for oracles: the outputs of a horizon as functions of the state and of the input moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import Array


class Prediction(NamedTuple):
    """Y = Psi x + Upsilon u_previous + Theta dU for the stacked y(k+1)..y(k+Hp): Hp ny rows, Hu nu moves."""

    Psi: Float[Array, "rows nx"]
    Upsilon: Float[Array, "rows nu"]
    Theta: Float[Array, "rows moves"]


def predict_moves(model: LinearModel, Hp: int, Hu: int) -> Prediction:
    """Stack the predictions for ``Hu`` input moves, after which the input is constant.

    Parameters
    ----------
    model : prediction model
    Hp, Hu : horizons of prediction and of control [samples], Hu <= Hp
    """
    free, step = _responses(model, Hp)
    Theta = np.zeros((Hp * model.ny, Hu * model.nu))
    for move in range(Hu):
        _fill(Theta, move, step, model)
    return Prediction(np.vstack(free[1:]), np.vstack(step[1:]), Theta)


def predict_inputs(model: LinearModel, Hp: int, Hu: int) -> tuple[Float[Array, "rows nx"], Float[Array, "rows inputs"]]:
    """Stack the predictions Y = Psi x + Theta U for ``Hu`` inputs, the last of which is constant after Hu.

    The columns of Theta are shifted impulse responses, CB, CAB, ..; the last ones are step responses.
    """
    free, step = _responses(model, Hp)
    impulse = [np.zeros_like(step[0]), *(model.C @ power @ model.B for power in _powers(model, Hp)[:-1])]
    Theta = np.zeros((Hp * model.ny, Hu * model.nu))
    for move in range(Hu):
        _fill(Theta, move, step if move == Hu - 1 else impulse, model)
    return np.vstack(free[1:]), Theta


def _powers(model: LinearModel, Hp: int) -> list[Array]:
    powers = [np.eye(model.nx)]
    for _ in range(Hp):
        powers.append(model.A @ powers[-1])
    return powers


def _responses(model: LinearModel, Hp: int) -> tuple[list[Array], list[Array]]:
    """Return the outputs after 0..Hp samples: responses to the initial state and to a unit step of the input."""
    held = [np.zeros((model.nx, model.nu))]
    for _ in range(Hp):
        held.append(model.A @ held[-1] + model.B)
    return [model.C @ power for power in _powers(model, Hp)], [model.C @ response for response in held]


def _fill(Theta: Float[Array, "rows columns"], move: int, response: list[Array], model: LinearModel) -> None:
    """Write the response to input number ``move`` into its columns."""
    column = slice(move * model.nu, (move + 1) * model.nu)
    for j in range(move, len(response) - 1):
        Theta[j * model.ny : (j + 1) * model.ny, column] = response[j + 1 - move]
