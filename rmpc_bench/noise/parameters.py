"""Vectors, matrices and roots of covariances from the keys of a noise law, with errors that name the key."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, TypeAlias

import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Float

from rmpc_bench.numerics.linalg import as_covariance, as_matrix, as_vector, psd_sqrt
from rmpc_bench.types import Array, DesignError, Matrix

Share: TypeAlias = Annotated[float, Ge(0), Le(1)]
"""A probability."""


@contextmanager
def _naming(key: str) -> Iterator[None]:
    """Raise an error of a value as one that names its key."""
    try:
        yield
    except ValueError as error:
        raise DesignError(str(error), key) from None


def vector(name: str, value: float | list[float], n: int) -> Float[Array, " n"]:
    """Expand a number, for every coordinate, or n; raises a DesignError, with the key, if the length does not fit."""
    with _naming(name):
        return as_vector(value, n)


def matrix(name: str, value: Matrix | Array, n: int) -> Float[Array, "n n"]:
    """Expand a number (times the identity), a diagonal or a matrix.

    Raises a DesignError, with the key, if the size does not fit.
    """
    with _naming(name):
        return as_matrix(value, n)


def psd_root(name: str, value: Matrix | Array, n: int) -> Float[Array, "n n"]:
    """Symmetric root of a covariance: a number (times the identity), a diagonal or a matrix.

    Raises a DesignError, with the key, if the size does not fit or the matrix is not positive semidefinite.
    """
    with _naming(name):
        return psd_sqrt(as_covariance(value, n))


def spread_root(
    n: int,
    std: float | list[float] | None,
    cov: Matrix | Array | None,
    names: tuple[str, str] = ("std", "cov"),
) -> Float[Array, "n n"]:
    """Root of a covariance that is given by standard deviations, one or n, or as `matrix` expands it.

    Raises a DesignError, with the keys, if both or none are given, or a size does not fit.
    """
    if (std is None) == (cov is None):
        raise DesignError(f"give either {names[0]} or {names[1]}")
    if std is not None:
        return np.diag(vector(names[0], std, n))
    assert cov is not None
    return psd_root(names[1], cov, n)
