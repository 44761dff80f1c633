"""Systems of python-control as plants and design models; `system` makes one of a plant."""

from __future__ import annotations

from typing import Any, Literal

from rmpc_bench.adapters.control_export import system as system
from rmpc_bench.adapters.control_system import KEY, linear, nonlinear
from rmpc_bench.models import ode as ode_model
from rmpc_bench.models.library_systems import blamed, design_model, parametric_system
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.operating_point import At
from rmpc_bench.plants import ode as ode_plant
from rmpc_bench.plants.linear import linear_plant
from rmpc_bench.plants.ode_stepping import Solver
from rmpc_bench.types import Count, DesignError, Model, Plant, UserFunction


def plant(
    Ts: float,
    n_steps: int,
    *,
    control: UserFunction,
    parameters: dict[str, float] | None = None,
    solver: Solver | None = None,
    bounds: Any = None,
    x0: Any = None,
) -> Plant:
    """System of python-control, linear or nonlinear, with the names of its states, inputs and outputs.

    Parameters
    ----------
    Ts : sampling time [s], which that of a discrete system must be
    n_steps : number of control periods N
    control : ``PATH.py:NAME`` of a StateSpace, TransferFunction or NonlinearIOSystem, or of a function that returns one
    parameters : nominal values of `params`, or of the arguments of a function that returns a linear system, which
        `perturb` and `set` may name (default: those of the system or the function)
    solver : integration of a nonlinear continuous system, as for `ode`
    bounds : name of a state or an input -> lower and upper bound
    x0 : (nx,) initial state, from which the functions are tried
    """
    found = nonlinear(control, parameters or {}, Ts)
    if found is not None:
        with blamed(KEY):
            return ode_plant.design(Ts, n_steps, **found.keys(KEY, x0), solver=solver or Solver(), bounds=bounds, x0=x0)
    if solver is not None:
        raise DesignError("has no effect: a linear system is sampled exactly", "solver")
    return linear_plant(parametric_system(control, linear, parameters or {}, KEY), Ts, n_steps, bounds)


def model(
    Ts: float,
    plant: Plant,
    *,
    control: UserFunction,
    parameters: dict[str, float] | None = None,
    noise: DesignNoise,
    at: At | Literal["trajectory"] | None = None,
    substeps: Count | None = None,
) -> Model:
    """System of python-control as a design model; a nonlinear one is linear around `at`, nonlinear without.

    Parameters
    ----------
    Ts : sampling time [s]; a linear continuous system is sampled with the input held
    plant : plant of the experiment
    control : ``PATH.py:NAME`` of a system, or of a function that returns one, as for the plant
    parameters : values of its parameters (default: those of the system or the function)
    noise : covariances `process` and `measurement` of the noise of the sampled model
    at : operating point of a nonlinear system, as for `linearise`
    substeps : Runge-Kutta steps per sample of a nonlinear model (default: those of the plant, or error control)
    """
    found = nonlinear(control, parameters or {}, Ts)
    if found is not None:
        _refuse_other_order(found, plant)
        with blamed(KEY):
            return ode_model.design(Ts, plant, **found.keys(KEY), noise=noise, at=at, substeps=substeps)
    if at is not None or substeps is not None:
        raise DesignError("has no effect on a linear system", "substeps" if at is None else "at")
    system = parametric_system(control, linear, parameters or {}, KEY)
    _refuse_other_order(system.make(system.nominal), plant)
    return design_model(system, Ts, noise)


def _refuse_other_order(system: Any, plant: Plant) -> None:
    """Refuse signals of a model that have the names of those of the plant in another order."""
    for noun in ("states", "inputs", "outputs"):
        own, names = getattr(system, noun), [*getattr(plant.signals, noun, ())]
        if not isinstance(own, int) and [*own] != names and sorted(own) == sorted(names):
            raise DesignError(f"has the {noun} {', '.join(own)}; the order of the plant is {', '.join(names)}", KEY)
