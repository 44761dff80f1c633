"""Ranks of observability and controllability of a linear system."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array

RANK = 1e-9
"""Singular values below this, relative to the largest one, count as 0."""


def observable_states(A: Float[Array, "n n"], C: Float[Array, "ny n"]) -> int:
    """Return the rank of [C; C A; C A^2; ..], the number of observable states.

    Parameters
    ----------
    A, C : matrices of states that are scaled to similar sizes

    Examples
    --------
    >>> observable_states(np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0, 1.0]]))
    1
    """
    scale = float(np.abs(A).max(initial=0.0)) or 1.0
    rows = [C]
    for _ in range(len(A) - 1):
        rows.append(rows[-1] @ A / scale)
    # Each output is divided by its size, so that no output is lost beside another one.
    stacked = np.vstack(rows)
    length = np.linalg.norm(stacked, axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(stacked / np.where(length > 0.0, length, 1.0), rtol=RANK))


def controllable_states(A: Float[Array, "n n"], B: Float[Array, "n nu"]) -> int:
    """Return the rank of [B, A B, A^2 B, ..], the number of controllable states.

    Parameters
    ----------
    A, B : matrices of states that are scaled to similar sizes
    """
    return observable_states(A.T, B.T)
