"""Structure of a linear system: invariant zeros, and ranks of observability and controllability.

A zero is a z at which [A - zI, B; C, D] has a lower rank than at almost every other z.  Zeros at infinity are removed
first by orthogonal transformations, until D is square and regular.  As eigenvalues of the whole pencil they would be
numbers of the order of 1e16^(1/d) for a relative degree d, which cannot be distinguished from finite zeros.

Source  Emami-Naeini and Van Dooren, Automatica 18 (1982).
Limit   D square and regular: the eigenvalues of A - B D^-1 C.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float

from rmpc_bench.numerics.stability import balanced
from rmpc_bench.types import Array

SMALL = 10.0 * float(np.finfo(float).eps)
"""Singular values below this number times the size and the norm of the system count as 0."""

System = tuple[Array, Array, Array, Array]


def zeros(
    A: Float[Array, "n n"], B: Float[Array, "n m"], C: Float[Array, "p n"], D: Float[Array, "p m"] | None = None
) -> Complex[Array, " zeros"]:
    """Return the finite zeros in any order, including uncontrollable or unobservable modes that lower the rank."""
    from scipy.linalg import eigvals

    system = _scaled(A, B, C, np.zeros((len(C), B.shape[1])) if D is None else D)
    tol = SMALL * sum(np.shape(system[3]) + np.shape(A)) * float(np.linalg.norm(np.block(_blocks(system))))
    A, B, C, D = _dual(_without_infinite(_dual(_without_infinite(system, tol)), tol))
    n, outputs = len(A), np.hstack([C, D])
    if n == 0:
        return np.empty(0, dtype=complex)
    # Basis (n + r, n) of the states and inputs with output zero.
    W = np.linalg.svd(outputs)[2][len(outputs) :].T
    return eigvals(np.hstack([A, B]) @ W, W[:n]).astype(complex)


def _without_infinite(system: System, tol: float) -> System:
    """Remove zeros at infinity until D has full row rank."""
    # Outputs without direct feedthrough are functions of the state. If they are zero, some directions of the state are
    # zero; the next value of these directions is the new output.
    A, B, C, D = system
    while True:
        U, rank = _range(D, tol)
        C, D = U.T @ C, (U.T @ D)[:rank]
        V, fixed = _range(C[rank:].T, tol)
        A, B, C = V.T @ A @ V, V.T @ B, C[:rank] @ V
        if fixed == 0:
            return A, B, C, D
        C, D = np.vstack([C[:, fixed:], A[:fixed, fixed:]]), np.vstack([D, B[:fixed]])
        A, B = A[fixed:, fixed:], B[fixed:]


def _range(M: Array, tol: float) -> tuple[Array, int]:
    """Return an orthogonal matrix whose first columns span the range of M, and the rank of M."""
    U, s, _ = np.linalg.svd(M)
    return U, int((s > tol).sum())


def _dual(system: System) -> System:
    A, B, C, D = system
    return A.T, C.T, B.T, D.T


def _scaled(A: Array, B: Array, C: Array, D: Array) -> System:
    """Scale states, inputs and outputs so that A, B and C have similar norms; this does not change the zeros."""
    A, B, C = balanced(A, B, C)
    size = float(np.linalg.norm(A)) or 1.0
    b, c = (size / (float(np.linalg.norm(M)) or size) for M in (B, C))
    return A, b * B, c * C, b * c * D


def _blocks(system: System) -> list[list[Array]]:
    A, B, C, D = system
    return [[A, B], [C, D]]


RANK = 1e-9
"""Singular values below this, relative to the largest one, count as 0."""


def observable_states(A: Float[Array, "n n"], C: Float[Array, "ny n"]) -> int:
    """Return the rank of [C; C A; C A^2; ..], the number of observable states."""
    scale = float(np.abs(A).max(initial=0.0)) or 1.0
    rows = [C]
    for _ in range(len(A) - 1):
        rows.append(rows[-1] @ A / scale)
    # Each output is divided by its size, so that no output is lost beside another one.
    stacked = np.vstack(rows)
    length = np.linalg.norm(stacked, axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(stacked / np.where(length > 0.0, length, 1.0), rtol=RANK))


def controllable_states(A: Float[Array, "n n"], B: Float[Array, "n nu"]) -> int:
    """Return the rank of [B, A B, A^2 B, ..], the number of controllable states."""
    return observable_states(A.T, B.T)
