"""Plant given by an ordinary differential equation in a Python function.

Model   x' = rhs(t, x, u, p) with u held over a sample;  x(k+1) = x((k+1) Ts) + w(k),  y(k) = output(x(k), p) + v(k).
        The process noise w has one entry per state and is added to the sampled state.
Method  `rk4`: Runge-Kutta of order 4 with equal steps, for all runs of a block at once where rhs takes a block.
        LSODA, RK45, DOP853, Radau, BDF: `scipy.integrate.solve_ivp`, run by run.
Fails   Status `out-of-range`: a parameter is not finite, or a state has left its bounds within a sample.
        Status `not-converged`: `solve_ivp` gave up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics.integration import Advance, Bounds, rk4, sample_times
from rmpc_bench.plants.ode_names import Names, check_output, is_timed, names_of, refuse_shared
from rmpc_bench.types import (
    Array,
    Count,
    DesignError,
    Motion,
    Ode,
    Parameters,
    Plant,
    Positive,
    RunInfo,
    Status,
    Statuses,
    UserFunction,
)

WIDTH = 8
"""A block is filled up to a multiple of this many runs.  Sums and products of matrices take another path for a single
run, with other last bits than within a block."""


@dataclass(frozen=True)
class Solver:
    """Integration over one sample.

    Parameters
    ----------
    method : `rk4`, or a method of scipy.integrate.solve_ivp: `LSODA`, `RK45`, `DOP853`, `Radau`, `BDF`
    substeps : steps of `rk4` per sample
    rtol, atol : tolerances of the other methods (default 1e-8 and 1e-10)
    """

    method: Literal["rk4", "LSODA", "RK45", "DOP853", "Radau", "BDF"] = "rk4"
    substeps: Count | None = None
    rtol: Positive | None = None
    atol: Positive | None = None

    def __post_init__(self) -> None:
        """Refuse keys of other methods."""
        others = ("rtol", "atol") if self.method == "rk4" else ("substeps",)
        for name in others:
            if getattr(self, name) is not None:
                raise ValueError(f"the method {self.method!r} has no {name}")


class OdeDelta(NamedTuple):
    """Parameters of every run, in the order of their names."""

    numbers: Float[Array, "runs n_parameters"]
    status: Statuses
    runs: RunInfo | None = None
    """The runs of the block; None before `start`."""


@dataclass(frozen=True, eq=False)
class OdePlant(Plant):
    """A plant that integrates a differential equation; build it with `design`."""

    Ts: float
    ode: Ode
    solver: Solver
    substeps: int
    nominal: Mapping[str, float] = field(default_factory=dict)
    starts_runs = True

    @property
    def nx(self) -> int:
        """Number of states."""
        return self.ode.nx

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return self.ode.nu

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return self.ode.ny

    def draw(
        self, parameters: Mapping[str, Float[Array, " runs"]], rngs: Sequence[np.random.Generator], n_steps: int
    ) -> OdeDelta:
        """Return the parameters of every run; a run with one that is not finite gets the nominal ones and a status."""
        numbers = np.array([parameters[name] for name in self.nominal]).reshape(len(self.nominal), -1).T.copy()
        numbers = numbers if self.nominal else np.zeros((len(rngs), 0))
        good = np.isfinite(numbers).all(axis=1)
        numbers[~good] = list(self.nominal.values())
        return OdeDelta(numbers, np.where(good, Status.OK, Status.OUT_OF_RANGE).astype(np.int8))

    def start(self, delta: OdeDelta, x0: Float[Array, "runs nx"], runs: RunInfo) -> OdeDelta:
        """Keep the indices of the runs, to note their failures."""
        return delta._replace(runs=runs)

    def step(
        self,
        k: int,
        delta: OdeDelta,
        x: Float[Array, "runs nx"],
        u: Float[Array, "runs nu"],
        w: Float[Array, "runs nw"],
    ) -> Motion:
        """Integrate over sample k with constant inputs, then add the process noise."""
        low, high = self.ode.limits(self.ode.inputs)
        advance = self._block(k, delta, x, np.clip(u, low, high))
        left = np.where(advance.state >= 0, Status.OUT_OF_RANGE, Status.OK)
        return Motion(advance.x.T + w, np.where(delta.status != Status.OK, delta.status, left).astype(np.int8))

    def output(
        self, k: int, delta: OdeDelta, x: Float[Array, "runs nx"], v: Float[Array, "runs nv"]
    ) -> Float[Array, "runs ny"]:
        """Measure."""
        n = len(x)
        columns, p = _padded(x), _rows(self.nominal, _padded(delta.numbers))
        return self.ode.measure(columns, p)[:, :n].T + v

    def _block(self, k: int, delta: OdeDelta, x: Float[Array, "runs nx"], u: Float[Array, "runs nu"]) -> Advance:
        """Integrate all runs at once."""
        n = len(x)
        columns, inputs, p = _padded(x), _padded(u), _rows(self.nominal, _padded(delta.numbers))
        bounds = Bounds(*self.ode.limits(self.ode.states)) if self.ode.bounds else None
        times = sample_times(k, self.substeps, self.Ts)
        end = rk4(lambda t, z: self.ode.slope(t, z, inputs, p), times, columns, self.Ts / self.substeps, bounds)
        return Advance(end.x[:, :n], end.state[:n], end.t[:n])


def _padded(rows: Float[Array, "runs n"]) -> Float[Array, "n width"]:
    """Return runs as columns, and the last one again until there is a multiple of `WIDTH`."""
    return np.ascontiguousarray(np.pad(rows, ((0, -len(rows) % WIDTH), (0, 0)), mode="edge").T)


def _rows(names: Mapping[str, float], columns: Float[Array, "n_parameters width"]) -> Parameters:
    """Parameters by name, a row over the runs each, which the user's function cannot write into."""
    columns.flags.writeable = False
    return Parameters(dict(zip(names, columns, strict=True)))


