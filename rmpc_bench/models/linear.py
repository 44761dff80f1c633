"""The linear model x(k+1) = A x(k) + B u(k) + w(k), y(k) = C x(k) + v(k)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_covariance
from rmpc_bench.types import Array, DesignError


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A time-invariant linear model with independent white noises.

    Parameters
    ----------
    A : (nx, nx) state matrix
    B : (nx, nu) input matrix
    C : (ny, nx) output matrix
    Q_w : (nx, nx) covariance of the process noise w, positive semidefinite
    R_v : (ny, ny) covariance of the measurement noise v, positive semidefinite

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

    def __post_init__(self) -> None:
        """Turn lists into arrays and check what a design would only trip over later."""
        for name in ("A", "B", "C"):
            object.__setattr__(self, name, np.atleast_2d(np.asarray(getattr(self, name), dtype=float)))
        nx, ny = len(self.A), len(self.C)
        for name, wanted in (("A", (nx, nx)), ("B", (nx, self.B.shape[1])), ("C", (ny, nx))):
            if getattr(self, name).shape != wanted:
                raise DesignError(f"{name} has shape {getattr(self, name).shape}; {wanted} fits the other matrices")
        for name, n in (("Q_w", nx), ("R_v", ny)):
            try:
                object.__setattr__(self, name, as_covariance(getattr(self, name), n))
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
