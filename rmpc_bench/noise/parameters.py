"""Vectors, matrices and roots of covariances from the keys of a noise law, with errors that name the key."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_covariance, as_vector, psd_sqrt
from rmpc_bench.types import Array, DesignError, Matrix

Share: TypeAlias = Annotated[float, Ge(0), Le(1)]
"""A probability."""


def spread_root(
    n: int, std: float | list[float] | None, cov: Matrix | Array | None, names: tuple[str, str] = ("std", "cov")
) -> Float[Array, "n n"]:
    """Root of a covariance that is given by standard deviations, one or n, or as `matrix` expands it.

    Raises a DesignError, with the keys, if both or none are given, or a size does not fit.
    """
    if (std is None) == (cov is None):
        raise DesignError(f"give either {names[0]} or {names[1]}")
    if std is not None:
        return np.diag(as_vector(std, n, names[0]))
    assert cov is not None
    return psd_sqrt(as_covariance(cov, n, names[1]))
