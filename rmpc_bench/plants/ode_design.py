"""From the keys of a configuration to a differential equation, or a map, and its integration over a sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from timeit import default_timer
from typing import Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.ode_names import Names, check_output, function_name, is_timed, names_of, refuse_shared
from rmpc_bench.plants.ode_checks import output_takes_blocks, rhs_takes_blocks, sample
from rmpc_bench.plants.ode_events import UserEvent, read_events
from rmpc_bench.plants.ode_stepping import Solver, Stepping, advance_block, advance_run
from rmpc_bench.plants.ode_trial import tried
from rmpc_bench.types import Array, DesignError, Ode

BLOCK, TIMED = 50, 2
"""Runs of a block for which a step is timed, and how often."""


def equation(
    rhs: Any,
    output: Any,
    states: Names,
    inputs: Names,
    outputs: Names | None,
    parameters: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    x0: Float[Array, " n"] | None,
    discrete: bool,
) -> tuple[Ode, dict[str, str]]:
    """Return the equation, and the reasons for which its functions are called run by run, by their name."""
    x_names, units = names_of(states, "states", "x")
    u_names, u_units = names_of(inputs, "inputs", "u")
    refuse_shared(x_names, u_names)
    if output is not None:
        check_output(output)
        if outputs is None:
            raise DesignError("name the outputs, or give their number", "outputs")
    elif outputs is not None and names_of(outputs, "outputs", "y")[0] != x_names:
        raise DesignError("without `output` all states are measured; give `output`, or leave `outputs` out", "outputs")
    y_names, y_units = (x_names, units) if outputs is None else names_of(outputs, "outputs", "y")
    for name in parameters:
        if not name.isidentifier() or name.startswith("_"):
            raise DesignError(f"{name!r} is no name: letters, digits and _, since rhs reads p.{name}", "parameters")
    nominal = {name: float(value) for name, value in parameters.items()}
    own = bounds_by_name(bounds, x_names, u_names)
    every_unit, timed = {**y_units, **u_units, **units}, is_timed(rhs)
    record = Ode(rhs, output, x_names, u_names, y_names, nominal, every_unit, own, timed, discrete=discrete)
    start = initial(record, x0)
    # A function may meet numbers here for which it is not defined.
    with np.errstate(all="ignore"):
        reasons = {function_name(rhs): rhs_takes_blocks(record, start)}
        measured = "" if output is None else output_takes_blocks(record, start)
    record = replace(record, rhs_takes_blocks=not any(reasons.values()), output_takes_blocks=not measured)
    if measured:
        reasons[function_name(output)] = measured
    return record, {name: reason for name, reason in reasons.items() if reason}


def bounds_by_name(
    bounds: Mapping[str, tuple[float, float]], states: tuple[str, ...], inputs: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    """Return the bounds of states and inputs, which may be given as ``x``, ``x.0`` or ``u.0``, by their names."""
    found = {name: bounds["x"] for name in states if "x" in bounds}
    for letter, names in (("x", states), ("u", inputs)):
        for i, name in enumerate(names):
            for each in (f"{letter}.{i}", name):
                if each in bounds:
                    found[name] = bounds[each]
    return found


def stepping_of(
    ode: Ode, Ts: float, n_steps: int, solver: Solver, events: Any, reasons: Mapping[str, str], x0: Array | None
) -> tuple[Stepping, tuple[str, ...], float]:
    """Return the integration over a sample, remarks on it, and its time per run and step [s]."""
    start = initial(ode, x0)
    if ode.discrete and solver != Solver():
        raise DesignError("has no effect beside `discrete: true`: rhs returns x(k+1)", "solver")
    found: tuple[UserEvent, ...] = () if events is None else read_events(events)
    if found and ode.discrete:
        raise DesignError("are located within a sample; with `discrete: true` there is nothing within one", "events")
    if found and solver.method == "rk4":
        raise DesignError("need a method of solve_ivp, such as solver: {method: RK45}", "events")
    remarks = [f"{name} is called run by run: {reason}" for name, reason in reasons.items()]
    stepping = Stepping(solver, solver.substeps or int(ode.discrete), np.zeros(ode.nx), found)
    with np.errstate(all="ignore"):
        if solver.method == "rk4" and not ode.discrete:
            stepping, more = tried(ode, Ts, n_steps, start, solver, found)
            remarks += more
        cost = _seconds(ode, Ts, stepping, start)
    if reasons or solver.method != "rk4":
        remarks.append(f"a step takes about {float(f'{1e6 * cost:.2g}'):g} us per run")
    return stepping, tuple(remarks), cost


def initial(ode: Ode, x0: Float[Array, " n"] | None) -> Float[Array, " nx"]:
    """Initial state within the bounds; 0 where none of this size is given, which is an error of `initial`."""
    given = np.zeros(ode.nx) if x0 is None or x0.shape not in ((1,), (ode.nx,)) else np.broadcast_to(x0, (ode.nx,))
    return np.asarray(np.clip(given, *ode.limits(ode.states)))


def _seconds(ode: Ode, Ts: float, stepping: Stepping, x0: Array) -> float:
    """Time of a step per run [s], measured."""
    in_block = ode.rhs_takes_blocks and stepping.in_blocks
    some, times = sample(ode, x0, BLOCK if in_block else 1), []
    # The first call imports and compiles what it needs.
    for _ in range(TIMED + 1):
        start = default_timer()
        if in_block:
            advance_block(ode, Ts, stepping, 0, *some)
        else:
            advance_run(ode, Ts, stepping, 0, *some.run(ode, 0))
        times.append(default_timer() - start)
    return min(times[1:]) / len(some.x)
