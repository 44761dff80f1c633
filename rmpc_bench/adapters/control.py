"""Systems of python-control as plants and design models; `system` makes one of a plant.

The input is held over a sample; `input_output_response` interpolates it.  A system keeps the parameters of its last
call, so every call gets all.  Each worker process loads the file, as lambda functions cannot be sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import isroutine
from numbers import Real
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rmpc_bench.config.load import load_config
from rmpc_bench.extras import library
from rmpc_bench.models.library_systems import (
    Equation,
    Realisation,
    arguments,
    blamed,
    design_model,
    ignores_time,
    parametric_system,
    refuse_other_step,
    refuse_unknown,
    usable_names,
)
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import design_ode
from rmpc_bench.models.operating_point import At
from rmpc_bench.plants import ode as ode_plant
from rmpc_bench.plants.linear import linear_plant
from rmpc_bench.plants.nominal_step import NominalStep
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import Array, Count, DesignError, Model, Ode, Parameters, Plant, UserFunction

EQUATION = r"""\dot x = f(t, x, u_k, p), \quad y_k = h(x_k, p); \quad
\mathrm{linear:} \quad x_{k+1} = e^{A T_s} x_k + \int_0^{T_s} e^{A s} ds B u_k + w_k, \quad y_k = C x_k + v_k"""
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


def system(config: Any) -> Any:
    """Return the nominal plant of a configuration as a system of python-control, without noise.

    Parameters
    ----------
    config : file of a configuration, what `load_config` returns, or a plant

    Returns
    -------
    A `StateSpace` with the sampling time for a linear plant, a continuous `NonlinearIOSystem` for one with a
    differential equation, and a discrete one, which simulates a sample of the plant, for any other.  The parameters of
    the plant are the `params` of a nonlinear system.  Inputs are limited to their bounds.

    Raises
    ------
    DesignError
        If the plant has a memory besides its state.
    """
    loaded = load_config(config) if isinstance(config, str | Path) else config
    plant: Plant = loaded if isinstance(loaded, Plant) else loaded.experiment.plant
    ct, signals = library("control"), plant.signals
    every = ("states", "nx"), ("inputs", "nu"), ("outputs", "ny")
    named = {noun: _labels(noun, getattr(signals, noun, ()), getattr(plant, size)) for noun, size in every}
    if plant.ode is not None:
        dt = plant.Ts if plant.ode.discrete else 0
        rhs, output = _functions(plant.ode)
        return ct.nlsys(rhs, output, **named, params=dict(plant.nominal), dt=dt)
    step, Ts = NominalStep.of(plant), plant.Ts
    if step.linear is not None:
        A, B, C, _, D = step.linear
        return ct.ss(A, B, C, np.broadcast_to(D, (len(C), B.shape[1])), Ts, **named)
    return ct.nlsys(
        lambda t, x, u, params: step.advance(round(t / Ts), x, u, params),
        lambda t, x, u, params: step.output(round(t / Ts), x, u, params),
        **named,
        params=dict(plant.nominal),
        dt=Ts,
    )


def _functions(ode: Ode) -> tuple[Any, Any]:
    """Return both functions of an equation as the library calls them."""
    low, high = ode.limits(ode.inputs)

    def rhs(t: float, x: Any, u: Any, params: Mapping[str, Any]) -> Any:
        return ode.slope(t, x, np.clip(u.T, low, high).T, Parameters(params))

    def output(t: float, x: Any, u: Any, params: Mapping[str, Any]) -> Any:
        return ode.measure(x, np.clip(u.T, low, high).T, Parameters(params))

    return rhs, output


def _labels(noun: str, names: tuple[str, ...], n: int) -> Any:
    """Return names of signals; their number where they are counted, as the library takes no points in a name."""
    return n if not names or any("." in name for name in names) else list(names)


def plant(
    Ts: float,
    n_steps: int,
    *,
    control: UserFunction,
    parameters: dict[str, float] | None = None,
    solver: Solver | None = None,
    bounds: Any = None,
    x0: Any = None,
    angles: Any = None,
    time_unit: str = "s",
) -> Plant:
    """System of python-control, linear or nonlinear, with the names of its states, inputs and outputs.

    Parameters
    ----------
    Ts : sampling time [s], which that of a discrete system must be
    n_steps : number of control periods N
    control : a StateSpace, TransferFunction or NonlinearIOSystem, or a function that returns one
    parameters : nominal values of `params`, or of the arguments of a function that returns a linear system; `perturb`
        and `set` may name them (default: those of the system)
    solver : integration of a nonlinear continuous system, as for `ode`
    bounds : name of a state or an input -> lower and upper bound
    x0 : (nx,) initial state, from which the functions are tried
    angles : name of a state or an output that counts modulo a period -> this period
    time_unit : unit of the time in texts
    """
    found = nonlinear(control, parameters or {}, Ts)
    if found is not None:
        with blamed(KEY):
            keys = {**found.keys(KEY, x0), "solver": solver or Solver(), "bounds": bounds, "x0": x0, "angles": angles}
            return ode_plant.design(Ts, n_steps, **keys, time_unit=time_unit)
    if solver is not None:
        raise DesignError("has no effect: a linear system is sampled exactly", "solver")
    return linear_plant(parametric_system(control, linear, parameters or {}, KEY), Ts, n_steps, bounds)


def model(
    Ts: float,
    plant: Plant | None = None,
    *,
    control: UserFunction,
    parameters: dict[str, float] | None = None,
    noise: DesignNoise,
    at: At | Literal["trajectory"] | None = None,
    substeps: Count | None = None,
    time_unit: str = "s",
) -> Model:
    """System of python-control as a design model; a nonlinear one is linear around `at`, nonlinear without.

    Parameters
    ----------
    Ts : sampling time [s]; a linear continuous system is sampled with the input held
    plant : plant of the experiment; a program needs none for a linear system
    control : a system, or a function that returns one, as for the plant
    parameters : values of its parameters (default: those of the system)
    noise : covariances `process` and `measurement` of the noise of the sampled model
    at : operating point of a nonlinear system, as for `linearise`
    substeps : Runge-Kutta steps per sample of a nonlinear model (default: those of the plant, or error control)
    time_unit : unit of the time in texts
    """
    found = nonlinear(control, parameters or {}, Ts)
    if found is not None:
        if plant is None:
            raise DesignError("is a nonlinear system; a program must give `plant`", KEY)
        _refuse_other_order(found, plant)
        with blamed(KEY):
            keys = {**found.keys(KEY), "noise": noise, "at": at, "substeps": substeps}
            return design_ode(Ts, plant, **keys, time_unit=time_unit)
    if at is not None or substeps is not None:
        raise DesignError("has no effect on a linear system", "substeps" if at is None else "at")
    system = parametric_system(control, linear, parameters or {}, KEY)
    if plant is not None:
        _refuse_other_order(system.make(system.nominal), plant)
    return design_model(system, Ts, noise)


def _refuse_other_order(system: Any, plant: Plant) -> None:
    """Refuse signals of a model that have the names of those of the plant in another order."""
    for noun in ("states", "inputs", "outputs"):
        own, names = getattr(system, noun), [*getattr(plant.signals, noun, ())]
        if not isinstance(own, int) and [*own] != names and sorted(own) == sorted(names):
            raise DesignError(f"has the {noun} {', '.join(own)}; the order of the plant is {', '.join(names)}", KEY)
