"""Steady states of a linear model, and linear-quadratic gains with integrals of the output.

Model   x(k+1) = A x(k) + B u(k) + f,  z(k) = C x(k).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array

RELATIVE_RANK = 1e-12
"""Singular values below this part of the largest one count as 0; the rows and columns have similar sizes."""


class Rank(NamedTuple):
    """Rank of [A - I, B; C, D], and the one with which every z has a steady state."""

    found: int
    needed: int


class IntegralGain(NamedTuple):
    """u = -K_x x - K_q q of the least sum of x' Q_x x + q' Q_i q + u' R_u u, with q(k+1) = q + C x + D u."""

    K_x: Float[Array, "nu nx"]
    K_q: Float[Array, "nu nz"]
    P: Float[Array, "n n"]  # the least sum from [x; q] is [x; q]' P [x; q]


def steady_rank(A: Float[Array, "nx nx"], B: Float[Array, "nx nu"], C: Float[Array, "nz nx"], D: Any = 0.0) -> Rank:
    """Return the rank of the equations of a steady state.

    It is too small for more outputs than inputs, and where the model from u to z has a zero at 1.
    """
    M = _equations(A, B, C, D)
    # Powers of the units of states, inputs and outputs would decide on a rank without this.
    for _ in range(3):
        M = M / _largest(M, 1)
        M = M / _largest(M, 0)
    sizes = np.linalg.svd(M, compute_uv=False)
    return Rank(int((sizes > RELATIVE_RANK * sizes[0]).sum()), len(M))


def _largest(M: Array, axis: int) -> Array:
    """Largest moduli along an axis, 1 where all are 0."""
    sizes = np.abs(M).max(axis=axis, keepdims=True)
    return np.where(sizes > 0.0, sizes, 1.0)


def steady_map(
    A: Float[Array, "nx nx"], B: Float[Array, "nx nu"], C: Float[Array, "nz nx"], R_u: Array, D: Any = 0.0
) -> Float[Array, "nx+nu nx+nz"]:
    """Return T of the steady state [x; u] = T [f; z]: of all with the given z, the one with the least u' R_u u.

    The rank of the equations must be full, see `steady_rank`.
    """
    nx, nu = B.shape
    M = _equations(A, B, C, D)
    signs = np.r_[-np.ones(nx), np.ones(len(C))]  # (A - I) x + B u = -f,  C x + D u = z
    if M.shape[0] == M.shape[1]:
        return np.linalg.solve(M, np.diag(signs))
    one = np.linalg.pinv(M) * signs
    free = np.linalg.svd(M)[2][len(M) :].T
    root = np.linalg.cholesky(R_u).T
    return one - free @ np.linalg.pinv(root @ free[nx:]) @ (root @ one[nx:])


def _equations(A: Array, B: Array, C: Array, D: Any) -> Array:
    """Return [A - I, B; C, D]."""
    return np.block([[A - np.eye(len(A)), B], [C, np.broadcast_to(D, (len(C), B.shape[1]))]])


def integral_gain(
    A: Float[Array, "nx nx"],
    B: Float[Array, "nx nu"],
    C: Float[Array, "nz nx"],
    Q_x: Float[Array, "nx nx"],
    Q_i: Float[Array, "nz nz"],
    R_u: Float[Array, "nu nu"],
    D: Any = 0.0,
) -> IntegralGain:
    """Return the stationary gain of the model augmented by the sums q of z; C without rows gives none."""
    # Imported here because of its cost.
    from scipy.linalg import block_diag, solve_discrete_are

    (nx, nu), nz = B.shape, len(C)
    augmented = np.block([[A, np.zeros((nx, nz))], [C, np.eye(nz)]])
    driven = np.vstack([B, np.broadcast_to(D, (nz, nu))])
    P = solve_discrete_are(augmented, driven, block_diag(Q_x, Q_i) if nz else Q_x, R_u)
    K = np.linalg.solve(R_u + driven.T @ P @ driven, driven.T @ P @ augmented)
    radius = np.abs(np.linalg.eigvals(augmented - driven @ K)).max()
    # Negated, so that NaN counts as unstable.
    if not radius < 1.0:
        raise np.linalg.LinAlgError(f"the spectral radius of the controlled model is {radius:.6g}")
    return IntegralGain(K[:, :nx], K[:, nx:], P)
