"""Models whose matrices depend on the state: they are evaluated at the latest estimate, one pair (A, B) per run.

Model   x(k+1) = A(x(k)) x(k) + B(x(k)) u(k) + w(k),  y(k) = C x(k) + v(k); A and B are constant over a sample.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import Model
from rmpc_bench.types import Array


class Pair(NamedTuple):
    """State and input matrices of one sample."""

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
    """Return the matrices from k to k+1 for every run; those of a linear model are the same for all runs.

    Parameters
    ----------
    model : linear or state-dependent model
    k : time index
    x : (runs, nx) states at which a state-dependent model is evaluated
    """
    if isinstance(model, StateDependentModel):
        return model.at_state(x)
    now = model.at(k)
    return Pair(*(np.broadcast_to(matrix, (len(x), *matrix.shape)) for matrix in (now.A, now.B)))
