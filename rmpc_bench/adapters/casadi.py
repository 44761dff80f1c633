"""CasADi functions of a nonlinear design model, for controllers and estimators that optimise with CasADi.

Method  The user's functions rhs and output are called with CasADi symbols.  x(k+1) takes the same steps of the
        Runge-Kutta method as f of the model.
Limit   The functions use arithmetic and functions of NumPy that CasADi knows.  ``if x[0] > 0`` is an error for a
        symbol; ``math.sin`` of a symbol is NaN without an error.  Therefore the numbers are compared with the model's.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from rmpc_bench.adapters.casadi_symbols import entries, traced
from rmpc_bench.models.dynamics import LinearDynamics, OdeDynamics
from rmpc_bench.models.nonlinear import NonlinearModel


def step_function(model: NonlinearModel) -> Any:
    """Return x(k+1) of a nonlinear design model as ``casadi.Function(x, u)``; (x, u, k) if rhs depends on the time.

    Parameters
    ----------
    model : design model `{nonlinear: plant, ..}`

    Raises
    ------
    DesignError
        If rhs cannot be called with CasADi symbols, or gives other numbers than the model.
    """
    dynamics, Ts = model.dynamics, model.Ts
    if isinstance(dynamics, LinearDynamics):
        return traced(model, "f", lambda x, u: x + (dynamics.A @ x + dynamics.B @ u - x), ("x", "u"))
    assert isinstance(dynamics, OdeDynamics), "there are no other plants as functions"
    ode, p, h = dynamics.ode, dynamics.ode.p, Ts / model.substeps

    def slope(t: Any, x: Any, u: Any) -> Any:
        return entries(ode.rhs(t, x, u, p) if ode.timed else ode.rhs(x, u, p))

    def step(x: Any, u: Any, k: Any = (0,)) -> Any:
        if ode.discrete:
            return slope(k[0] * Ts, x, u)
        times = [(k[0] + j / model.substeps) * Ts for j in range(model.substeps + 1)]
        for now, later in pairwise(times):
            middle = (now + later) / 2
            k1 = slope(now, x, u)
            k2 = slope(middle, x + h / 2 * k1, u)
            k3 = slope(middle, x + h / 2 * k2, u)
            x = x + h / 6 * (k1 + 2 * (k2 + k3) + slope(later, x + h * k3, u))
        return x

    return traced(model, "f", step, ("x", "u", "k") if ode.timed else ("x", "u"))


def output_function(model: NonlinearModel) -> Any:
    """Return y of a nonlinear design model as ``casadi.Function(x)``.

    Parameters
    ----------
    model : design model `{nonlinear: plant, ..}`

    Raises
    ------
    DesignError
        If output cannot be called with CasADi symbols, or gives other numbers than the model.
    """
    dynamics = model.dynamics
    if isinstance(dynamics, LinearDynamics):
        return traced(model, "h", lambda x: dynamics.C @ x, ("x",))
    return traced(model, "h", lambda x: x if model.output is None else model.output(x, model.p), ("x",))
