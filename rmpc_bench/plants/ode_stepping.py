"""Integration of a differential equation over one sample, or a map, for a block of runs or one run; and its events.

An event is a function event(x, u, p) or event(t, x, u, p) of one run, which passes through 0 when it happens.  Its
attribute `word` is a text: the run ends there.  Its attribute `reset` is a function with the same arguments that
returns the new state.  Its attribute `direction` is 1 for upwards only, -1 for downwards only, 0 (default) for both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.ode_functions import alone, function_name, is_timed, padded, rows, slopes
from rmpc_bench.numerics.integration import (
    LARGEST_ERROR,
    Advance,
    Bounds,
    Event,
    Slopes,
    Tolerance,
    Tolerances,
    apply_map,
    at_start,
    halve,
    inside,
    rk4,
    sample_times,
    solve,
)
from rmpc_bench.types import Array, Count, DesignError, Ode, Parameters, Positive, SolverError, Status
from rmpc_bench.types.plant import Inputs, Outputs, States


class UserEvent(NamedTuple):
    """An event of a user's file."""

    function: Callable[..., Any]
    timed: bool
    word: str  # what ends the run; empty where the state is replaced
    reset: Callable[..., Any] | None
    reset_timed: bool
    direction: float

    def of_run(self, ode: Ode, u: Float[Array, " nu"], p: Parameters) -> Event:
        """Return the event of one run over one sample."""

        def value(t: float, x: Array) -> float:
            return float(_called(self.function, self.timed, t, x, u, p))

        def reset(t: float, x: Array) -> Array:
            assert self.reset is not None
            return ode.as_state("reset", _called(self.reset, self.reset_timed, t, x, u, p))

        return Event(value, self.direction, reset if self.reset is not None else None)


def read_events(given: Any) -> tuple[UserEvent, ...]:
    """Return the events of a function, or of a list or tuple of functions."""
    found = []
    for function in given if isinstance(given, list | tuple) else [given]:
        timed, name = is_timed(function, "events"), function_name(function)
        word, reset = str(getattr(function, "word", "")), getattr(function, "reset", None)
        if bool(word) == (reset is not None):
            message = f"{name} must have either the attribute `word`, a text with which the run ends, or `reset`, a "
            raise DesignError(
                message + f"function that returns the new state, such as {name}.word = 'overflow'", "events"
            )
        direction = getattr(function, "direction", 0)
        if not isinstance(direction, int | float):
            raise DesignError(f"{name}.direction must be -1, 0 or 1 (got {direction!r})", "events")
        reset_timed = reset is not None and is_timed(reset, "events")
        found.append(UserEvent(function, timed, word, reset, reset_timed, float(np.sign(direction))))
    return tuple(found)


def _called(function: Callable[..., Any], timed: bool, t: float, x: Array, u: Array, p: Parameters) -> Any:
    """Call with copies of x and u."""
    return function(t, x.copy(), u.copy(), p) if timed else function(x.copy(), u.copy(), p)


Numbers = Float[Array, "runs n_parameters"]
"""Parameters of every run, in the order of their names."""
RTOL = 1e-7
"""Default of `rtol` with `rk4`."""
IMPLICIT = "solver: {method: LSODA}"


@dataclass(frozen=True)
class Solver:
    """Integration over one sample.

    Parameters
    ----------
    method : `rk4`, or one of scipy.integrate.solve_ivp
    substeps : number of equal steps of `rk4` per sample; by default every run controls its own error
    rtol : tolerance of an interval; of `rk4` relative to the range of a state in trial runs (default 1e-7, of the other
        methods 1e-8)
    atol : absolute tolerance of the other methods (default 1e-10)
    """

    method: Literal["rk4", "LSODA", "RK45", "DOP853", "Radau", "BDF"] = "rk4"
    substeps: Count | None = None
    rtol: Positive | None = None
    atol: Positive | None = None

    def __post_init__(self) -> None:
        """Refuse keys of other methods."""
        name = "atol" if self.method == "rk4" else "substeps"
        if getattr(self, name) is not None:
            raise ValueError(f"the method {self.method!r} has no {name}")
        if self.substeps is not None and self.rtol is not None:
            raise ValueError("rtol has no effect beside substeps, a fixed number of steps; leave one of them out")

    @property
    def tolerances(self) -> Tolerances:
        """The integrator and its tolerances."""
        return Tolerances(self.method, self.rtol or 1e-8, self.atol or 1e-10)


