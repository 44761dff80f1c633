"""The record of an ordinary differential equation or of a map: what a plant knows of it, and what design models use.

x' = rhs(t, x, u, p), or x(k+1) = rhs(k Ts, x(k), u(k), p) of a map;  y = output(x, p), or output(x, u, p)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float

from rmpc_bench.types.basics import Array
from rmpc_bench.types.errors import unknown
from rmpc_bench.types.signals import NamedSignals


class Parameters:
    """Parameters by name: ``p["a1"]`` and ``p.a1``; they cannot be changed.

    Parameters
    ----------
    values : name -> a number, or one per run

    Examples
    --------
    >>> p = Parameters({"a1": 0.5, "k": 2.0})
    >>> p.a1, p["k"], list(p)
    (0.5, 2.0, ['a1', 'k'])
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.__dict__.update(values)

    def __getitem__(self, name: str) -> Any:
        try:
            return self.__dict__[name]
        except KeyError:
            raise KeyError(unknown(name, self.__dict__, "parameter")) from None

    def __getattr__(self, name: str) -> NoReturn:
        # Called for unknown names only.  Copying and pickling ask for names with two underscores.
        known = () if name.startswith("__") else self.__dict__
        raise AttributeError(unknown(name, known, "parameter"))

    def __setattr__(self, name: str, value: Any) -> NoReturn:
        raise AttributeError(f"the parameter {name!r} cannot be changed")

    def __iter__(self) -> Iterator[str]:
        return iter(self.__dict__)

    def __len__(self) -> int:
        return len(self.__dict__)

    def __contains__(self, name: object) -> bool:
        return name in self.__dict__

    def keys(self) -> Iterator[str]:
        """Names of the parameters, so that ``**p`` passes them on."""
        return iter(self.__dict__)


@dataclass(frozen=True, eq=False)
class Ode(NamedSignals):
    """An ordinary differential equation, or a map, with its names; nothing in it is drawn.

    Parameters
    ----------
    rhs : the user's function rhs(x, u, p) or, with `timed`, rhs(t, x, u, p); returns nx time derivatives, or x(k+1)
        with `discrete`
    output : the user's function output(x, p) or, with `fed`, output(x, u, p), which returns ny numbers; None
        where all states are measured
    states, inputs, outputs : names
    nominal : name of a parameter -> nominal value
    units : name of a state, an input or an output -> unit; names without one are left out
    bounds : name of a state or an input -> lower and upper bound; infinite where there is none
    timed : whether rhs depends on the time
    rhs_takes_blocks, output_takes_blocks : whether the function gives the same bits for a block of runs, x of shape
        (nx, runs), as for each run alone
    substeps : given steps of the Runge-Kutta method per sample in the plant; 0 without, 1 for a map
    scale : range of every state in the trial runs of the plant; 0 where it is not known
    equal_steps : half of the largest number of steps per sample in the trial runs, at most 50; 0 where it is not known.
        About half of the steps of error control are kept; the others estimate the error
    discrete : whether rhs is a map, which returns x(k+1)
    time_unit : unit of the time in texts
    angles : name of a state or an output that is an angle -> its period
    fed : whether output depends on the input
    """

    rhs: Callable[..., Any]
    output: Callable[..., Any] | None
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    nominal: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    timed: bool = False
    rhs_takes_blocks: bool = False
    output_takes_blocks: bool = False
    substeps: int = 0
    scale: tuple[float, ...] = ()
    equal_steps: int = 0
    discrete: bool = False
    time_unit: str = "s"
    angles: Mapping[str, float] = field(default_factory=dict)
    fed: bool = False

    @property
    def p(self) -> Parameters:
        """The nominal parameters."""
        return Parameters(self.nominal)

    def slope(
        self, t: float, x: Float[Array, nx * runs], u: Float[Array, nu * runs], p: Parameters
    ) -> Float[Array, nx * runs]:
        """Call rhs with its own copies of x and u; x(k+1) of a map.

        Parameters
        ----------
        t : time [s]
        x, u : of one run, or of a block where rhs takes one
        p : numbers, or rows over the runs of the block

        Raises
        ------
        ValueError
            If rhs returns anything but nx numbers, or rows over the runs.
        """
        values = self.rhs(t, x.copy(), u.copy(), p) if self.timed else self.rhs(x.copy(), u.copy(), p)
        return _collected("rhs", values, "state", self.states, x.shape[1:])

    def as_state(self, function: str, values: Any) -> Float[Array, " nx"]:
        """Copy the state of one run that a user's function has returned."""
        return _collected(function, values, "state", self.states, ())

    def measure(self, x: Float[Array, nx * runs], u: Any, p: Parameters) -> Float[Array, ny * runs]:
        """Call output with its own copies of x and, where it takes it, u."""
        values = x if self.output is None else self.output(x.copy(), *([u.copy()] if self.fed else []), p)
        return _collected("output", values, "output", self.outputs, x.shape[1:])


def _collected(
    function: str, values: Any, noun: str, names: Sequence[str], shape: tuple[int, ...]
) -> Float[Array, n * runs]:
    """Copy what a user's function has returned: its caller may use the same memory again."""
    if values is None:
        raise ValueError(f"{function} returned None: it must return {_count(len(names), noun)} ({', '.join(names)})")
    n = len(names)
    result = np.empty((n, *shape))
    if isinstance(values, np.ndarray) and values.shape == result.shape:
        if values.dtype.kind == "c":
            raise ValueError(f"{function} returned complex numbers")
        result[...] = values
        return result
    if n == 1 and np.shape(values) in ((), shape):
        values = [values]
    entries = list(values) if np.iterable(values) else [values]
    if len(entries) != n:
        raise ValueError(f"{function} returned {_count(len(entries), 'number')}; {noun}s: {n} ({', '.join(names)})")
    for i, entry in enumerate(entries):
        if np.shape(entry) not in ((), shape):
            raise ValueError(f"{function} returned an entry of shape {np.shape(entry)} for {names[i]}; {shape} fits")
        result[i] = entry
    return result


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
