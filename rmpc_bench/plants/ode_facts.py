"""Facts about a plant with a differential equation, as `describe` and `check` print them."""

from __future__ import annotations

from collections.abc import Sequence

from rmpc_bench.models.ode_names import function_name
from rmpc_bench.plants.ode_stepping import Stepping
from rmpc_bench.types import Ode


def facts(ode: Ode, stepping: Stepping, extra: Ode | None = None) -> list[tuple[str, str]]:
    """Return labels and texts; `extra` is the equation with the extra signals as its outputs."""
    in_blocks = ode.rhs_takes_blocks and stepping.in_blocks
    arguments, left = "t, x, u, p" if ode.timed else "x, u, p", "x(k+1)" if ode.discrete else "x'"
    found = [
        ("equation", f"{left} = {function_name(ode.rhs)}({arguments})"),
        ("states", _names(ode, ode.states)),
        ("inputs", _names(ode, ode.inputs) or "none"),
        ("outputs", _names(ode, ode.outputs) + (" (all states)" if ode.output is None else "")),
        *([] if extra is None else [("extra signals", _names(extra, extra.outputs))]),
        ("parameters", ", ".join(f"{name} = {value:g}" for name, value in ode.nominal.items()) or "none"),
        *([] if ode.discrete else [("solver", _solver(stepping))]),
        ("calls of rhs", "all runs of a block at once" if in_blocks else "run by run"),
    ]
    found += [("event", _event(each.word)) for each in stepping.events]
    return found


def _names(ode: Ode, names: Sequence[str]) -> str:
    return ", ".join(f"{name}{_unit(ode, name)}{_bounds(ode, name)}" for name in names)


def _unit(ode: Ode, name: str) -> str:
    return f" [{ode.units[name]}]" if name in ode.units else ""


def _bounds(ode: Ode, name: str) -> str:
    if name not in ode.bounds:
        return ""
    return f" {'within' if name in ode.states else 'limited to'} {ode.bounds_text(name).split(']')[0]}]"


def _solver(stepping: Stepping) -> str:
    solver = stepping.solver
    if solver.method != "rk4":
        return f"{solver.method}, rtol {solver.tolerances.rtol:g}, atol {solver.tolerances.atol:g}"
    if stepping.substeps:
        return f"rk4, {stepping.substeps} substeps per sample"
    return f"rk4, error control to {stepping.tolerance.rtol:g} of the range of a state"


def _event(word: str) -> str:
    return f"ends the run: {word}" if word else "replaces the state"
