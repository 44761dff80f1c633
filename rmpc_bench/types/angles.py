"""Signals with a period, such as angles: their differences are wrapped, their values are not.

Angles are given by the places of the components, such as ``{"x.0": 6.28, "y.0": 6.28}``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from rmpc_bench.types.basics import Array


def period_of(angles: Mapping[str, float], names: Sequence[str]) -> Float[Array, " n"] | None:
    """Return the periods of components, 0 of those that are no angles; None where none is.

    Examples
    --------
    >>> period_of({"theta": 360.0}, ["theta", "omega"]), period_of({"theta": 360.0}, ["omega"])
    (array([360.,   0.]), None)
    """
    periods = np.array([angles.get(name, 0.0) for name in names])
    return periods if periods.any() else None


def places(signal: str, n: int) -> list[str]:
    """Return the places of the components of a signal: ``["y.0", "y.1"]``."""
    return [f"{signal}.{i}" for i in range(n)]


def turns(z: Float[Array, "*k n"], period: Float[Array, " n"]) -> Float[Array, "*k n"]:
    """Return rint(z / p), 0 of components without a period and where z is not a number."""
    return np.nan_to_num(np.rint(z / np.where(period > 0.0, period, np.inf)), posinf=0.0, neginf=0.0)


def wrapped(z: Float[Array, "*k n"], period: Float[Array, " n"] | None) -> Float[Array, "*k n"]:
    """Return z - p rint(z / p), z itself of components without a period.

    Examples
    --------
    >>> wrapped(np.array([350.0, 350.0]), np.array([360.0, 0.0])).tolist()
    [-10.0, 350.0]
    """
    return z if period is None else z - period * turns(z, period)


def near(function: Callable[[Array], Array], x: Float[Array, " n"], period: Array | None) -> Callable[[Array], Array]:
    """Return the function with values within half a period of that at x, so that differences of it are wrapped."""
    if period is None:
        return function
    centre = function(x)
    return lambda z: centre + wrapped(function(z) - centre, period)
