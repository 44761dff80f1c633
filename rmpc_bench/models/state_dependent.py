"""A model whose matrices depend on the state: it is made anew at the latest estimate, one pair of matrices per run.

Model   x(k+1) = A(x(k)) x(k) + B(x(k)) u(k) + w(k),  y(k) = C x(k) + v(k), the pair held over a sample.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import Model
from rmpc_bench.types import Array


class Pair(NamedTuple):
    """State and input matrix over one sample."""

    A: Float[Array, "runs nx nx"]
    B: Float[Array, "runs nx nu"]


@runtime_checkable
class StateDependentModel(Protocol):
    """A model that has another pair at every state."""

    @property
    def nx(self) -> int: ...  # noqa: D102 - as of every model
    @property
    def nu(self) -> int: ...  # noqa: D102
    @property
    def ny(self) -> int: ...  # noqa: D102
    @property
    def C(self) -> Float[Array, "ny nx"]: ...  # noqa: D102
    @property
    def Q_w(self) -> Float[Array, "nx nx"]: ...  # noqa: D102
    @property
    def R_v(self) -> Float[Array, "ny ny"]: ...  # noqa: D102
    @property
    def largest(self) -> float:
        """An estimate with a coordinate beyond it has no meaning."""

    def at_state(self, x: Float[Array, "runs nx"]) -> Pair:
        """Sample the model with its matrices frozen at a state of every run."""


def pair_at(model: Model | StateDependentModel, k: int, x: Float[Array, "runs nx"]) -> Pair:
    """Matrices that move the state of every run from k to k+1; a linear model has the same ones for all runs.

    Parameters
    ----------
    model : linear or state dependent
    k : time index
    x : (runs, nx) where a state-dependent model is linearised
    """
    if isinstance(model, StateDependentModel):
        return model.at_state(x)
    now = model.at(k)
    return Pair(*(np.broadcast_to(matrix, (len(x), *matrix.shape)) for matrix in (now.A, now.B)))
