"""From the keys of a configuration to a differential equation, or a map, and its integration over a sample.

Checks  The functions are called with plausible numbers around the initial state, within the bounds.  Inputs without
        bounds are standard normal, and parameters lie within 10 % of the nominal ones.
Trial   Four runs from the initial state over the whole horizon, with nominal parameters and no noise, give the range of
        every state and the steps that error control takes.  Two have inputs that are held for a tenth of the horizon,
        one has new inputs at every sample, and one has those at the middle of their bounds.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from timeit import default_timer
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from rmpc_bench.models.ode_functions import (
    Names,
    function_name,
    is_fed,
    is_timed,
    names_of,
    padded,
    refuse_shared,
    rows,
)
from rmpc_bench.plants.ode_stepping import (
    RunAdvance,
    Solver,
    Stepping,
    UserEvent,
    advance_block,
    advance_run,
    judged,
    parameters_of,
    read_events,
    rough_remark,
)
from rmpc_bench.types import Array, DesignError, Ode, Parameters, Status

ALONE, BLOCKS = 7, (7, 13, 50)
"""Runs that are compared alone, and sizes of the blocks that they are compared with."""
BENCH = __file__.removesuffix("plants/ode_design.py")
"""Directory of the bench, whose frames are left out of messages."""
RECORDED = ("x_hat", "P", "e", "r", "bursts")
"""Names of other signals that are recorded or drawn."""
SPREAD = 0.3
"""Standard deviation of a state without bounds, relative to 0.1 plus its initial magnitude."""


class Sample(NamedTuple):
    """Plausible numbers of some runs."""

    x: Float[Array, "runs nx"]
    u: Float[Array, "runs nu"]
    numbers: Float[Array, "runs n_parameters"]

    def run(self, ode: Ode, i: int) -> tuple[Array, Array, Parameters]:
        """Return state, inputs and parameters of one run, as numbers."""
        return self.x[i], self.u[i], parameters_of(ode, self.numbers[i])


def sample(ode: Ode, x0: Float[Array, " nx"], n_runs: int) -> Sample:
    """Return plausible numbers; the first run is at x0 with nominal parameters."""
    rng = np.random.Generator(np.random.PCG64(7))
    low, high = ode.limits(ode.states)
    bounded = np.isfinite(low) & np.isfinite(high)
    x = x0 + SPREAD * (0.1 + np.abs(x0)) * rng.standard_normal((n_runs, ode.nx))
    x = np.clip(np.where(bounded, _within(rng.random((n_runs, ode.nx)), low, high), x), low, high)
    nominal = np.array(list(ode.nominal.values()))
    numbers = nominal * rng.uniform(0.9, 1.1, (n_runs, len(nominal)))
    x[0], numbers[0] = np.clip(x0, low, high), nominal
    return Sample(x, inputs(ode, rng, (n_runs,)), numbers)


def inputs(ode: Ode, rng: np.random.Generator, shape: tuple[int, ...]) -> Float[Array, "*shape nu"]:
    """Draw inputs: uniform between two bounds, else standard normal within the one there is."""
    low, high = ode.limits(ode.inputs)
    bounded = np.isfinite(low) & np.isfinite(high)
    shares, normal = rng.random((*shape, ode.nu)), rng.standard_normal((*shape, ode.nu))
    drawn: Array = np.clip(np.where(bounded, _within(shares, low, high), normal), low, high)
    return drawn


def _within(shares: Array, low: Array, high: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return np.asarray(low + (high - low) * shares)


def rhs_takes_blocks(ode: Ode, x0: Float[Array, " nx"]) -> str:
    """Say why a right-hand side must be called run by run; empty where a block has the same bits as each run alone."""
    return _takes_blocks(partial(ode.slope, 0.0), ode, x0, "ode", function_name(ode.rhs))


def output_takes_blocks(ode: Ode, x0: Float[Array, " nx"], key: str = "output") -> str:
    """Say the same of an output function, which a key of the configuration names."""
    return _takes_blocks(ode.measure, ode, x0, key, function_name(ode.output))


def _takes_blocks(
    function: Callable[[Array, Array, Parameters], Array], ode: Ode, x0: Float[Array, " nx"], key: str, name: str
) -> str:
    """Compare blocks of runs with each run alone."""
    some = sample(ode, x0, max(BLOCKS))
    at = ", ".join(
        f"{each} = {value:g}" for each, value in zip((*ode.states, *ode.inputs), (*some.x[0], *some.u[0]), strict=True)
    )

    def values(part: slice) -> Array:
        chosen = Sample(*(each[part] for each in some))
        p = rows(ode.nominal, padded(chosen.numbers))
        found: Array = function(padded(chosen.x), padded(chosen.u), p)[:, : len(chosen.x)]
        return found

    def alone() -> Array:
        return function(*some.run(ode, 0))

    try:
        single = np.concatenate([values(slice(i, i + 1)) for i in range(ALONE)], axis=1)
        together = [values(slice(0, n)) for n in BLOCKS]
        shifted = values(slice(3, 3 + BLOCKS[1]))
    except Exception as error:
        _require_numbers(alone, at, key, name)
        _require_repeatable(alone, key, name)
        return f"a block of runs gives {describe_error(error)}"
    _require_repeatable(alone, key, name)
    same = all(_equal(each[:, :ALONE], single) for each in together)
    if not same or not _equal(shifted, together[-1][:, 3 : 3 + BLOCKS[1]]):
        return "a run in a block has other bits than alone"
    _require_finite(single[:, 0], at, key, name)
    return ""


def _require_numbers(alone: Callable[[], Array], at: str, key: str, name: str) -> None:
    """Call a function of the user with the numbers of the first run."""
    try:
        found = alone()
    except Exception as error:
        raise DesignError(f"{name} fails at {at}: {describe_error(error)}", key) from error
    _require_finite(found, at, key, name)


def _require_finite(found: Array, at: str, key: str, name: str) -> None:
    if not np.isfinite(found).all():
        values = ", ".join(f"{value:g}" for value in found)
        way_out = "give another initial.x, or bounds"
        raise DesignError(f"{name} returns {values} at {at}, which are not all finite; {way_out}", key)


def _require_repeatable(alone: Callable[[], Array], key: str, name: str) -> None:
    """Refuse a function of the user that gives other numbers for the same arguments."""
    try:
        first, second = alone(), alone()
    except Exception:
        # A function that only takes blocks; the caller reports one that takes neither.
        return
    if not _equal(first, second):
        text = f"{name} returns other numbers for the same arguments, as with random numbers or a memory of its own; "
        raise DesignError(f"{text}use noise.process, or a plant that is a class marked @single_run", key)


def describe_error(error: Exception) -> str:
    """Return type, message and place of an exception of a user's function: ``ValueError: .. (tanks.py:12)``."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [each for each in frames if not each.filename.startswith(BENCH) and "site-packages" not in each.filename]
    place = f" ({own[-1].filename.rpartition('/')[2]}:{own[-1].lineno})" if own else ""
    return f"{type(error).__name__}: {error}{place}"


