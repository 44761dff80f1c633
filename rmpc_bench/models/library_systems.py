"""Systems of other libraries: linear ones in state-space form, nonlinear ones as functions.

Linear  x' = A x + B u with the input held over a sample, or x(k+1) = A x + B u;  y = C x + D u.
        The matrices may depend on parameters.
Method  A continuous system is sampled exactly: one exponential of [[A, B], [0, 0]] (zero-order hold).
Fails   Design error: a discrete system has another sampling time, or a matrix is not finite.
"""

from __future__ import annotations

import dis
import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.noise_sets import DesignNoise
from rmpc_bench.models.ode_functions import Names, count, function_name, names_of, refuse_shared
from rmpc_bench.numerics.linalg import discretise
from rmpc_bench.types import Array, DesignError, Parameters, Signals
from rmpc_bench.types.errors import unknown

SAME_STEP = 1e-9
"""Relative difference up to which two sampling times are equal."""


class Realisation(NamedTuple):
    """A linear system in state-space form."""

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    D: Float[Array, "ny nu"]
    Ts: float | None  # sampling time [s]: 0 of a continuous system, None of a discrete one without a sampling time
    states: Names
    inputs: Names
    outputs: Names


class SampledSystem(NamedTuple):
    """x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k)."""

    A: Float[Array, "nx nx"]
    B: Float[Array, "nx nu"]
    C: Float[Array, "ny nx"]
    D: Float[Array, "ny nu"]


@dataclass(frozen=True, eq=False)
class ParametricSystem:
    """A linear system whose matrices may depend on parameters."""

    make: Callable[[Mapping[str, float]], Realisation]  # parameters by name -> the system
    nominal: Mapping[str, float]  # name of a parameter -> nominal value
    key: str  # of the configuration, for messages

    def sampled(self, values: Mapping[str, float], Ts: float) -> SampledSystem:
        """Return the matrices over a sampling period for some parameters."""
        A, B, C, D, own, *_ = self.make(values)
        if not all(np.isfinite(matrix).all() for matrix in (A, B, C, D)):
            raise DesignError("has a matrix that is not finite", self.key)
        refuse_other_step(own, Ts, self.key)
        return SampledSystem(*(discretise(A, B, Ts) if own == 0.0 else (A, B)), C, D)

    @property
    def A_c(self) -> Float[Array, "nx nx"] | None:
        """A of x' at the nominal parameters; None of a discrete system."""
        made = self.make(self.nominal)
        return made.A if made.Ts == 0.0 else None

    def signals(self, bounds: Mapping[str, tuple[float, float]]) -> Signals:
        """Return the names of the nominal system, with bounds by these names."""
        made = self.make(self.nominal)
        states, inputs = names_of(made.states, self.key, "x")[0], names_of(made.inputs, self.key, "u")[0]
        refuse_shared(states, inputs, self.key)
        return Signals(states, inputs, names_of(made.outputs, self.key, "y")[0], bounds=bounds)


def refuse_other_step(own: float | None, Ts: float, key: str) -> None:
    """Refuse another sampling time [s] than that of the experiment; `own` is 0 of a continuous system or None."""
    if own and abs(own - Ts) > SAME_STEP * max(own, Ts):
        raise DesignError(f"has the sampling time {own:g}, and time.step is {Ts:g}; they must be equal", key)


def parametric_system(
    given: Any, read: Callable[[Any], Realisation], parameters: Mapping[str, float], key: str
) -> ParametricSystem:
    """Return a system, or what a function of parameters returns, as a parametric system."""
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

    Parameters of other names have no effect here.  A DesignError at `key` names an argument without a value.
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
    """Return the nominal system as a linear design model."""
    A, B, C, D = system.sampled(system.nominal, Ts)
    A_c = system.A_c
    return LinearModel(A, B, C, *noise.covariances(len(A), len(C), None if A_c is None else Ts, A_c), D=D)


POINTS = 8
"""Points at which an output is tested for the input and the time."""
UNDEFINED = (ArithmeticError, ValueError, TypeError, IndexError)
"""What a function raises where it is not defined."""