def design(
    Ts: float,
    n_steps: int,
    *,
    ode: UserFunction,
    output: UserFunction = None,
    states: Names,
    inputs: Names = 0,
    outputs: Names | None = None,
    parameters: dict[str, float] | None = None,
    solver: Solver = Solver(),
    bounds: Any = None,
) -> OdePlant:
    """Ordinary differential equation in a Python function.

    Names may be a list, a mapping of names to units, or a count.

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    ode : ``PATH.py:NAME`` of rhs(x, u, p) or rhs(t, x, u, p), which returns the time derivatives of the states
    output : ``PATH.py:NAME`` of output(x, p), which returns the outputs; without it all states are measured
    states, inputs : names, such as ``[h1, h2]`` or ``{pump: ml/s}``
    outputs : names; needed with `output`
    parameters : name -> nominal value; `perturb` and `set` may name them, and rhs reads them as p.name or p["name"]
    solver : integration over one sample

    Raises
    ------
    DesignError
        If a function or a name is not what it must be.
    """
    x_names, units = names_of(states, "states", "x")
    u_names, u_units = names_of(inputs, "inputs", "u")
    refuse_shared(x_names, u_names)
    if output is not None:
        check_output(output)
        if outputs is None:
            raise DesignError("name the outputs, or give their number", "outputs")
    y_names, y_units = (x_names, units) if outputs is None else names_of(outputs, "outputs", "y")
    nominal = {str(name): float(value) for name, value in (parameters or {}).items()}
    pairs = {name: (float(low), float(high)) for name, (low, high) in (bounds or {}).items()}
    record = Ode(
        ode,
        output,
        x_names,
        u_names,
        y_names,
        nominal,
        {**u_units, **y_units, **units},
        pairs,
        is_timed(ode),
        True,
        True,
    )
    return OdePlant(float(Ts), record, solver, solver.substeps or 10, nominal)