class Stepping(NamedTuple):
    """How the plant integrates over a sample."""

    solver: Solver
    substeps: int
    """Of `rk4`, 1 for a map; 0 with error control, and for the other methods."""
    scale: Float[Array, " nx"]
    """Range of every state in the trial runs, for error control."""
    events: tuple[UserEvent, ...] = ()
    equal_steps: int = 0
    """As in `Ode`."""
    finds_ranges: bool = False
    """Whether these are the runs that find the ranges; no error ends them, since it has no size yet."""

    @property
    def in_blocks(self) -> bool:
        """Whether all runs of a block are integrated at once, where rhs takes a block."""
        return self.solver.method == "rk4"

    @property
    def tolerance(self) -> Tolerance:
        """Of error control."""
        return Tolerance(self.solver.rtol or RTOL, self.scale, np.inf if self.finds_ranges else LARGEST_ERROR)


class RunAdvance(NamedTuple):
    """State of one run at the end of a sample."""

    x: Float[Array, " nx"]
    status: Status
    reason: str  # why the run has failed; empty where it has not
    rough: int = -1  # state that jumps or has a kink; -1 where none does
    steps: int = 0  # steps computed under error control


def advance_block(ode: Ode, Ts: float, stepping: Stepping, k: int, x: States, u: Inputs, numbers: Numbers) -> Advance:
    """Integrate all runs of a block at once by `rk4`, or apply the map to them."""
    if not len(x):
        return at_start(x.T, 0)
    return _advance(ode, slopes(ode, u, numbers), Ts, stepping, k, np.ascontiguousarray(x.T), state_bounds(ode))


def advance_run(
    ode: Ode, Ts: float, stepping: Stepping, k: int, x: Float[Array, " nx"], u: Float[Array, " nu"], p: Parameters
) -> RunAdvance:
    """Integrate one run, or apply the map to it."""
    bounds = state_bounds(ode)
    if stepping.solver.method == "rk4":
        errors: list[Exception] = []
        end = _advance(ode, alone(_inside_bounds(ode, p, bounds), u[None], errors), Ts, stepping, k, x[:, None], bounds)
        ended = judged(ode, end, 0, u)
        if not errors or (ended.status == Status.OK and np.isfinite(ended.x).all()):
            return ended
        if isinstance(errors[0], SolverError):
            return RunAdvance(x, Status.NOT_CONVERGED, str(errors[0]))
        raise errors[0]
    events = [event.of_run(ode, u, p) for event in stepping.events]
    slope = inside(lambda t, z: ode.slope(t, z, u, p), k, Ts)
    found = solve(slope, k * Ts, (k + 1) * Ts, x, stepping.solver.tolerances, bounds, events)
    at = f"at {found.t:.6g} {ode.time_unit}"
    if found.event >= 0:
        return RunAdvance(found.x, Status.OUT_OF_RANGE, f"{stepping.events[found.event].word} {at}")
    if found.crowded:
        return RunAdvance(found.x, Status.TOO_MANY_EVENTS, f"too many events in one sample {at}")
    if found.failure:
        return RunAdvance(found.x, Status.NOT_CONVERGED, f"{stepping.solver.method}: {found.failure}")
    if found.state >= 0:
        return RunAdvance(found.x, Status.OUT_OF_RANGE, left_bounds(ode, found.state, found.t))
    return RunAdvance(found.x, Status.OK, "")


def advance_runs(
    ode: Ode, Ts: float, stepping: Stepping, k: int, x: States, u: Inputs, numbers: Numbers, chosen: Sequence[int]
) -> tuple[States, dict[int, RunAdvance]]:
    """Integrate the chosen runs, at once where that is possible; return all states, and by row how runs have ended.

    Of a block these are the runs that failed or are not exact.
    """
    states, found = x.copy(), dict[int, RunAdvance]()
    if ode.rhs_takes_blocks and stepping.in_blocks:
        try:
            end = advance_block(ode, Ts, stepping, k, x[chosen], u[chosen], numbers[chosen])
            states[chosen] = end.x.T
            for j in rows_where((end.state >= 0) | end.failed | (end.rough >= 0)):
                found[chosen[j]] = judged(ode, end, j, u[chosen[j]])
            return states, found
        except SolverError:
            # A solver within rhs has failed in one of the runs.
            pass
    for i in chosen:
        found[i] = advance_run(ode, Ts, stepping, k, x[i], u[i], parameters_of(ode, numbers[i]))
        states[i] = found[i].x
    return states, found


