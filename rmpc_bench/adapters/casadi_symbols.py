"""The user's functions of NumPy, called with CasADi symbols."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from rmpc_bench.adapters.casadi_block import reason
from rmpc_bench.extras import library
from rmpc_bench.models.agreement import difference
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.types import DesignError

WAY_OUT = "use arithmetic and functions of NumPy, such as np.where for `if` and np.sin for math.sin"


@contextmanager
def numpy_functions() -> Iterator[None]:
    """Let functions of NumPy take and return CasADi symbols; since CasADi 3.8 they warn of it otherwise."""
    options = library("casadi").GlobalOptions
    before = options.getNumpyMode() if hasattr(options, "getNumpyMode") else None
    try:
        if before is not None:
            options.setNumpyMode(-1)
        yield
    finally:
        if before is not None:
            options.setNumpyMode(before)


def entries(values: Any) -> Any:
    """Return what a function has returned as an array of its entries; a CasADi matrix is taken column by column."""
    is_matrix = hasattr(values, "is_dense")
    found = library("casadi").vertsplit(values) if is_matrix else list(values) if np.iterable(values) else [values]
    made = np.empty(len(found), dtype=object)
    for i, each in enumerate(found):
        made[i] = each
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
            result = casadi.vcat([each if hasattr(each, "is_dense") else float(each) for each in found])
            made = casadi.Function(name, symbols, [result], [*arguments], ["x_next" if name == "f" else "y"])
    # The function is the user's: it may raise anything.
    except Exception as error:
        what = f"{type(error).__name__}: {reason(error)}"
        raise DesignError(f"{users} cannot be called with CasADi symbols ({what}); {WAY_OUT}") from error
    values = difference(model, name, lambda *given: np.ravel(made(*given).full()), arguments)
    if values:
        raise DesignError(f"{users} called with CasADi symbols gives {values}; {WAY_OUT}")
    return made
