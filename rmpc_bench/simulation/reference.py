"""References: what the output is meant to follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_vector
from rmpc_bench.types import Array, DesignError


@runtime_checkable
class Reference(Protocol):
    """A signal known ahead of time."""

    def sample(self, n_samples: int) -> Float[Array, "samples ny"]:
        """Values at k = 0..n_samples - 1."""


@dataclass(frozen=True, eq=False)
class Constant:
    """The same value at all times."""

    value: Float[Array, " ny"]

    def sample(self, n_samples: int) -> Float[Array, "samples ny"]:
        """Values at k = 0..n_samples - 1."""
        return np.tile(self.value, (n_samples, 1))


def constant(ny: int, *, value: float | list[float]) -> Constant:
    """Constant reference.

    Parameters
    ----------
    ny : number of outputs
    value : a number (for every output) or one per output, in the output's unit

    Raises
    ------
    DesignError
        If the number of values does not fit.
    """
    try:
        return Constant(as_vector(value, ny))
    except ValueError as error:
        raise DesignError(str(error), "value") from None
