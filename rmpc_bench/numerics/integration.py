"""The Runge-Kutta method of order 4 and maps for a block of runs, with bounds of the states.

Axis 0 of x is the state and axis 1 the run, as in the functions of users: x[i] is a row over the runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rmpc_bench.types import Array

Slope = Callable[[float, Array], Array]
"""Time derivative of x at t, for all runs."""
EDGE = 1e-9
"""Part of a sample at its beginning and end within which no time lies at which a slope is asked."""


class Bounds(NamedTuple):
    """Bounds of the states; infinite where there is none."""

    low: Float[Array, " nx"]
    high: Float[Array, " nx"]

    def outside(self, x: Float[Array, "nx runs"]) -> Bool[Array, "nx runs"]:
        """Whether a state is outside; a state that is not a number is not."""
        out: Array = (x < self.low[:, None]) | (x > self.high[:, None])
        return out


class Advance(NamedTuple):
    """Result of an integration over one sample."""

    x: Float[Array, "nx runs"]
    """Final states; those of a run that left its bounds are the last ones inside."""
    state: Int[Array, " runs"]
    """Index of the state that left its bounds first; -1 where none did."""
    t: Float[Array, " runs"]
    """Time at which it was found outside, or from which it cannot be integrated; NaN where it reached the end."""
    rough: Int[Array, " runs"]
    """Index of a state whose error is larger than the tolerance with the shortest intervals; -1 where none is."""
    failed: Bool[Array, " runs"]
    """Whether the error was too large."""
    steps: Int[Array, " runs"]
    """Steps that have been computed under error control."""


def at_start(x: Float[Array, "nx columns"], n_runs: int) -> Advance:
    """Return the beginning of a sample."""
    none = np.full(n_runs, -1)
    zero, never = np.zeros(n_runs, dtype=int), np.full(n_runs, np.nan)
    return Advance(x.copy(), none, never, none.copy(), np.zeros(n_runs, dtype=bool), zero)


def sample_times(k: int, n: int, Ts: float) -> list[float]:
    """Return the ends of n equal steps of sample k [s]; the first is k Ts and the last (k+1) Ts, without rounding."""
    return [(k + j / n) * Ts for j in range(n + 1)]


def inside(slope: Slope, k: int, Ts: float) -> Slope:
    """Ask for times within sample k only: what jumps at its end belongs to the next one."""
    first, last = (k + EDGE) * Ts, (k + 1 - EDGE) * Ts
    return lambda t, x: slope(min(max(t, first), last), x)


def rk4_step(slope: Slope, t: float, h: float, x: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """Return x at t + h, and the states at which the slope was asked on the way."""
    k1 = slope(t, x)
    x2 = x + h / 2 * k1
    k2 = slope(t + h / 2, x2)
    x3 = x + h / 2 * k2
    k3 = slope(t + h / 2, x3)
    x4 = x + h * k3
    return x + h / 6 * (k1 + 2 * (k2 + k3) + slope(t + h, x4)), (x2, x3, x4)


def rk4(
    slope: Slope, times: Sequence[float], x: Float[Array, "nx runs"], h: float, bounds: Bounds | None = None
) -> Advance:
    """Integrate over equal steps of length h, whose ends are the times.

    A run leaves its bounds when a state is outside at the end of a step.  It also leaves them when the step ends in
    something that is not a number and a state was outside at one of its stages: beyond its bounds a right-hand side
    may be undefined, such as the root of a negative level.
    """
    done = at_start(x, x.shape[1])
    for now, later in pairwise(times):
        end, stages = rk4_step(slope, now, h, done.x)
        first = None if bounds is None else first_outside(bounds, end, stages)
        if first is not None:
            left = first >= 0
            new = left & (done.state < 0)
            done.state[new], done.t[new] = first[new], later
            end[:, left] = done.x[:, left]
        done.x[:] = end
    return done


def apply_map(
    mapping: Slope, now: float, later: float, x: Float[Array, "nx runs"], bounds: Bounds | None = None
) -> Advance:
    """Move from a sample to the next one by a map (t, x) -> x(k+1)."""
    end, done = mapping(now, x), at_start(x, x.shape[1])
    first = None if bounds is None else first_outside(bounds, end, ())
    if first is not None:
        left = first >= 0
        done.state[left], done.t[left] = first[left], later
        end[:, left] = x[:, left]
    return done._replace(x=end)


def first_outside(bounds: Bounds, end: Float[Array, "nx runs"], stages: tuple[Array, ...]) -> Array | None:
    """Return the first state of every run that is outside, -1 where none is; None where none is in any run."""
    if ((end >= bounds.low[:, None]) & (end <= bounds.high[:, None])).all():
        return None
    undefined = ~np.isfinite(end).all(axis=0)
    outside = bounds.outside(end)
    for stage in stages:
        outside |= bounds.outside(stage) & undefined
    return np.where(outside.any(axis=0), outside.argmax(axis=0), -1)