def rows_where(condition: Any) -> list[int]:
    """Return the places of true entries."""
    places: list[int] = np.flatnonzero(condition).tolist()
    return places


def parameters_of(ode: Ode, numbers: Float[Array, " n_parameters"]) -> Parameters:
    """Return the parameters of one run by name."""
    return Parameters(dict(zip(ode.nominal, numbers.tolist(), strict=True)))


def measured(ode: Ode, x: States, u: Inputs, numbers: Numbers, chosen: Sequence[int]) -> Outputs:
    """Return the outputs of all runs where the function takes a block, else those of the chosen ones and NaN."""
    if ode.output_takes_blocks:
        with np.errstate(all="ignore"):
            return ode.measure(padded(x), padded(u), rows(ode.nominal, padded(numbers)))[:, : len(x)].T
    y = np.full((len(x), ode.ny), np.nan)
    for i in chosen:
        y[i] = ode.measure(x[i], u[i], parameters_of(ode, numbers[i]))
    return y


def judged(ode: Ode, end: Advance, i: int, u: Float[Array, " nu"]) -> RunAdvance:
    """Say how a run of a block has ended."""
    x, state, t = end.x[:, i], int(end.state[i]), float(end.t[i])
    if state >= 0:
        return RunAdvance(x, Status.OUT_OF_RANGE, left_bounds(ode, state, t))
    if end.failed[i]:
        pairs = zip((*ode.states, *ode.inputs), (*x, *u), strict=True)
        at = ", ".join(f"{name} = {value:.6g}" for name, value in pairs)
        reason = f"the error of rk4 is too large at t = {t:.6g} {ode.time_unit}, {at}, even with 1/512 of a sample"
        why = "the equation is stiff or a state grows without limit"
        return RunAdvance(x, Status.NOT_CONVERGED, f"{reason}: {why}; try {IMPLICIT}")
    return RunAdvance(x, Status.OK, "", int(end.rough[i]), int(end.steps[i]))


def _advance(
    ode: Ode, of: Slopes, Ts: float, stepping: Stepping, k: int, x: Float[Array, "nx runs"], bounds: Bounds | None
) -> Advance:
    n = stepping.substeps
    if not n:
        return halve(of, k, Ts, x, stepping.tolerance, bounds=bounds)
    slope, times = of(np.arange(x.shape[1])), sample_times(k, n, Ts)
    if ode.discrete:
        return apply_map(slope, times[0], times[-1], x, bounds)
    return rk4(inside(slope, k, Ts), times, x, Ts / n, bounds)


def left_bounds(ode: Ode, state: int, t: float) -> str:
    """Say that a state has left its bounds: ``h1 left its bounds [0.0001, 0.6] m at 12.3 s``."""
    return f"{ode.states[state]} left its bounds {ode.bounds_text(ode.states[state])} at {t:.6g} {ode.time_unit}"


def rough_remark(ode: Ode, state: int, k: int) -> str:
    """Say that a state could not be integrated to the tolerance, in the same words for most runs."""
    if ode.timed:
        way = "choose a sampling time for which it falls on a sample, or accept an error of up to 1/512 of a sample"
        return f"{ode.states[state]} jumps or has a kink inside sample {k}; {way}"
    way = "`solver: {substeps: 50}` is faster and less exact there"
    return f"{ode.states[state]} jumps or has a kink inside a sample; {way}"


def state_bounds(ode: Ode) -> Bounds | None:
    """Bounds of the states; None where no state has any."""
    return Bounds(*ode.limits(ode.states)) if any(name in ode.bounds for name in ode.states) else None


def _inside_bounds(ode: Ode, p: Parameters, bounds: Bounds | None) -> Callable[[float, Array, Array], Array]:
    """Function rhs of one run; beyond the bounds that of the nearest state inside."""
    if bounds is None:
        return lambda t, x, u: ode.slope(t, x, u, p)
    # np.clip takes several times as long for a few numbers.
    return lambda t, x, u: ode.slope(t, np.minimum(np.maximum(x, bounds.low), bounds.high), u, p)
