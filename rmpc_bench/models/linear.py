"""The linear model x(k+1) = A x(k) + B u(k) + f0 + w(k), y(k) = C x(k) + d0 + v(k)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_covariance
from rmpc_bench.types import Array, DesignError, Matrix, Model

Rows = Array | list[list[float]]
Covariance = Array | Matrix


@dataclass(frozen=True, eq=False, init=False)
class LinearModel(Model):
    """A linear model with white noises at one k, or at every k if nothing varies.

    Parameters
    ----------
    A : (nx, nx) state matrix
    B : (nx, nu) input matrix
    C : (ny, nx) output matrix
    Q_w : (nx, nx) covariance of the process noise w, positive semidefinite; a number or a diagonal is expanded
    R_v : (ny, ny) covariance of the measurement noise v, given in the same ways
    S_wv : (nx, ny) cross-covariance E w v', zero by default
    f0 : (nx,) constant part of x(k+1), zero by default
    d0 : (ny,) constant part of y(k), zero by default

    Raises
    ------
    DesignError
        If the shapes are inconsistent, or a covariance is not positive semidefinite.
    """

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    Q_w: Float[Array, "nx nx"]
    R_v: Float[Array, "ny ny"]
    S_wv: Float[Array, "nx ny"]
    f0: Float[Array, " nx"]
    d0: Float[Array, " ny"]

    is_linear_model = True

    def __init__(
        self,
        A: Rows,
        B: Rows,
        C: Rows,
        Q_w: Covariance,
        R_v: Covariance,
        *,
        S_wv: Rows | None = None,
        f0: Rows | None = None,
        d0: Rows | None = None,
    ) -> None:
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
        for name, value, shape in (("S_wv", S_wv, (nx, ny)), ("f0", f0, (nx,)), ("d0", d0, (ny,))):
            array = np.zeros(shape) if value is None else np.array(value, dtype=float)
            if array.shape != shape:
                raise DesignError(f"{name} has shape {array.shape}; {shape} fits the other matrices")
            object.__setattr__(self, name, array)

    def at(self, k: int) -> LinearModel:
        """Return the model at k, which is the same at every k."""
        return self

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