def _equal(found: Array, expected: Array) -> bool:
    return np.array_equal(found, expected, equal_nan=True)


RUNS = 4
MAX_STEPS = 10_000
"""Steps of the trial runs after which they end, so that a plant with a long horizon is checked within seconds."""
COARSE, FINE = 1e-4, 1e-9
"""Tolerances with which the ranges are found, and with which a given number of steps is compared."""
SMALL = 1e-6
"""Error relative to the range of a state up to which a given number of steps is not remarked."""
MAX_EQUAL_STEPS = 50
"""Of code that takes equal steps: an equation with jumps or kinks has no number that is enough."""
GROWTH = 1e6
"""Range relative to that of the first tenth of the horizon at which a state is taken to grow without limit."""


class Trial(NamedTuple):
    """States and steps of the trial runs; NaN after a run has failed."""

    x: Float[Array, "runs samples nx"]
    steps: Int[Array, "runs samples"]
    rough: dict[int, int]  # a state that jumps or has a kink, and the sample in which it does so first
    failures: list[str]  # why runs could not be integrated


def scale_of(ode: Ode, Ts: float, n_steps: int, x0: Float[Array, " nx"]) -> Float[Array, " nx"]:
    """Return the range of every state; where it grows without limit, its range until then."""
    x = simulated(ode, Ts, n_steps, x0, Stepping(Solver(rtol=COARSE), 0, np.zeros(ode.nx), finds_ranges=True)).x
    with np.errstate(all="ignore"):
        high, low = np.fmax.accumulate(np.fmax.reduce(x), axis=0), np.fmin.accumulate(np.fmin.reduce(x), axis=0)
        early = (high - low)[_tenth(n_steps)]
        found = np.where((early == 0.0) | (high - low <= GROWTH * early), high - low, 0.0).max(axis=0)
    return np.asarray(np.where(np.isfinite(found), found, 0.0))


