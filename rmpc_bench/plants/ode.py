"""Plant given by an ordinary differential equation, or by a map, in a Python function.

Model   x' = rhs(t, x, u, p) with u held over a sample;  x(k+1) = x((k+1) Ts) + w(k),  y(k) = output(x(k), p) + v(k).
        The process noise w has one entry per state and is added to the sampled state.  With `discrete: true`
        x(k+1) = rhs(k Ts, x(k), u(k), p) + w(k).
Method  `rk4`: Runge-Kutta of order 4, for all runs of a block at once where rhs takes a block.  Every run controls its
        own error by halving (numerics/integration.py), relative to the range of a state in four trial runs; `substeps`
        gives equal steps.  LSODA, RK45, DOP853, Radau, BDF: `scipy.integrate.solve_ivp`, run by run.
Names   `bounds` and `diverged` may use them.  Inputs are clipped to their bounds, and how often is counted.
Blocks  Written with functions of NumPy, rhs computes all runs of a block in one call: x[i] and p.name are rows over the
        runs.  The design tests whether the bits are those of each run alone.  A rhs with `if x[0] > 0`, `max` or
        `math.sin` is called run by run.
Events  With the methods of `solve_ivp` a function event(x, u, p) or event(t, x, u, p) is located.  Where it passes
        through 0 the run ends with the text in its attribute `word`, or continues from the state that its attribute
        `reset`, a function, returns.  `direction` is 1 for upwards only, -1 for downwards only.
Fails   Status `out-of-range`: a parameter is not finite, a state has left its bounds within a sample, or an event has
        ended the run.  Status `not-converged`: the integrator failed, or the error of `rk4` is too large with 1/512 of
        a sample.  Status `too-many-events`: more than 32 events in one sample.
Jumps   A jump of rhs at a sample is exact: it belongs to the sample that begins there.  `rk4` locates one within a
        sample to 1/512 of it.  A change of rhs(t) that is over within a quarter of a sample may be missed.  Dry
        friction takes up to 1500 steps per sample; `substeps: 50` takes fewer.
Cost    About 20 us per run and sample for two states with `substeps: 10` in a block of 50 runs; five to twenty times as
        much run by run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.ode_functions import Names, function_name
from rmpc_bench.plants.ode_design import equation, extra_equation, stepping_of
from rmpc_bench.plants.ode_stepping import (
    RunAdvance,
    Solver,
    Stepping,
    advance_runs,
    left_bounds,
    measured,
    rough_remark,
    rows_where,
    state_bounds,
)
from rmpc_bench.types import (
    Array,
    Motion,
    Ode,
    Plant,
    RunFailure,
    RunInfo,
    Status,
    Statuses,
    UserFunction,
)
from rmpc_bench.types.plant import Generators, Inputs, InputSteps, Noises, Outputs, ParameterValues, States, StateSteps

EQUATION = r"""\dot x = f(t, x, u_k, p), \quad
k T_s \le t \lt (k + 1) T_s, \quad x_{k+1} = x((k+1) T_s) + w_k, \quad y_k = h(x_k, p) + v_k"""


DEFAULT_SOLVER = Solver()
OK, OUT_OF_RANGE = np.int8(Status.OK), np.int8(Status.OUT_OF_RANGE)


class OdeDelta(NamedTuple):
    """Parameters of every run, in the order of their names."""

    numbers: Float[Array, "runs n_parameters"]
    status: Statuses
    runs: RunInfo | None = None  # within a simulation, which knows them

    @property
    def alive(self) -> list[int]:
        """Rows of the runs that have not failed."""
        return list(range(len(self.status))) if self.runs is None else rows_where(self.runs.alive)


@dataclass(frozen=True, eq=False)
class OdePlant(Plant):
    """A plant that integrates a differential equation; build it with `design`."""

    Ts: float
    ode: Ode
    stepping: Stepping
    nominal: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    cost_per_step: float = 0.0
    extra: Ode | None = None  # the equation with the extra signals as its outputs; None where there are none
    starts_runs = True

    @property
    def y_unit(self) -> str:
        """Unit of all outputs; empty where they differ in it."""
        return _common(self.ode, self.ode.outputs)

    @property
    def u_unit(self) -> str:
        """Unit of all inputs; empty where they differ in it."""
        return _common(self.ode, self.ode.inputs)

    @property
    def extra_signals(self) -> Mapping[str, str]:
        """Names of the extra signals with their units."""
        return {} if self.extra is None else {name: self.extra.units.get(name, "") for name in self.extra.outputs}

    def extra_signal(
        self, name: str, delta: OdeDelta, x: Float[Array, "runs samples nx"]
    ) -> Float[Array, "runs samples"]:
        """Return an extra signal with the parameters of every run."""
        assert self.extra is not None
        flat, numbers = x.reshape(-1, self.nx), np.repeat(delta.numbers, x.shape[1], axis=0)
        # A failed run may have states for which the function is not defined.
        finite = rows_where(np.isfinite(flat).all(axis=1))
        with np.errstate(all="ignore"):
            found = measured(self.extra, flat, np.zeros((len(flat), 0)), numbers, finite)
        return np.ascontiguousarray(found[:, self.extra.outputs.index(name)]).reshape(x.shape[:2])

    @property
    def has_between(self) -> bool:
        """Whether there is anything between two samples: not with a map."""
        return not self.ode.discrete

    def between(
        self, delta: OdeDelta, x: StateSteps, u: InputSteps, parts: int, first: int = 0
    ) -> Float[Array, "runs steps parts nx"]:
        """Integrate every period in equal parts by the integrator of the plant; failed runs keep their state."""
        shorter = self.stepping._replace(substeps=ceil(self.stepping.substeps / parts))
        states = np.empty((*x.shape[:2], parts, self.nx))
        for k in range(x.shape[1]):
            now, inputs = x[:, k], u[:, k]
            for part in range(parts):
                number = (first + k) * parts + part
                now, _ = advance_runs(
                    self.ode, self.Ts / parts, shorter, number, now, inputs, delta.numbers, delta.alive
                )
                states[:, k, part] = now
        return states

    def facts(self) -> list[tuple[str, str]]:
        """Names with units and bounds, and the integration over a sample."""
        ode, stepping = self.ode, self.stepping
        arguments, left = "t, x, u, p" if ode.timed else "x, u, p", "x(k+1)" if ode.discrete else "x'"
        in_blocks, words = ode.rhs_takes_blocks and stepping.in_blocks, [event.word for event in stepping.events]
        return [
            ("equation", f"{left} = {function_name(ode.rhs)}({arguments})"),
            ("states", _names(ode, ode.states)),
            ("inputs", _names(ode, ode.inputs) or "none"),
            ("outputs", _names(ode, ode.outputs) + (" (all states)" if ode.output is None else "")),
            *([] if self.extra is None else [("extra signals", _names(self.extra, self.extra.outputs))]),
            ("parameters", ", ".join(f"{name} = {value:g}" for name, value in ode.nominal.items()) or "none"),
            *([] if ode.discrete else [("solver", _solver(stepping))]),
            ("calls of rhs", "all runs of a block at once" if in_blocks else "run by run"),
            *(("event", f"ends the run: {word}" if word else "replaces the state") for word in words),
        ]

    def draw(self, parameters: ParameterValues, rngs: Generators, n_steps: int) -> OdeDelta:
        """Return the parameters of every run; a run with one that is not finite gets the nominal ones and a status."""
        columns = [parameters[name] for name in self.nominal]
        numbers = np.stack(columns, axis=1).astype(float) if columns else np.zeros((len(rngs), 0))
        good = np.isfinite(numbers).all(axis=1)
        numbers[~good] = list(self.nominal.values())
        return OdeDelta(numbers, np.where(good, OK, OUT_OF_RANGE))

    def start(self, delta: OdeDelta, x0: States, runs: RunInfo) -> OdeDelta:
        """Add the runs, to note their failures; those that fail before the first sample are noted."""
        for i in rows_where(delta.status != OK):
            _note(runs, i, 0, RunAdvance(x0[i], Status.OUT_OF_RANGE, "a parameter is not a finite number"))
        for i, name in self._outside(x0):
            reason = f"{name} starts outside its bounds {self.ode.bounds_text(name)}"
            _note(runs, i, 0, RunAdvance(x0[i], Status.OUT_OF_RANGE, reason))
        return delta._replace(runs=runs)

    def step(self, k: int, delta: OdeDelta, x: States, u: Inputs, w: Noises) -> Motion:
        """Integrate over sample k with constant inputs, then add the process noise."""
        runs = delta.runs
        # Beyond its bounds a state may be one for which rhs is not defined.
        with np.errstate(all="ignore"):
            x_next, found = advance_runs(self.ode, self.Ts, self.stepping, k, x, u, delta.numbers, delta.alive)
        failed = {i: end for i, end in found.items() if end.status != Status.OK}
        x_next = x_next + w
        for i, name in self._outside(x_next):
            reason = left_bounds(self.ode, self.ode.states.index(name), (k + 1) * self.Ts)
            failed.setdefault(i, RunAdvance(x_next[i], Status.OUT_OF_RANGE, reason))
        status = delta.status.copy()
        for i, end in failed.items():
            status[i] = status[i] or end.status
            if runs is not None:
                _note(runs, i, k, end, x=x[i].tolist(), u=u[i].tolist())
        for end in found.values():
            if end.rough >= 0 and runs is not None:
                runs.journal.warnings[rough_remark(self.ode, end.rough, k)] += 1
        return Motion(x_next, status)

    def output(self, k: int, delta: OdeDelta, x: States, v: Noises, *u: Array) -> Outputs:
        """Measure."""
        inputs = u[0] if u else np.zeros((len(x), 0))
        return measured(self.ode, x, inputs, delta.numbers, delta.alive) + v

    def _outside(self, x: States) -> list[tuple[int, str]]:
        """Rows and the first state of each that is outside its bounds."""
        bounds = state_bounds(self.ode)
        if bounds is None or not (out := bounds.outside(x.T)).any():
            return []
        return [(i, self.ode.states[int(out[:, i].argmax())]) for i in rows_where(out.any(axis=0))]


def _names(ode: Ode, names: Sequence[str]) -> str:
    """List names with their units and bounds."""
    units = {name: f" [{ode.units[name]}]" for name in names if name in ode.units}
    words = {name: "within" if name in ode.states else "limited to" for name in names if name in ode.bounds}
    bounds = {name: f" {word} {ode.bounds_text(name).split(']')[0]}]" for name, word in words.items()}
    return ", ".join(f"{name}{units.get(name, '')}{bounds.get(name, '')}" for name in names)


def _solver(stepping: Stepping) -> str:
    solver = stepping.solver
    if solver.method != "rk4":
        return f"{solver.method}, rtol {solver.tolerances.rtol:g}, atol {solver.tolerances.atol:g}"
    if stepping.substeps:
        return f"rk4, {stepping.substeps} substeps per sample"
    return f"rk4, error control to {stepping.tolerance.rtol:g} of the range of a state"


def _note(runs: RunInfo, row: int, k: int, end: RunAdvance, **values: Any) -> None:
    """Note why a run has failed, unless it had failed before."""
    if runs.alive[row]:
        runs.journal.fail(RunFailure(runs.index[row], int(end.status), "plant", k, end.reason, "", values))


def _common(ode: Ode, names: Sequence[str]) -> str:
    units = {ode.units.get(name, "") for name in names}
    return units.pop() if len(units) == 1 else ""


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
    solver: Solver = DEFAULT_SOLVER,
    events: UserFunction = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    x0: Any = None,
    discrete: bool = False,
    extra_signal: UserFunction = None,
    extra_signals: Names | None = None,
    angles: Mapping[str, float] | None = None,
    time_unit: str = "s",
) -> OdePlant:
    """Ordinary differential equation in a Python function.

    Names are a list, a mapping to units, or a count (x.0, x.1 ..).

    Parameters
    ----------
    Ts : sampling time [s]
    n_steps : number of control periods N
    ode : rhs(x, u, p) or rhs(t, x, u, p), which returns x', or x(k+1) with `discrete`
    output : output(x, p) or output(x, u, p), u as it acts (default: all states)
    states, inputs : names, such as ``{pump: ml/s}``
    outputs : names; needed with `output`
    parameters : name -> nominal value; `perturb` and `set` may name them; p.name or p["name"] in rhs
    solver : integration over one sample
    events : an event, or a list of events; only with the methods of `solve_ivp`
    bounds : name of a state or an input -> lower and upper bound
    x0 : (nx,) initial state, from which the functions are tried
    discrete : whether rhs returns x(k+1) in place of time derivatives
    extra_signal : extra_signal(x, p): signals that are not measured, for metrics and `record`
    extra_signals : their names, such as ``{torque: N m}``
    angles : name of a state or an output that counts modulo a period -> this period
    time_unit : unit of the time in texts

    Raises
    ------
    DesignError
        If a function or a name is not what it must be, or fails at the initial state.

    Examples
    --------
    >>> plant = design(0.1, 100, ode=lambda x, u, p: [x[1], u[0] - p.k * x[0]], states=["s", "v"], inputs=["f"],
    ...     parameters={"k": 2.0})
    >>> plant.nx, plant.nominal, plant.ode.rhs_takes_blocks
    (2, {'k': 2.0}, True)
    """
    start = None if x0 is None else np.atleast_1d(np.asarray(x0, dtype=float))
    given = states, inputs, outputs, parameters or {}, bounds or {}
    record, reasons = equation(ode, output, *given, start, discrete, time_unit, angles)
    stepping, remarks, cost = stepping_of(record, float(Ts), n_steps, solver, events, reasons, start)
    scale = tuple(stepping.scale.tolist())
    record = replace(record, substeps=stepping.substeps, scale=scale, equal_steps=stepping.equal_steps)
    extra, more = extra_equation(record, extra_signal, extra_signals, start)
    return OdePlant(float(Ts), record, stepping, record.nominal, remarks + more, cost, extra)
