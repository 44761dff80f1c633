"""CasADi functions of a nonlinear design model, for controllers and estimators that optimise with CasADi.

Method  The user's functions rhs and output are called with CasADi symbols.  x(k+1) takes the same steps of the
        Runge-Kutta method as f of the model with `substeps`.  Without them it takes half of the largest number of
        steps per sample in the trial runs of the plant, at most 50, or 10 where it is not known.  About half of the
        steps of error control are kept; the others estimate the error.
Limit   The functions use arithmetic and functions of NumPy that CasADi knows.  ``if x[0] > 0`` is an error for a
        symbol; ``math.sin`` of a symbol is NaN without an error.  Therefore the numbers are compared with the model's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from rmpc_bench.adapters.casadi_calls import reason
from rmpc_bench.extras import library
from rmpc_bench.models.agreement import difference
from rmpc_bench.models.dynamics import LinearDynamics, OdeDynamics
from rmpc_bench.models.nonlinear import NonlinearModel
from rmpc_bench.numerics.integration import EDGE
from rmpc_bench.types import DesignError

EQUAL_STEPS = 10
"""Steps per sample where the plant has no trial runs."""
WAY_OUT = "use arithmetic and functions of NumPy, such as np.where for `if` and np.sin for math.sin"


def step_function(model: NonlinearModel) -> Any:
    """Return x(k+1) of a nonlinear design model as ``casadi.Function(x, u)``; (x, u, k) if rhs depends on the time."""
    dynamics, Ts = model.dynamics, model.Ts
    if isinstance(dynamics, LinearDynamics):
        return traced(model, "f", lambda x, u: x + (dynamics.A @ x + dynamics.B @ u - x), ("x", "u"))
    assert isinstance(dynamics, OdeDynamics), "there are no other plants as functions"
    ode, p = dynamics.ode, dynamics.ode.p
    # A graph has a fixed number of steps.
    model = replace(model, substeps=model.substeps or ode.equal_steps or EQUAL_STEPS)
    n, h = model.substeps, Ts / model.substeps

    def slope(t: Any, x: Any, u: Any) -> Any:
        return entries(ode.rhs(t, x, u, p) if ode.timed else ode.rhs(x, u, p))

    def step(x: Any, u: Any, k: Any = (0,)) -> Any:
        if ode.discrete:
            return slope(k[0] * Ts, x, u)
        for j in range(n):
            first, middle, last = ((k[0] + part) * Ts for part in (max(j / n, EDGE), (j + 0.5) / n, (j + 1) / n))
            last = (k[0] + 1 - EDGE) * Ts if j == n - 1 else last
            k1 = slope(first, x, u)
            k2 = slope(middle, x + h / 2 * k1, u)
            k3 = slope(middle, x + h / 2 * k2, u)
            x = x + h / 6 * (k1 + 2 * (k2 + k3) + slope(last, x + h * k3, u))
        return x

    return traced(model, "f", step, ("x", "u", "k") if ode.timed else ("x", "u"))


def output_function(model: NonlinearModel) -> Any:
    """Return y of a nonlinear design model as ``casadi.Function(x)``."""
    dynamics = model.dynamics
    if isinstance(dynamics, LinearDynamics):
        return traced(model, "h", lambda x: dynamics.C @ x, ("x",))
    return traced(model, "h", lambda x: x if model.output is None else model.output(x, model.p), ("x",))


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
    """Return a function called with symbols as `casadi.Function`; its values are compared with those of the model."""
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
