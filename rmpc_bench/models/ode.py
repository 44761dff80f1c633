"""Design model given by an equation of its own, which may be simpler than that of the plant.

Model   x' = rhs(x, u, p), or x(k+1) with `discrete: true`;  y = output(x, p), or output(x, u, p), with its parameters.
        With `at` as `linearise`, without as `nonlinear`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from rmpc_bench.models.dynamics import OdeDynamics
from rmpc_bench.models.linearised import linearised, relinearised
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.nonlinear import nonlinear_model
from rmpc_bench.models.ode_functions import Names, is_fed, is_timed, names_of, refuse_shared
from rmpc_bench.models.operating_point import At
from rmpc_bench.types import Count, DesignError, Model, Ode, Plant, Positive, UserFunction
from rmpc_bench.types.errors import unknown

EQUATION = r"\dot x = f(x, u, p), \quad y = h(x, p)"


def design(
    Ts: float,
    plant: Plant,
    *,
    ode: UserFunction,
    output: UserFunction = None,
    states: Names | None = None,
    inputs: Names | None = None,
    outputs: Names | None = None,
    parameters: dict[str, float] | None = None,
    noise: DesignNoise,
    at: At | Literal["trajectory"] | None = None,
    jacobian: UserFunction = None,
    substeps: Count | None = None,
    numba: bool = False,
    discrete: bool = False,
    angles: list[str] | dict[str, Positive] | None = None,
    time_unit: str = "s",
) -> Model:
    """Design model with an equation of its own; linear with `at`, nonlinear without.

    Names, parameters and bounds that are not given are those of an ODE plant.

    Parameters
    ----------
    Ts : sampling time [s]
    plant : plant of the experiment
    ode : rhs(x, u, p) or rhs(t, x, u, p), which returns x', or x(k+1) with `discrete`
    output : output(x, p) or output(x, u, p) (default: all states)
    states, inputs, outputs : names or counts
    parameters : name -> value; they replace those of the plant one by one
    noise : covariances `process` and `measurement` of the noise of the sampled model
    at : operating point, as for `linearise`; without it the model is nonlinear
    jacobian : derivatives at the operating point, as for `linearise`
    substeps : Runge-Kutta steps per sample of a nonlinear model (default: those of the plant, or error control)
    numba : whether to compile rhs of a nonlinear model
    discrete : whether rhs returns x(k+1) in place of time derivatives
    angles : states and outputs that are angles, as of the plant (default: those of it)
    time_unit : unit of the time in texts

    Raises
    ------
    DesignError
        If a function, a name or an operating point is not what it must be.
    """
    x_names, x_units = _named(states, plant.ode, "states", "x")
    u_names, u_units = _named(inputs, plant.ode, "inputs", "u")
    refuse_shared(x_names, u_names)
    y_names, y_units = (x_names, x_units) if output is None else _named(outputs, plant.ode, "outputs", "y")
    known = plant.ode or Ode(ode, output, (), (), ())
    ranges = dict(zip(known.states, known.scale, strict=False))
    equation = Ode(
        ode,
        output,
        x_names,
        u_names,
        y_names,
        nominal={**known.nominal, **(parameters or {})},
        units={**known.units, **y_units, **u_units, **x_units},
        bounds={name: known.bounds[name] for name in (*x_names, *u_names) if name in known.bounds},
        timed=is_timed(ode),
        substeps=known.substeps if known.discrete == discrete else 0,
        scale=tuple(ranges.get(name, 0.0) for name in x_names),
        discrete=discrete,
        time_unit=time_unit,
        fed=is_fed(output),
    )
    if (equation.nu, equation.ny) != (plant.nu, plant.ny):
        raise DesignError(
            f"inputs and outputs of the model: {equation.nu} and {equation.ny}; those of the plant: {plant.nu} and "
            f"{plant.ny}; give inputs, outputs and `output`",
            "ode",
        )
    own = _angles(angles, known, dict.fromkeys((*x_names, *y_names)))
    dynamics = OdeDynamics(replace(equation, angles=own))
    if at == "trajectory":
        return relinearised(dynamics, Ts, noise, substeps)
    if at is not None:
        return linearised(dynamics, Ts, at, noise, jacobian)
    return nonlinear_model(dynamics, Ts, noise, substeps=substeps, numba=numba)


def _angles(given: list[str] | dict[str, float] | None, plant: Ode, names: Mapping[str, None]) -> Mapping[str, float]:
    """Return the periods of the states and outputs that are angles, those of the plant unless some are given."""
    if given is None:
        return plant.angles
    for name in given:
        if name not in names:
            raise DesignError(unknown(name, names, "state or output of this model"), "angles")
    return given if isinstance(given, dict) else dict.fromkeys(given, 2.0 * np.pi)


def _named(given: Names | None, plant: Ode | None, key: str, letter: str) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return names with their units; those of the plant, whose units are known, unless some are given."""
    if given is not None:
        return names_of(given, key, letter)
    if plant is None:
        raise DesignError("name them, or give their number: the plant is no ODE plant", key)
    return getattr(plant, key), {}