class Equation(NamedTuple):
    """A nonlinear system x' = rhs(t, x, u, p), or x(k+1) of a discrete one; y = measured(t, x, u, p)."""

    rhs: Callable[..., Any]
    measured: Any  # function; None where all states are measured
    states: Names
    inputs: Names
    outputs: Names
    nominal: Mapping[str, float]  # name of a parameter -> nominal value
    discrete: bool
    timed: bool = True  # whether the time may have an effect on rhs

    def output(self, x: Any, p: Parameters) -> Any:
        """Measure; `keys` has found that the input and the time have no effect."""
        shape = x.shape[1:] if isinstance(x, np.ndarray) else ()
        return self.measured(0.0, x, np.zeros((count(self.inputs), *shape)), p)

    def keys(self, key: str, x0: Any = None) -> dict[str, Any]:
        """Return the keys of an ODE plant or an ODE model."""
        found: dict[str, Any] = {
            "ode": self.rhs if self.timed else Untimed(self.rhs),
            "states": self.states,
            "inputs": self.inputs,
        }
        found |= {"parameters": dict(self.nominal), "discrete": self.discrete}
        if self.measured is not None:
            self._refuse_feedthrough(key, x0)
            found |= {"output": self.output, "outputs": self.outputs}
        return found

    def _refuse_feedthrough(self, key: str, x0: Any) -> None:
        rng, p = np.random.Generator(np.random.PCG64(7)), Parameters(self.nominal)
        base = np.broadcast_to(1.0 if x0 is None else np.asarray(x0, dtype=float), (count(self.states),))
        for _ in range(POINTS):
            x = base * rng.uniform(0.5, 1.5, len(base)) + np.where(base == 0.0, 0.1 * rng.standard_normal(len(base)), 0)
            u = rng.uniform(0.0, 1.0, (2, count(self.inputs)))
            usual, other = self._at(0.0, x, u[0], p), self._at(0.0, x, u[1], p)
            if not np.array_equal(usual, other, equal_nan=True):
                text = (
                    "its output depends on the input; only a linear system may have that, and an ode by output(x, u, p)"
                )
                raise DesignError(text, key)
            if not np.array_equal(usual, self._at(100.0 * rng.random(), x, u[0], p), equal_nan=True):
                raise DesignError("its output depends on the time; give the time as a further state", key)

    def _at(self, t: float, x: Array, u: Array, p: Parameters) -> Array:
        try:
            with np.errstate(all="ignore"):
                return np.array(self.measured(t, x.copy(), u.copy(), p), dtype=float)
        except UNDEFINED:
            return np.full(1, np.nan)


@dataclass(frozen=True, eq=False)
class Untimed:
    """A function (x, u, p) that calls a function (t, x, u, p) in which the time has no effect."""

    function: Callable[..., Any]

    def __call__(self, x: Any, u: Any, p: Parameters) -> Any:
        """Call the function."""
        return self.function(0.0, x, u, p)

    @property
    def __name__(self) -> str:
        """Name of the function."""
        return str(self.function.__name__)


@contextmanager
def blamed(key: str) -> Iterator[None]:
    """Raise errors of the keys that `Equation.keys` returns as errors of the key that names the system."""
    try:
        yield
    except DesignError as error:
        if error.parameter not in ("ode", "output", "states", "inputs", "outputs", "discrete"):
            raise
        raise DesignError(str(error), key) from error


def ignores_time(function: Any) -> bool:
    """Whether a function of Python does not read its first argument; False where its code is not known."""
    code = getattr(function, "__code__", None)
    if code is None or not code.co_argcount or {"locals", "vars", "eval", "exec"} & {*code.co_names}:
        return False
    first = code.co_varnames[0]
    read = (each.argval for each in dis.get_instructions(code))
    return not any(first == each or (isinstance(each, tuple) and first in each) for each in read)


def usable_names(labels: Iterable[str]) -> Names:
    """Return names of signals as a configuration may write them; their number where they are only counted."""
    given = list(labels)
    names = [re.sub(r"\W+", "_", label).strip("_") for label in given]
    counted = all(re.fullmatch(r"[xuy](\[\d+\])?", label) for label in given)
    return len(given) if counted or not all(name.isidentifier() for name in names) else names
