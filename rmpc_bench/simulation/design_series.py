"""Series of a design as arrays: what an estimator reports of itself over k, such as gains and covariances."""

from __future__ import annotations

import numpy as np

from rmpc_bench.types import Array, DesignError, Method


def design_series(method: Method) -> dict[str, Array]:
    """Return the series of the estimator of a method, axis 0 = k.

    With disturbances in the design model, P and M are those of x, and P_d and M_d those of d.

    Parameters
    ----------
    method : the pair

    Raises
    ------
    DesignError
        If a series is not an array of numbers with an axis of time.
    """
    found: dict[str, Array] = {}
    for name, values in method.estimator.series().items():
        try:
            array = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            raise DesignError(f"`series` returns something else than numbers for {name!r}") from None
        if array.ndim == 0:
            raise DesignError(f"`series` returns a number for {name!r}; axis 0 must be the time index k")
        found[str(name)] = array
    nd = method.n_disturbances
    for name in ("P", "M"):
        if nd and name in found:
            both = found[name]
            found |= {name: both[:, :-nd, :-nd], f"{name}_d": both[:, -nd:, -nd:]}
    return found
