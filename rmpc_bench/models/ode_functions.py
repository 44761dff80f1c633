"""Functions of a differential equation as a configuration gives them: names, units, and blocks of runs.

In a block axis 0 is the state and axis 1 the run.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.numerics.integration import Slope, Slopes
from rmpc_bench.types import Array, DesignError, Ode, Parameters

Names = int | list[str] | dict[str, str]
"""A count, a list of names, or names with their units."""


def names_of(given: Names, key: str, letter: str) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return names and units; those of a count are ``x.0``, ``x.1`` and so on, without units."""
    if isinstance(given, int):
        if given < (letter != "u"):
            raise DesignError(f"must be at least 1 (got {given})", key)
        return tuple(f"{letter}.{i}" for i in range(given)), {}
    names = [str(name) for name in given]
    if not names and letter != "u":
        raise DesignError("must name at least one", key)
    for name in names:
        if not name.isidentifier() or name in ("x", "u", "y", "u_command"):
            raise DesignError(f"{name!r} is no name: letters, digits and _, and not x, u, y or u_command", key)
    doubled = [name for i, name in enumerate(names) if name in names[:i]]
    if doubled:
        raise DesignError(f"{doubled[0]!r} is given twice", key)
    units = {name: str(unit) for name, unit in given.items() if unit} if isinstance(given, Mapping) else {}
    return tuple(names), units


def refuse_shared(states: Sequence[str], inputs: Sequence[str], key: str = "inputs") -> None:
    """Refuse an input with the name of a state: `bounds` could mean either."""
    shared = [name for name in inputs if name in states]
    if shared:
        raise DesignError(f"{shared[0]!r} is the name of a state, too; `bounds` could mean either", key)


def is_timed(rhs: Any, key: str = "ode") -> bool:
    """Whether a function takes (t, x, u, p) and not (x, u, p)."""
    n = len(_positional(rhs, key))
    if n not in (3, 4):
        raise DesignError(f"{function_name(rhs)} must take (x, u, p) or (t, x, u, p); it takes {_signature(rhs)}", key)
    return n == 4


def is_fed(output: Any, key: str = "output", *, allowed: bool = True) -> bool:
    """Whether an output function takes (x, u, p), if that is allowed, and not (x, p)."""
    names = ["x", "p"] if output is None else _positional(output, key)
    # Places decide; names in another order tell that the function expects something else there.
    if len(names) not in (2, 2 + allowed) or names[0] in ("t", "u", "p") or names[1] == ("u", "p")[len(names) - 2]:
        right = "(x, p) or (x, u, p)" if allowed else "(x, p)"
        raise DesignError(f"{function_name(output)} must take {right}; it takes {_signature(output)}", key)
    return len(names) == 3


def count(names: Names) -> int:
    """Return the number of names."""
    return names if isinstance(names, int) else len(names)


def _positional(function: Any, key: str) -> list[str]:
    """Return the arguments without a default that a function takes by position."""
    if not callable(function):
        raise DesignError(f"must be a function (got an object of type {type(function).__name__})", key)
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    given = _parameters(function).values()
    return [each.name for each in given if each.kind in kinds and each.default is inspect.Parameter.empty]


def _parameters(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}


def _signature(function: Callable[..., Any]) -> str:
    given = _parameters(function).values()
    return f"({', '.join(each.name + '=..' * (each.default is not inspect.Parameter.empty) for each in given)})"


def function_name(function: Any) -> str:
    """Name of a user's function."""
    return str(getattr(function, "__name__", type(function).__name__))


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
