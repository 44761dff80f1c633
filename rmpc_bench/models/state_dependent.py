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


class Affine(NamedTuple):
    """A linearisation of every run: x(k+1) = A x + B u + f, y = C x + d."""

    A: Float[Array, "runs nx nx"]
    B: Float[Array, "runs nx nu"]
    f: Float[Array, "runs nx"]
    C: Float[Array, "runs ny nx"]
    d: Float[Array, "runs ny"]


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
    def largest(self) -> float | Float[Array, " nx"]:
        """Largest magnitude of a coordinate of an estimate that has a meaning, one number or one per coordinate."""
        return np.inf

    def at(self, k: int, /) -> Any:
        """Refuse: the matrices depend on the state, not on k alone."""
        raise DesignError(
            "the model depends on the state: choose what linearises at the estimate, the estimator kalman or the "
            "controller gpc",
            "kind",
        )

    def at_state(self, x: Float[Array, "runs nx"]) -> Pair:
        """Sample the model with its matrices frozen at a state of every run."""
        raise NotImplementedError("at_state")

    @attribute
    def has_offsets(self) -> bool:
        """Whether the model has constant parts and an output matrix that depend on the state: use `around`."""
        return False

    def around(self, k: int, x: Float[Array, "runs nx"], u: Float[Array, "runs nu"]) -> Affine:
        """Linearise at a state and an input of every run; only with `has_offsets`."""
        raise NotImplementedError("around")

    def advance(self, k: int, x: Float[Array, "runs nx"], u: Float[Array, "runs nu"]) -> Float[Array, "runs nx"]:
        """Return x(k+1) of the model without linearisation; only with `has_offsets`."""
        raise NotImplementedError("advance")

    def measure(self, x: Float[Array, "runs nx"]) -> Float[Array, "runs ny"]:
        """Return y of the model without linearisation; only with `has_offsets`."""
        raise NotImplementedError("measure")

    def measured(self, k: int, x: Float[Array, "runs nx"]) -> Float[Array, "runs ny"]:
        """Return y(k) of states without noise."""
        return self.measure(x) if self.has_offsets else np.einsum("ij,rj->ri", self.C, x)


def pair_at(model: Model | StateDependentModel, k: int, x: Float[Array, "runs nx"]) -> Pair:
    """Return the matrices from k to k+1 at the state of every run; a linear model has the same for all runs."""
    if isinstance(model, StateDependentModel):
        return model.at_state(x)
    now = model.at(k)
    return Pair(*(np.broadcast_to(matrix, (len(x), *matrix.shape)) for matrix in (now.A, now.B)))
