"""Models whose matrices depend on the state: they are evaluated at the latest estimate, one pair (A, B) per run.

Model   x(k+1) = A(x(k)) x(k) + B(x(k)) u(k) + w(k),  y(k) = C x(k) + v(k); A and B are constant over a sample.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, DesignError, Model, attribute


class Pair(NamedTuple):
    """State and input matrices of one sample."""

    A: Float[Array, "runs nx nx"]
    B: Float[Array, "runs nx nu"]


class StateDependentModel(Model):
    """Base class of models with another pair of matrices at every state.

    A subclass gives `nx`, `nu`, `ny`, `Q_w`, `R_v`, `C` and the method `at_state`, and `R_v_varies` and `R_v_at` if the
    covariance of the measurement noise depends on k.
    """

    @attribute
    def C(self) -> Float[Array, "ny nx"]:
        """Output matrix."""
        raise NotImplementedError("C")

    def R_v_at(self, k: int, /) -> Float[Array, "ny ny"]:
        """Covariance of the measurement noise at k; `R_v` by default."""
        return self.R_v

    @attribute
    def largest(self) -> float:
        """Largest magnitude of a coordinate of an estimate that has a meaning."""
        return np.inf

    def at(self, k: int, /) -> Any:
        """Refuse: the matrices depend on the state, not on k alone.

        Raises
        ------
        DesignError
            Always.
        """
        raise DesignError(
            "the model depends on the state: choose a method that linearises at the estimate, such as kalman or gpc",
            "kind",
        )

    def at_state(self, x: Float[Array, "runs nx"]) -> Pair:
        """Sample the model with its matrices frozen at a state of every run."""
        raise NotImplementedError("at_state")


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
