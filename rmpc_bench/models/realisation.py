"""Linear systems of other libraries in state-space form, with matrices that may depend on parameters.

Model   x' = A x + B u with the input held over a sample, or x(k+1) = A x + B u;  y = C x.
Method  A continuous system is sampled exactly: one exponential of [[A, B], [0, 0]] (zero-order hold).
Fails   Design error: D is not zero, a discrete system has another sampling time, or a matrix is not finite.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_covariances import DesignNoise
from rmpc_bench.models.ode_names import Names, function_name, names_of, refuse_shared
from rmpc_bench.numerics.linalg import discretise
from rmpc_bench.types import Array, DesignError, Signals
from rmpc_bench.types.issue import unknown

SAME_STEP = 1e-9
"""Relative difference up to which two sampling times are equal."""


class Realisation(NamedTuple):
    """A linear system in state-space form."""

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    D: Float[Array, "ny nu"]
    Ts: float | None
    """Sampling time [s]: 0 of a continuous system, None of a discrete one without a sampling time."""
    states: Names
    inputs: Names
    outputs: Names


class SampledSystem(NamedTuple):
    """x(k+1) = A x(k) + B u(k), y(k) = C x(k)."""

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]


@dataclass(frozen=True, eq=False)
class ParametricSystem:
    """A linear system whose matrices may depend on parameters.

    Parameters
    ----------
    make : parameters by name -> the system
    nominal : name of a parameter -> nominal value
    key : of the configuration, for messages
    """

    make: Callable[[Mapping[str, float]], Realisation]
    nominal: Mapping[str, float]
    key: str

    def sampled(self, values: Mapping[str, float], Ts: float) -> SampledSystem:
        """Return the matrices over a sampling period for some parameters.

        Parameters
        ----------
        values : name -> value of every parameter
        Ts : sampling time [s]

        Raises
        ------
        DesignError
            If the system has a direct feedthrough, another sampling time, or a matrix that is not finite.
        """
        A, B, C, D, own, *_ = self.make(values)
        if not all(np.isfinite(matrix).all() for matrix in (A, B, C, D)):
            raise DesignError("has a matrix that is not finite", self.key)
        if D.any():
            refuse_feedthrough("D is not zero", self.key)
        refuse_other_step(own, Ts, self.key)
        return SampledSystem(*(discretise(A, B, Ts) if own == 0.0 else (A, B)), C)

    def signals(self, bounds: Mapping[str, tuple[float, float]]) -> Signals:
        """Return the names of the nominal system, with bounds by these names.

        Raises
        ------
        DesignError
            If a name cannot be used.
        """
        made = self.make(self.nominal)
        states, inputs = names_of(made.states, self.key, "x")[0], names_of(made.inputs, self.key, "u")[0]
        refuse_shared(states, inputs, self.key)
        return Signals(states, inputs, names_of(made.outputs, self.key, "y")[0], bounds=bounds)


def refuse_feedthrough(what: str, key: str) -> None:
    """Raise a DesignError: the output depends on the input of the same sample.

    Parameters
    ----------
    what : how this was seen
    key : of the configuration
    """
    reason = "u(k) is computed from y(k), so an output cannot depend on the input of the same sample"
    raise DesignError(f"{what}: {reason}; describe the actuator or the sensor as a further state", key)


def refuse_other_step(own: float | None, Ts: float, key: str) -> None:
    """Raise a DesignError if a discrete system has another sampling time than the experiment.

    Parameters
    ----------
    own : sampling time of the system [s]; 0 of a continuous one, None where it has none
    Ts : that of the experiment [s]
    key : of the configuration
    """
    if own and abs(own - Ts) > SAME_STEP * max(own, Ts):
        raise DesignError(f"has the sampling time {own:g} s, and time.step is {Ts:g} s; they must be equal", key)


def parametric_system(
    given: Any, read: Callable[[Any], Realisation], parameters: Mapping[str, float], key: str
) -> ParametricSystem:
    """Return a system, or what a function of parameters returns, as a parametric system.

    Parameters
    ----------
    given : the system, or a function whose arguments are the parameters
    read : a system of the library -> its state-space form
    parameters : values of arguments, as given in the configuration
    key : of the configuration that names the system

    Raises
    ------
    DesignError
        If a parameter is unknown or has no value, or the nominal system cannot be read.
    """
    if not inspect.isroutine(given):
        for name in parameters:
            text = f"a linear system has no parameters; name a function of {name} that returns the system as `{key}`"
            raise DesignError(text, f"parameters.{name}")
        return ParametricSystem(partial(_fixed, read(given)), {}, key)
    nominal = arguments(given, parameters, key)
    refuse_unknown(parameters, nominal, key)
    return ParametricSystem(partial(_made, given, read), nominal, key)


def _fixed(system: Realisation, values: Mapping[str, float]) -> Realisation:
    return system


def _made(function: Callable[..., Any], read: Callable[[Any], Realisation], values: Mapping[str, float]) -> Realisation:
    return read(function(**values))


def arguments(function: Callable[..., Any], parameters: Mapping[str, float], key: str) -> dict[str, float]:
    """Return the arguments of a user's function that are numbers: from the configuration, else their defaults.

    Parameters
    ----------
    function : of the user
    parameters : values that the configuration gives; those of other names have no effect here
    key : of the configuration that names the function

    Raises
    ------
    DesignError
        If an argument has no value.
    """
    found: dict[str, float] = {}
    for name, each in inspect.signature(function).parameters.items():
        default = each.default
        if each.annotation in (int, bool, str, "int", "bool", "str") and name not in parameters:
            # Such as the number of states: no physical parameter.
            continue
        if name in parameters:
            found[name] = float(parameters[name])
        elif isinstance(default, int | float) and not isinstance(default, bool):
            found[name] = float(default)
        elif default is each.empty and each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD):
            what = f"{function_name(function)} takes {name}, which has no value"
            raise DesignError(f"{what}; give parameters: {{{name}: ..}}", key)
    return found


def refuse_unknown(parameters: Mapping[str, float], known: Mapping[str, float] | tuple[str, ...], key: str) -> None:
    """Raise a DesignError for a parameter of the configuration that the system does not have."""
    for name in parameters:
        if name not in known:
            raise DesignError(unknown(name, known, f"parameter of {key}"), f"parameters.{name}")


def design_model(system: ParametricSystem, Ts: float, noise: DesignNoise) -> LinearModel:
    """Return the nominal system as a linear design model.

    Parameters
    ----------
    system : the system
    Ts : sampling time [s]
    noise : covariances of the noise of the sampled model

    Raises
    ------
    DesignError
        If the system cannot be sampled, or the noise is no covariance.
    """
    A, B, C = system.sampled(system.nominal, Ts)
    return LinearModel(A, B, C, *noise.covariances(len(A), len(C)))
