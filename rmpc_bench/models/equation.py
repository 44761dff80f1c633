"""Nonlinear systems of other libraries as functions that a plant or a design model is made from."""

from __future__ import annotations

import dis
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.models.ode_names import Names, count
from rmpc_bench.models.realisation import refuse_feedthrough
from rmpc_bench.types import Array, DesignError, Parameters

POINTS = 8
"""Points at which an output is tested for the input and the time."""
UNDEFINED = (ArithmeticError, ValueError, TypeError, IndexError)
"""What a function raises where it is not defined."""


class Equation(NamedTuple):
    """A nonlinear system x' = rhs(t, x, u, p), or x(k+1) of a discrete one; y = measured(t, x, u, p)."""

    rhs: Callable[..., Any]
    measured: Callable[..., Any] | None
    """None where all states are measured."""
    states: Names
    inputs: Names
    outputs: Names
    nominal: Mapping[str, float]
    """Name of a parameter -> nominal value."""
    discrete: bool
    timed: bool = True
    """Whether the time may have an effect on rhs."""

    def output(self, x: Any, p: Parameters) -> Any:
        """Measure; `keys` has found that the input and the time have no effect."""
        assert self.measured is not None, "all states are measured"
        shape = x.shape[1:] if isinstance(x, np.ndarray) else ()
        return self.measured(0.0, x, np.zeros((count(self.inputs), *shape)), p)

    def keys(self, key: str, x0: Any = None) -> dict[str, Any]:
        """Return the keys of an ODE plant or an ODE model.

        Parameters
        ----------
        key : of the configuration that names the system
        x0 : (nx,) a plausible state

        Raises
        ------
        DesignError
            If the output depends on the input or on the time.
        """
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
        assert self.measured is not None, "all states are measured"
        rng, p = np.random.Generator(np.random.PCG64(7)), Parameters(self.nominal)
        base = np.broadcast_to(1.0 if x0 is None else np.asarray(x0, dtype=float), (count(self.states),))
        for _ in range(POINTS):
            x = base * rng.uniform(0.5, 1.5, len(base)) + np.where(base == 0.0, 0.1 * rng.standard_normal(len(base)), 0)
            u = rng.uniform(0.0, 1.0, (2, count(self.inputs)))
            usual, other = self._at(0.0, x, u[0], p), self._at(0.0, x, u[1], p)
            if not np.array_equal(usual, other, equal_nan=True):
                refuse_feedthrough("its output depends on the input", key)
            if not np.array_equal(usual, self._at(100.0 * rng.random(), x, u[0], p), equal_nan=True):
                raise DesignError("its output depends on the time; give the time as a further state", key)

    def _at(self, t: float, x: Array, u: Array, p: Parameters) -> Array:
        assert self.measured is not None, "all states are measured"
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
    """Whether a function of Python does not read its first argument; False where its code is not known.

    Examples
    --------
    >>> ignores_time(lambda t, x: 2 * x), ignores_time(lambda t, x: t * x)
    (True, False)
    """
    code = getattr(function, "__code__", None)
    if code is None or not code.co_argcount or {"locals", "vars", "eval", "exec"} & {*code.co_names}:
        return False
    first = code.co_varnames[0]
    read = (each.argval for each in dis.get_instructions(code))
    return not any(first == each or (isinstance(each, tuple) and first in each) for each in read)


def usable_names(labels: Iterable[str]) -> Names:
    """Return names of signals as a configuration may write them; their number where they are only counted.

    Examples
    --------
    >>> usable_names(["P_x[0]", "level"]), usable_names(["x[0]", "x[1]"]), usable_names(["u"])
    (['P_x_0', 'level'], 2, 1)
    """
    given = list(labels)
    names = [re.sub(r"\W+", "_", label).strip("_") for label in given]
    counted = all(re.fullmatch(r"[xuy](\[\d+\])?", label) for label in given)
    return len(given) if counted or not all(name.isidentifier() for name in names) else names
