"""Plant that is a CasADi function, or an equation in the form of `casadi.integrator`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from rmpc_bench.adapters.casadi_equation import (
    KEYS,
    checked,
    entry_names,
    equation,
    input_names,
    named_object,
    refuse_other_order,
    sampled_dae,
)
from rmpc_bench.extras import library
from rmpc_bench.models.ode_functions import Names
from rmpc_bench.plants import ode
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import DesignError, UserFunction


def plant(
    Ts: float,
    n_steps: int,
    *,
    casadi: UserFunction,
    output: UserFunction = None,
    states: Names | None = None,
    inputs: Names | None = None,
    outputs: Names | None = None,
    parameters: dict[str, float] | None = None,
    discrete: bool = False,
    solver: Solver | None = None,
    algebraic: dict[str, float] | None = None,
    integrator: Literal["idas", "collocation"] = "idas",
    options: dict[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    x0: Any = None,
) -> ode.OdePlant:
    """CasADi function, or differential-algebraic equation, as a plant.

    A function gives time derivatives, which are integrated as those of `ode` are, or x(k+1).  An equation in the form
    of `casadi.integrator` is a dict with x, ode and, where it has them, t, u, p; with z and alg it has algebraic
    variables, and CasADi integrates it over a sample, run by run.  `linearise: plant` has exact derivatives.

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    casadi : ``PATH.py:NAME`` of a casadi.Function of (x, u, p) or (t, x, u, p), in any order where its inputs have
        these names, of a dict as casadi.integrator takes it, or of a function without arguments that returns one
    output : ``PATH.py:NAME`` of a casadi.Function or a function of Python of (x, p); without it all states are measured
    states, inputs : names, such as ``[h1, h2]`` or ``{pump: ml/s}`` (default: as many as there are)
    outputs : names; needed with `output`
    parameters : name -> nominal value, in the order of p; `perturb` and `set` may name them
    discrete : whether the function returns x(k+1) in place of time derivatives
    solver : integration of an equation without algebraic variables, as for `ode`
    algebraic : name of an algebraic variable -> value from which it is computed, in the order of z (default: 0 each)
    integrator : of CasADi, for an equation with algebraic variables
    options : of this integrator, such as ``{reltol: 1e-10}``
    bounds : name of a state or an input -> lower and upper bound
    x0 : (nx,) initial state, from which the functions are tried
    """
    made, nominal = named_object(casadi), parameters or {}
    has_z = isinstance(made, Mapping) and "z" in made
    if discrete and isinstance(made, Mapping):
        raise DesignError("has no effect: an equation for casadi.integrator has time derivatives", "discrete")
    only_z = {"algebraic": algebraic, "options": options, "integrator": integrator if integrator != "idas" else None}
    for key, given in {"solver": solver}.items() if has_z else only_z.items():
        if given is not None:
            raise DesignError(f"has no effect on an equation {'with' if has_z else 'without'} z", key)
    sampled = sampled_dae(made, Ts, integrator, options or {}, algebraic) if has_z else None
    function, names = sampled or equation(made)
    every = {"x": states, "u": inputs, "p": [*nominal]}
    named = {name: each for name, each in every.items() if each is not None}
    rhs = checked(function, names, named, "casadi", alone=has_z)
    for name, each in named.items() if isinstance(made, Mapping) else ():
        refuse_other_order(entry_names(made.get(name)), each, name, KEYS[name])
    if isinstance(output, library("casadi").Function):
        output = checked(output, input_names(output, {1: ("x",), 2: ("x", "p")}, "output"), named, "output")
    sizes = {name: rhs.function.size1_in(i) for i, name in enumerate(names)}
    try:
        return ode.design(
            Ts, n_steps, ode=rhs, output=output, outputs=outputs, parameters=nominal, bounds=bounds, x0=x0,
            states=sizes["x"] if states is None else states, inputs=sizes.get("u", 0) if inputs is None else inputs,
            solver=solver or Solver(), discrete=discrete or has_z,
        )  # fmt: skip
    except DesignError as error:
        raise DesignError(str(error), "casadi" if error.parameter == "ode" else error.parameter) from error
