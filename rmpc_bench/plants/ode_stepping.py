"""Integration of a differential equation over one sample, or a map: for a block of runs, or for one run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.models.ode_blocks import padded, rows
from rmpc_bench.numerics.adaptive import Tolerances, solve
from rmpc_bench.numerics.integration import Advance, Bounds, Slope, apply_map, rk4, sample_times
from rmpc_bench.plants.ode_events import UserEvent
from rmpc_bench.types import Array, Count, Ode, Parameters, Positive, SolverError, Status


@dataclass(frozen=True)
class Solver:
    """Integration over one sample.

    Parameters
    ----------
    method : `rk4`, or a method of scipy.integrate.solve_ivp: `LSODA`, `RK45`, `DOP853`, `Radau`, `BDF`
    substeps : steps of `rk4` per sample; by default as many as it takes that twice as many change no sampled state of
        20 trial runs by more than 1e-9 of its range
    rtol, atol : tolerances of the other methods (default 1e-8 and 1e-10)
    """

    method: Literal["rk4", "LSODA", "RK45", "DOP853", "Radau", "BDF"] = "rk4"
    substeps: Count | None = None
    rtol: Positive | None = None
    atol: Positive | None = None

    def __post_init__(self) -> None:
        """Refuse keys of other methods."""
        for name in ("rtol", "atol") if self.method == "rk4" else ("substeps",):
            if getattr(self, name) is not None:
                raise ValueError(f"the method {self.method!r} has no {name}")

    @property
    def tolerances(self) -> Tolerances:
        """The integrator and its tolerances."""
        return Tolerances(self.method, self.rtol or 1e-8, self.atol or 1e-10)


class Stepping(NamedTuple):
    """How the plant integrates over a sample."""

    solver: Solver
    substeps: int
    """Of `rk4`; 0 for the other methods, 1 for a map."""
    events: tuple[UserEvent, ...] = ()


class RunAdvance(NamedTuple):
    """State of one run at the end of a sample."""

    x: Float[Array, " nx"]
    status: Status
    reason: str
    """Why the run has failed; empty where it has not."""


def advance_block(
    ode: Ode,
    Ts: float,
    substeps: int,
    k: int,
    x: Float[Array, "runs nx"],
    u: Float[Array, "runs nu"],
    numbers: Float[Array, "runs n_parameters"],
) -> Advance:
    """Integrate all runs of a block at once by `rk4`, or apply the map to them."""
    columns, inputs, p = padded(x), padded(u), rows(ode.nominal, padded(numbers))
    end = _advance(ode, lambda t, z: ode.slope(t, z, inputs, p), Ts, substeps, k, columns, state_bounds(ode))
    n = len(x)
    return Advance(end.x[:, :n], end.state[:n], end.t[:n])


def advance_run(
    ode: Ode, Ts: float, stepping: Stepping, k: int, x: Float[Array, " nx"], u: Float[Array, " nu"], p: Parameters
) -> RunAdvance:
    """Integrate one run, or apply the map to it."""
    bounds = state_bounds(ode)
    if stepping.solver.method == "rk4":
        try:
            end = _advance(ode, _one_column(ode, u, p, bounds), Ts, stepping.substeps, k, x[:, None], bounds)
        except SolverError as error:
            return RunAdvance(x, Status.NOT_CONVERGED, str(error))
        return _judged(ode, end.x[:, 0], int(end.state[0]), float(end.t[0]))
    events = [event.of_run(ode, u, p) for event in stepping.events]
    found = solve(
        lambda t, z: ode.slope(t, z, u, p), k * Ts, (k + 1) * Ts, x, stepping.solver.tolerances, bounds, events
    )
    if found.event >= 0:
        return RunAdvance(found.x, Status.OUT_OF_RANGE, f"{stepping.events[found.event].word} at {found.t:.6g} s")
    if found.crowded:
        return RunAdvance(found.x, Status.TOO_MANY_EVENTS, f"too many events in one sample at {found.t:.6g} s")
    if found.failure:
        return RunAdvance(found.x, Status.NOT_CONVERGED, f"{stepping.solver.method}: {found.failure}")
    return _judged(ode, found.x, found.state, found.t)


def _advance(
    ode: Ode, slope: Slope, Ts: float, substeps: int, k: int, x: Float[Array, "nx runs"], bounds: Bounds | None
) -> Advance:
    times = sample_times(k, substeps, Ts)
    if ode.discrete:
        return apply_map(slope, times[0], times[-1], x, bounds)
    return rk4(slope, times, x, Ts / substeps, bounds)


def left_bounds(ode: Ode, state: int, t: float) -> str:
    """Say that a state has left its bounds: ``h1 left its bounds [0.0001, 0.6] m at 12.3 s``."""
    return f"{ode.states[state]} left its bounds {ode.bounds_text(ode.states[state])} at {t:.6g} s"


def state_bounds(ode: Ode) -> Bounds | None:
    """Bounds of the states; None where no state has any."""
    return Bounds(*ode.limits(ode.states)) if any(name in ode.bounds for name in ode.states) else None


def _one_column(ode: Ode, u: Float[Array, " nu"], p: Parameters, bounds: Bounds | None) -> Slope:
    """Function rhs of one run as `rk4` takes it; beyond the bounds that of the nearest state inside."""

    def slope(t: float, x: Array) -> Array:
        # np.clip takes several times as long for a few numbers.
        inside = x[:, 0] if bounds is None else np.minimum(np.maximum(x[:, 0], bounds.low), bounds.high)
        # At what is not a number functions such as math.sin raise an exception.
        return (ode.slope(t, inside, u, p) if np.isfinite(inside).all() else np.full(ode.nx, np.nan))[:, None]

    return slope


def _judged(ode: Ode, x: Float[Array, " nx"], state: int, t: float) -> RunAdvance:
    if state < 0:
        return RunAdvance(x, Status.OK, "")
    return RunAdvance(x, Status.OUT_OF_RANGE, left_bounds(ode, state, t))
