"""Systems of python-control as matrices, or as the functions of a differential equation or of a map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import isroutine
from numbers import Real
from typing import Any

from rmpc_bench.extras import library
from rmpc_bench.models.library_systems import (
    Equation,
    Realisation,
    arguments,
    ignores_time,
    refuse_other_step,
    refuse_unknown,
    usable_names,
)
from rmpc_bench.types import Array, DesignError, Parameters

KEY = "control"


def nonlinear(given: Any, parameters: Mapping[str, float], Ts: float) -> Equation | None:
    """Return a nonlinear system, or what a function returns, as functions; None for anything else."""
    ct = library("control")
    own = arguments(given, parameters, KEY) if isroutine(given) else {}
    system = given(**own) if isroutine(given) else given
    if not isinstance(system, ct.NonlinearIOSystem) or isinstance(system, ct.StateSpace):
        return None
    refuse_other_step(step := _step(system), Ts, KEY)
    numbers = {name: float(each) for name, each in system.params.items() if isinstance(each, Real)}
    named = {name: value for name, value in parameters.items() if name not in own}
    refuse_unknown(named, numbers, KEY)
    labels = system.state_labels, system.input_labels, system.output_labels if system.outfcn else []
    if None in (system.nstates, system.ninputs, system.noutputs):
        raise DesignError("must name its signals: nlsys(.., states=[..], inputs=[..], outputs=[..])", KEY)
    states, inputs, outputs = map(usable_names, labels)
    # Subclasses have methods of their own.
    users = (system.updfcn, system.outfcn) if type(system) is ct.NonlinearIOSystem else (None, None)
    rhs, timed = _Function(system, "dynamics", users[0]), not ignores_time(users[0])
    measured = _Function(system, "output", users[1]) if system.outfcn else None
    return Equation(rhs, measured, states, inputs, outputs, numbers | named, step != 0.0, timed)


def linear(system: Any) -> Realisation:
    """Return a linear system in state-space form."""
    ct = library("control")
    if not isinstance(system, ct.StateSpace | ct.TransferFunction):
        kinds = "a StateSpace, a TransferFunction or a NonlinearIOSystem"
        raise DesignError(f"must be or return {kinds} (got {type(system).__name__})", KEY)
    # Without `method` the states of a transfer function depend on whether slycot is installed.
    form = ct.ss(system, method="scipy") if isinstance(system, ct.TransferFunction) else system
    names = map(usable_names, (form.state_labels, form.input_labels, form.output_labels))
    return Realisation(form.A, form.B, form.C, form.D, _step(form), *names)


def _step(system: Any) -> float | None:
    """Sampling time [s]: 0 of a continuous system, None of a discrete one without a sampling time."""
    if system.dt is None:
        raise DesignError("has no time base (dt = None); give it dt = 0 if it is continuous, or a sampling time", KEY)
    return None if system.dt is True else float(system.dt)


@dataclass(frozen=True, eq=False)
class _Function:
    """`dynamics` or `output` of a system, with all parameters given: the system keeps those of the last call."""

    system: Any
    name: str
    user: Callable[..., Any] | None
    """The user's function that the method calls, which takes a block of runs if it is written so."""

    def __call__(self, t: float, x: Array, u: Array, p: Parameters) -> Any:
        if self.user is not None:
            return self.user(t, x, u, {**self.system.params, **vars(p)})
        if x.ndim > 1:
            raise ValueError(f"a system of type {type(self.system).__name__} takes one run at a time")
        return getattr(self.system, self.name)(t, x, u, vars(p))

    @property
    def __name__(self) -> str:
        # A system without a name of its own is counted in the order in which systems are made.
        return self.name if self.system.name.startswith("sys[") else f"{self.system.name}.{self.name}"
