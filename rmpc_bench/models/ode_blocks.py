"""Blocks of runs as the functions of a differential equation take them: axis 0 is the state and axis 1 the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.numerics.halving import Slopes
from rmpc_bench.numerics.integration import Slope
from rmpc_bench.types import Array, Ode, Parameters

WIDTH = 8
"""A block is filled up to a multiple of this many runs.  Sums and products of matrices take another path for a single
run, with other last bits than within a block."""


def padded(each: Float[Array, "runs n"]) -> Float[Array, "n width"]:
    """Return runs as columns, and the last one again until there is a multiple of `WIDTH`."""
    return np.ascontiguousarray(each[filled(len(each))].T)


def filled(n: int) -> Int[Array, " width"]:
    """Return the rows 0 to n - 1, and the last one again until there is a multiple of `WIDTH`."""
    return np.minimum(np.arange(n + -n % WIDTH), n - 1)


def rows(names: Mapping[str, float], columns: Float[Array, "n_parameters width"]) -> Parameters:
    """Parameters by name, a row over the runs each, which a user's function cannot write into."""
    columns.flags.writeable = False
    return Parameters(dict(zip(names, columns, strict=True)))


def slopes(
    ode: Ode,
    u: Float[Array, "runs nu"],
    numbers: Float[Array, "runs n_parameters"],
    single: Slopes | None = None,
    undefined: tuple[type[Exception], ...] = (),
) -> Slopes:
    """Return rhs for the chosen runs of a block; where it raises what is `undefined`, `single` is asked instead."""

    def of(runs: Int[Array, " columns"]) -> Slope:
        n, fill = len(runs), filled(len(runs))
        inputs, p = padded(u[runs]), rows(ode.nominal, padded(numbers[runs]))

        def slope(t: float, x: Array) -> Array:
            try:
                return ode.slope(t, x if len(fill) == n else x[:, fill], inputs, p)[:, :n]
            except undefined:
                assert single is not None
                return single(runs)(t, x)

        return slope

    return of


def alone(call: Callable[[float, Array, Array], Array], u: Float[Array, "runs nu"], errors: list[Exception]) -> Slopes:
    """Return rhs for the chosen runs, called one by one: NaN where it raises an error, the last of which is kept.

    A long step may ask it outside of its domain, where a shorter one does not.
    """

    def of(runs: Int[Array, " columns"]) -> Slope:
        def slope(t: float, x: Array) -> Array:
            found = np.full(x.shape, np.nan)
            for j, run in enumerate(runs):
                # At what is not a number functions such as math.sin raise an exception.
                if np.isfinite(x[:, j]).all():
                    try:
                        found[:, j] = call(t, x[:, j], u[run])
                    # The function is the user's: it may raise anything.
                    except Exception as error:
                        errors[:] = [error]
            return found

        return slope

    return of
