"""Condensed prediction: the outputs of a horizon as linear functions of the state and of the input moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import Array


class Prediction(NamedTuple):
    """Y = Psi x + Upsilon u_previous + Theta dU for y(k+1)..y(k+Hp), stacked: Hp ny rows, Hu nu moves."""

    Psi: Float[Array, "rows nx"]
    Upsilon: Float[Array, "rows nu"]
    Theta: Float[Array, "rows moves"]


def predict_moves(model: LinearModel, Hp: int, Hu: int) -> Prediction:
    """Stack the predictions for ``Hu`` input moves, after which the input is held.

    Parameters
    ----------
    model : prediction model
    Hp, Hu : horizons of prediction and of control [samples], Hu <= Hp
    """
    nx, nu, ny = model.nx, model.nu, model.ny
    free = [np.eye(nx)]
    held = [np.zeros((nx, nu))]  # response of the state to a unit step of the input
    for _ in range(Hp):
        free.append(model.A @ free[-1])
        held.append(model.A @ held[-1] + model.B)
    step = [model.C @ response for response in held]
    Theta = np.zeros((Hp * ny, Hu * nu))
    for j in range(Hp):
        for move in range(min(j + 1, Hu)):
            Theta[j * ny : (j + 1) * ny, move * nu : (move + 1) * nu] = step[j + 1 - move]
    return Prediction(np.vstack([model.C @ power for power in free[1:]]), np.vstack(step[1:]), Theta)
