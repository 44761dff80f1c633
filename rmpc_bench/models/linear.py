"""The linear model x(k+1) = A x(k) + B u(k) + w(k), y(k) = C x(k) + v(k)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_covariance
from rmpc_bench.types import Array, DesignError, Matrix

Rows = Array | list[list[float]]
Covariance = Array | Matrix


@dataclass(frozen=True, eq=False, init=False)
class LinearModel:
    """A time-invariant linear model with independent white noises.

    Parameters
    ----------
    A : (nx, nx) state matrix
    B : (nx, nu) input matrix
    C : (ny, nx) output matrix
    Q_w : (nx, nx) covariance of the process noise w, positive semidefinite; a number or a diagonal will do
    R_v : (ny, ny) covariance of the measurement noise v, likewise

    Raises
    ------
    DesignError
        If shapes do not fit together, or a covariance is not one.
    """

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    Q_w: Float[Array, "nx nx"]
    R_v: Float[Array, "ny ny"]

    def __init__(self, A: Rows, B: Rows, C: Rows, Q_w: Covariance, R_v: Covariance) -> None:
        A, B, C = (np.atleast_2d(np.array(matrix, dtype=float)) for matrix in (A, B, C))
        nx, ny = len(A), len(C)
        for name, matrix, wanted in (("A", A, (nx, nx)), ("B", B, (nx, B.shape[1])), ("C", C, (ny, nx))):
            if matrix.shape != wanted:
                raise DesignError(f"{name} has shape {matrix.shape}; {wanted} fits the other matrices")
            object.__setattr__(self, name, matrix)
        for name, cov, n in (("Q_w", Q_w, nx), ("R_v", R_v, ny)):
            try:
                object.__setattr__(self, name, as_covariance(np.array(cov, dtype=float), n))
            except ValueError as error:
                raise DesignError(f"{name}: {error}") from None

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return int(self.B.shape[1])

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.C)
