"""Least-squares tracking over a horizon: the first input, by a square-root recursion.

Problem  minimise over u(0..N-1) the sum over j = 1..N of |Q_yw (C x(j) - w(j))|^2 + |Q_u u(j-1)|^2 of
         x(j+1) = A x(j) + B u(j) + f, x(0) = x.  Q_yw and Q_u are roots of weights.
Solution Stacked over the horizon this is an over-determined system in all inputs, which a QR factorisation solves.
         A recursion from the last stage to the first avoids its zeros.  The minimal cost to go is |S x(j) - s|^2 plus a
         constant.  Each stage reduces [S, s] and Q_yw [C, w(j)] to as many rows as states, inserts
         x(j) = A x + B u + f, and eliminates u from [Q_u, 0, 0; S B, S A, s - S f].  It uses Householder reflections
         only, so that condition numbers are not squared.
Source   belda2017, (10)-(15); the order of elimination is an addition.
Cost     Linear in N: about 1200 multiplications per stage for six states, four inputs and three outputs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_compiled
from rmpc_bench.types import Array

SMALLEST = 1e-13
"""Pivot relative to the largest of its stage that counts as 0, because of the rounding of the factorisation."""


class Path(NamedTuple):
    """The solution of every run over the horizon; NaN if the cost does not determine the inputs."""

    U: Float[Array, "runs N nu"]
    """Inputs u(0)..u(N-1)."""
    X: Float[Array, "runs N nx"]
    """States x(1)..x(N)."""
    loss: Float[Array, " runs"]
    """Minimal costs."""


class TrackingLaw(NamedTuple):
    """The solution as a linear function: u(0) = K_w w - K_x x + u_0, minimal cost |E_w w - E_x x + e_0|^2."""

    K_x: Float[Array, "nu nx"]
    K_w: Float[Array, "nu known"]
    """Gain of the desired outputs w(1)..w(N), stacked."""
    u_0: Float[Array, " nu"]
    E_x: Float[Array, "lost nx"]
    E_w: Float[Array, "lost known"]
    e_0: Float[Array, " lost"]


def gains(
    A: Float[Array, "nx nx"],
    B: Float[Array, "nx nu"],
    f: Float[Array, " nx"],
    C: Float[Array, "ny nx"],
    Q_yw: Float[Array, "ny ny"],
    Q_u: Float[Array, "nu nu"],
    N: int,
) -> TrackingLaw:
    """Solve for every state and every reference at once, for a constant model and constant weights.

    Parameters
    ----------
    A, B, f, C : model
    Q_yw, Q_u : roots of the weights
    N : horizon [samples]

    Raises
    ------
    ValueError
        If the cost does not determine the inputs.
    """
    (nx, nu), ny = B.shape, len(C)
    known = N * ny + 1  # w and 1
    S, s, lost = np.zeros((0, nx)), np.zeros((0, known)), []
    for j in range(N, 0, -1):
        w = np.eye(ny, known, (j - 1) * ny)
        S, s = np.vstack([Q_yw @ C, S]), np.vstack([Q_yw @ w, s])
        s[:, -1] -= S @ f
        stack = np.block([[Q_u, np.zeros((nu, nx + known))], [S @ B, S @ A, s]])
        R = np.linalg.qr(stack)[1]  # (14), one stage of it
        pivots = np.abs(np.diag(R[:nu]))
        if not pivots.min() > SMALLEST * pivots.max():
            raise ValueError("the cost does not determine the inputs")
        S, s = R[nu : nu + nx, nu : nu + nx], R[nu : nu + nx, nu + nx :]
        lost.append(R[nu + nx :, nu + nx :])
    first = np.linalg.solve(R[:nu, :nu], R[:nu, nu:])
    E_x, e = np.vstack([S, *(np.zeros((len(part), nx)) for part in lost)]), np.vstack([s, *lost])
    return TrackingLaw(first[:, :nx], first[:, nx:-1], first[:, -1], E_x, e[:, :-1], e[:, -1])


def track(
    A: Float[Array, "models nx nx"],
    B: Float[Array, "models nx nu"],
    f: Float[Array, " nx"],
    C: Float[Array, "ny nx"],
    Q_yw: Float[Array, "weights ny ny"],
    R_u: Float[Array, "nu nu"],
    w: Float[Array, "N ny"],
    x: Float[Array, "runs nx"],
) -> tuple[Float[Array, "runs nu"], Float[Array, " runs"]]:
    """Return the first inputs and the minimal costs of many runs; inputs are NaN if the cost does not determine them.

    Parameters
    ----------
    A, B : of every run, or one for all
    f, C : rest of the model
    Q_yw : roots of the weights of every run, or one for all
    R_u : upper triangular root of the inputs' weight, R_u' R_u = Q_u' Q_u
    w : desired outputs at the samples 1..N
    x : states
    """
    from rmpc_bench.numerics.tracking_kernel import tracking_kernel

    A, B, f, C, Q_yw, R_u, w, x = (as_compiled(each) for each in (A, B, f, C, Q_yw, R_u, w, x))
    u, loss = np.empty((len(x), B.shape[2])), np.empty(len(x))
    tracking_kernel(A, B, f, C, Q_yw, R_u, w, x, u, loss)
    return u, loss


def paths(
    A: Float[Array, "models nx nx"],
    B: Float[Array, "models nx nu"],
    f: Float[Array, " nx"],
    C: Float[Array, "ny nx"],
    Q_yw: Float[Array, "weights ny ny"],
    R_u: Float[Array, "nu nu"],
    w: Float[Array, "N ny"],
    x: Float[Array, "runs nx"],
) -> Path:
    """Return all inputs and the states that they lead to; parameters, first inputs and costs as in `track`."""
    from rmpc_bench.numerics.tracking_kernel import path_kernel

    A, B, f, C, Q_yw, R_u, w, x = (as_compiled(each) for each in (A, B, f, C, Q_yw, R_u, w, x))
    n_runs, N, (nx, nu) = len(x), len(w), B.shape[1:]
    path = Path(np.empty((n_runs, N, nu)), np.empty((n_runs, N, nx)), np.empty(n_runs))
    path_kernel(A, B, f, C, Q_yw, R_u, w, x, *path)
    return path
