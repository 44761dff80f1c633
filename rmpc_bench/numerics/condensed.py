"""A tracking problem in all inputs of a horizon: states as functions of the inputs, and unknowns of unit curvature.

Problem  The sum over j = 1..N of |Q_yw (C x(j) - w(j))|^2 + |Q_u u(j-1)|^2 of tracking.py, whose recursion solves it
         without limits.  Limits of inputs and states need it as a function of U = [u(0); ..; u(N-1)].
Unknowns QR of the stacked residuals, [Q_yw Theta; Q_u] = Q R, gives the cost |R (U - U*)|^2 plus the minimal one.  With
         V = g R U the problem is to minimise |V - V*|^2: no matrix is squared, and the Hessian is the identity.  A row
         a' U of unit s becomes a' R^-1 V / (g s).  The factor g makes the longest of these rows 1 long: a violation of
         a tolerance of the solver is then at most as large in units of the row, whatever the size of the cost is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array


class Responses(NamedTuple):
    """States x(j) = Psi_j x + held_j + sum over i of Theta_ji u(i), j = 1..N."""

    Psi: Float[Array, "N nx nx"]
    held: Float[Array, "N nx"]
    """What the constant part of the model adds."""
    Theta: Float[Array, "N nx N nu"]


def responses(A: Float[Array, "nx nx"], B: Float[Array, "nx nu"], f: Float[Array, " nx"], N: int) -> Responses:
    """Return the states of a horizon as functions of the first state and of the inputs.

    Parameters
    ----------
    A, B, f : model, constant over the horizon
    N : horizon [samples]
    """
    nx, nu = B.shape
    Psi, held, pulse = np.empty((N, nx, nx)), np.empty((N, nx)), np.empty((N, nx, nu))
    power, total = np.eye(nx), np.zeros(nx)
    for j in range(N):
        pulse[j] = power @ B
        power, total = A @ power, A @ total + f
        Psi[j], held[j] = power, total
    Theta = np.zeros((N, nx, N, nu))
    for delay in range(N):
        Theta[np.arange(delay, N), :, np.arange(N - delay)] = pulse[delay]
    return Responses(Psi, held, Theta)


def residuals(
    Theta: Float[Array, "N nx N nu"], C: Float[Array, "ny nx"], Q_yw: Float[Array, "ny ny"], R_u: Float[Array, "nu nu"]
) -> Float[Array, "rows inputs"]:
    """Return the matrix [Q_yw C Theta; R_u] of the stacked residuals, outputs first.

    Parameters
    ----------
    Theta : responses of the states to the inputs
    C : output matrix
    Q_yw, R_u : roots of the weights
    """
    N, nu = Theta.shape[2:]
    outputs = np.einsum("ij,njmu->nimu", Q_yw @ C, Theta).reshape(-1, N * nu)
    return np.vstack([outputs, np.kron(np.eye(N), R_u)])


def unit_rows(
    a: Float[Array, "rows inputs"], R: Float[Array, "inputs inputs"]
) -> tuple[Float[Array, "rows inputs"], Float[Array, "inputs inputs"], float]:
    """Return the rows of V = g R U, the matrix of U = R^-1 V / g, and g.

    Parameters
    ----------
    a : rows of U, divided by their units
    R : upper triangular root of the cost
    """
    R_inverse = np.linalg.solve(R, np.eye(len(R)))
    rows = a @ R_inverse
    # Without an effect of the inputs on any row, every unit will do.
    g = float(np.sqrt((rows * rows).sum(axis=1).max(initial=0.0))) or 1.0
    return rows / g, R_inverse / g, g
