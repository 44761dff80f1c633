"""The user's functions of NumPy, called with CasADi symbols."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from rmpc_bench.extras import library
from rmpc_bench.models.dynamics import OUTSIDE_DOMAIN
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.types import Array, DesignError

TRIALS = 20
"""States and inputs at which a function is compared with that of the model."""
AGREES = 1e-9
"""Largest difference between both, relative to the largest state: rounding of two implementations of sin or exp."""
WAY_OUT = "use arithmetic and functions of NumPy, such as np.where for `if` and np.sin for math.sin"


@contextmanager
def numpy_functions() -> Iterator[None]:
    """Let functions of NumPy take and return CasADi symbols; since CasADi 3.8 they warn of it otherwise."""
    options = library("casadi").GlobalOptions
    if not hasattr(options, "setNumpyMode"):
        yield
        return
    before = options.getNumpyMode()
    options.setNumpyMode(-1)
    try:
        yield
    finally:
        options.setNumpyMode(before)


def entries(values: Any) -> Any:
    """Return what a function has returned as an array of its entries; a CasADi matrix is taken column by column."""
    found = values.elements() if hasattr(values, "elements") else np.ravel(np.array(values, dtype=object))
    made = np.empty(len(found), dtype=object)
    made[:] = found
    return made


def traced(model: NonlinearModel, name: str, function: Callable[..., Any], arguments: tuple[str, ...]) -> Any:
    """Call a function with symbols and return it as ``casadi.Function``.

    Parameters
    ----------
    model : the design model, whose function of this name has the same values
    name : `f` or `h`
    function : called with an array of symbols for every argument
    arguments : `x`, `u` and `k`

    Raises
    ------
    DesignError
        If it cannot be called with symbols, or gives other numbers than the model.
    """
    casadi, sizes = library("casadi"), {"x": model.nx, "u": model.nu, "k": 1}
    symbols = [casadi.SX.sym(each, sizes[each]) for each in arguments]
    users = "rhs" if name == "f" else "output"
    try:
        with numpy_functions():
            found = entries(function(*(entries(each) for each in symbols)))
            result = casadi.vcat([each if hasattr(each, "elements") else float(each) for each in found])
            made = casadi.Function(name, symbols, [result], [*arguments], ["x_next" if name == "f" else "y"])
    # The function is the user's: it may raise anything.
    except Exception as error:
        # CasADi begins its messages with a place in its own source.
        reason = re.sub(r"^\S+\.[ch]pp:\d+: ", "", str(error).strip().rpartition("\n")[2])
        text = f"{users} cannot be called with CasADi symbols ({type(error).__name__}: {reason}); {WAY_OUT}"
        raise DesignError(text) from error
    _compare(model, made, getattr(model, name), users, arguments)
    return made


def _compare(model: NonlinearModel, made: Any, expected: Any, users: str, arguments: tuple[str, ...]) -> None:
    """Compare with the function of the model at the operating point and at random numbers within the bounds."""
    rng, names = np.random.Generator(np.random.PCG64(5)), model.dynamics.names
    for trial in range(TRIALS):
        size = 10.0 ** rng.uniform(-2.0, 1.0)
        x, u = size * np.abs(rng.standard_normal(model.nx)), rng.standard_normal(model.nu)
        if trial == 0 and model.operating_point is not None:
            x, u = model.operating_point.x, model.operating_point.u
        numbers = {"x": np.clip(x, *model.limits), "u": np.clip(u, *model.dynamics.limits(names.inputs)), "k": trial}
        given = [numbers[each] for each in arguments]
        try:
            with np.errstate(all="ignore"):
                wanted: Array = expected(*given)
        except OUTSIDE_DOMAIN:
            continue
        found = np.ravel(made(*given).full())
        largest = max(float(np.abs(x).max()), float(np.abs(wanted).max()))
        if np.isfinite(wanted).all() and not (np.abs(found - wanted) <= AGREES * largest).all():
            values = f"{found.tolist()} instead of {wanted.tolist()} at x = {numbers['x'].tolist()}"
            raise DesignError(f"{users} called with CasADi symbols gives {values}; {WAY_OUT}")