def tried(
    ode: Ode, Ts: float, n_steps: int, x0: Float[Array, " nx"], solver: Solver, events: tuple[UserEvent, ...]
) -> tuple[Stepping, list[str]]:
    """Return the integration by rk4, and what the trial runs show of it."""
    stepping = Stepping(solver, solver.substeps or 0, scale_of(ode, Ts, n_steps, x0), events)
    given = simulated(ode, Ts, n_steps, x0, stepping)
    if stepping.substeps:
        right = simulated(ode, Ts, n_steps, x0, stepping._replace(solver=Solver(rtol=FINE), substeps=0)).x
        off = np.nan_to_num(np.abs(given.x - right) / stepping.scale, posinf=0.0).max(axis=(0, 1))
        i = int(off.argmax())
        text = f"{ode.states[i]} is off by {off[i]:.1g} of its range in the trial runs"
        steps = f"{stepping.substeps} substep{'s' if stepping.substeps > 1 else ''} of rk4"
        return stepping, [f"with {steps} {text}; leave `substeps` out to control the error"] if off[i] > SMALL else []
    if len(given.failures) == RUNS and np.isnan(given.x[:, 1]).all():
        raise DesignError(given.failures[0], "solver")
    runs, samples = np.nonzero(np.isfinite(given.x[:, 1:]).all(axis=2))
    done = given.steps[runs, samples]
    most, mean = (int(done.max()), done.mean()) if len(done) else (0, 0.0)
    t = samples[done.argmax()] * Ts if len(done) else 0.0
    at = f"at most {most} at t = {t:.6g} {ode.time_unit}"
    remarks = [f"rk4 with error control: {mean:.1f} steps per sample, {at} (trial runs)"]
    remarks += [rough_remark(ode, state, k) for state, k in given.rough.items()]
    remarks += [f"a trial run has failed: {reason}" for reason in given.failures[:1]]
    # About half of the steps are kept; the others estimate the error.
    return stepping._replace(equal_steps=min((most + 1) // 2, MAX_EQUAL_STEPS)), remarks


def simulated(ode: Ode, Ts: float, n_steps: int, x0: Float[Array, " nx"], stepping: Stepping) -> Trial:
    """Simulate the trial runs, at most until `MAX_STEPS`."""
    u = _inputs(ode, n_steps)
    trial = Trial(np.full((RUNS, n_steps + 1, ode.nx), np.nan), np.zeros((RUNS, n_steps), dtype=int), {}, [])
    trial.x[:, 0], alive, spent = x0, list(range(RUNS)), 0
    for k in range(n_steps):
        try:
            ends = _advanced(ode, Ts, stepping, k, trial.x[alive, k], u[alive, k])
        # The functions are the user's: they may raise anything where a trial run has come to.
        except Exception:
            break
        for i, end in zip(alive, ends, strict=True):
            if end.status == Status.OK:
                trial.x[i, k + 1], trial.steps[i, k] = end.x, end.steps
            elif end.status == Status.NOT_CONVERGED:
                trial.failures.append(end.reason)
            if end.rough >= 0:
                trial.rough.setdefault(end.rough, k)
        alive = [i for i in alive if np.isfinite(trial.x[i, k + 1]).all()]
        # A step of a block is as expensive as that of one run.
        spent += max(stepping.substeps, int(trial.steps[:, k].max())) * (1 if ode.rhs_takes_blocks else RUNS)
        if not alive or spent > MAX_STEPS:
            break
    return trial


def _advanced(ode: Ode, Ts: float, stepping: Stepping, k: int, x: Array, u: Array) -> list[RunAdvance]:
    if ode.rhs_takes_blocks:
        numbers = np.tile(list(ode.nominal.values()), (len(x), 1))
        end = advance_block(ode, Ts, stepping, k, x, u, numbers)
        return [judged(ode, end, i, u[i]) for i in range(len(x))]
    return [advance_run(ode, Ts, stepping, k, row, given, ode.p) for row, given in zip(x, u, strict=True)]


def _inputs(ode: Ode, n_steps: int) -> Float[Array, "runs samples nu"]:
    u = inputs(ode, np.random.Generator(np.random.PCG64(11)), (RUNS, n_steps))
    tenth = _tenth(n_steps)
    u[:2] = u[:2, np.arange(n_steps) // tenth * tenth]
    low, high = ode.limits(ode.inputs)
    u[3] = np.clip(np.where(np.isfinite(low + high), (low + high) / 2, 0.0), low, high)
    return u


def _tenth(n_steps: int) -> int:
    return -(-n_steps // 10)


BLOCK, TIMED = 50, 2
"""Runs of a block for which a step is timed, and how often."""


def equation(
    rhs: Any,
    output: Any,
    states: Names,
    inputs: Names,
    outputs: Names | None,
    parameters: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    x0: Float[Array, " n"] | None,
    discrete: bool,
    time_unit: str,
    angles: Mapping[str, float] | None,
) -> tuple[Ode, dict[str, str]]:
    """Return the equation, and the reasons for which its functions are called run by run, by their name."""
    x_names, units = names_of(states, "states", "x")
    u_names, u_units = names_of(inputs, "inputs", "u")
    refuse_shared(x_names, u_names)
    if output is not None:
        if outputs is None:
            raise DesignError("name the outputs, or give their number", "outputs")
    elif outputs is not None and names_of(outputs, "outputs", "y")[0] != x_names:
        raise DesignError("without `output` all states are measured; give `output`, or leave `outputs` out", "outputs")
    y_names, y_units = (x_names, units) if outputs is None else names_of(outputs, "outputs", "y")
    for name in parameters:
        if not name.isidentifier() or name.startswith("_"):
            raise DesignError(f"{name!r} is no name: letters, digits and _, since rhs reads p.{name}", "parameters")
    nominal = {name: float(value) for name, value in parameters.items()}
    own = bounds_by_name(bounds, x_names, u_names)
    every_unit, timed = {**y_units, **u_units, **units}, is_timed(rhs)
    named = x_names, u_names, y_names
    record = Ode(rhs, output, *named, nominal, every_unit, own, timed, discrete=discrete, time_unit=time_unit)
    record = replace(record, angles=angles or {}, fed=is_fed(output))
    start = initial(record, x0)
    # A function may meet numbers here for which it is not defined.
    with np.errstate(all="ignore"):
        reasons = {function_name(rhs): rhs_takes_blocks(record, start)}
        measured = "" if output is None else output_takes_blocks(record, start)
    record = replace(record, rhs_takes_blocks=not any(reasons.values()), output_takes_blocks=not measured)
    if measured:
        reasons[function_name(output)] = measured
    return record, {name: reason for name, reason in reasons.items() if reason}


def extra_equation(
    ode: Ode, function: Any, names: Names | None, x0: Float[Array, " nx"] | None
) -> tuple[Ode | None, tuple[str, ...]]:
    """Return the equation whose outputs are the extra signals, None where there are none, and remarks."""
    if function is None:
        if names is not None:
            raise DesignError(
                "name what a function returns; give `extra_signal`, or leave the names out", "extra_signals"
            )
        return None, ()
    if names is None:
        raise DesignError("name the extra signals", "extra_signals")
    is_fed(function, "extra_signal", allowed=False)
    found, units = names_of(names, "extra_signals", "z")
    used = [name for name in found if name in (*ode.states, *ode.inputs, *ode.outputs, *RECORDED)]
    if used:
        raise DesignError(f"{used[0]!r} is the name of another signal already", "extra_signals")
    extra = replace(ode, output=function, outputs=found, units=units, fed=False)
    # A function may meet numbers here for which it is not defined.
    with np.errstate(all="ignore"):
        reason = output_takes_blocks(extra, initial(ode, x0), "extra_signal")
    remarks = (f"{function_name(function)} is called run by run: {reason}",) if reason else ()
    return replace(extra, output_takes_blocks=not reason), remarks


def bounds_by_name(
    bounds: Mapping[str, tuple[float, float]], states: tuple[str, ...], inputs: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    """Return the bounds of states and inputs, which may be given as ``x``, ``x.0`` or ``u.0``, by their names."""
    found = {name: bounds["x"] for name in states if "x" in bounds}
    for letter, names in (("x", states), ("u", inputs)):
        for i, name in enumerate(names):
            for each in (f"{letter}.{i}", name):
                if each in bounds:
                    found[name] = bounds[each]
    return found


def stepping_of(
    ode: Ode, Ts: float, n_steps: int, solver: Solver, events: Any, reasons: Mapping[str, str], x0: Array | None
) -> tuple[Stepping, tuple[str, ...], float]:
    """Return the integration over a sample, remarks on it, and its time per run and step [s]."""
    start = initial(ode, x0)
    if ode.discrete and solver != Solver():
        raise DesignError("has no effect beside `discrete: true`: rhs returns x(k+1)", "solver")
    found: tuple[UserEvent, ...] = () if events is None else read_events(events)
    if found and ode.discrete:
        raise DesignError("are located within a sample; with `discrete: true` there is nothing within one", "events")
    if found and solver.method == "rk4":
        raise DesignError("need a method of solve_ivp, such as solver: {method: RK45}", "events")
    remarks = [f"{name} is called run by run: {reason}" for name, reason in reasons.items()]
    stepping = Stepping(solver, solver.substeps or int(ode.discrete), np.zeros(ode.nx), found)
    with np.errstate(all="ignore"):
        if solver.method == "rk4" and not ode.discrete:
            stepping, more = tried(ode, Ts, n_steps, start, solver, found)
            remarks += more
        cost = _seconds(ode, Ts, stepping, start)
    if reasons or solver.method != "rk4":
        remarks.append(f"a step takes about {float(f'{1e6 * cost:.2g}'):g} us per run")
    return stepping, tuple(remarks), cost


def initial(ode: Ode, x0: Float[Array, " n"] | None) -> Float[Array, " nx"]:
    """Initial state within the bounds; 0 where none of this size is given, which is an error of `initial`."""
    given = np.zeros(ode.nx) if x0 is None or x0.shape not in ((1,), (ode.nx,)) else np.broadcast_to(x0, (ode.nx,))
    return np.asarray(np.clip(given, *ode.limits(ode.states)))


def _seconds(ode: Ode, Ts: float, stepping: Stepping, x0: Array) -> float:
    """Time of a step per run [s], measured."""
    in_block = ode.rhs_takes_blocks and stepping.in_blocks
    some, times = sample(ode, x0, BLOCK if in_block else 1), []
    # The first call imports and compiles what it needs.
    for _ in range(TIMED + 1):
        start = default_timer()
        if in_block:
            advance_block(ode, Ts, stepping, 0, *some)
        else:
            advance_run(ode, Ts, stepping, 0, *some.run(ode, 0))
        times.append(default_timer() - start)
    return min(times[1:]) / len(some.x)
