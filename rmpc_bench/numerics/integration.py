"""The Runge-Kutta method of order 4 and maps for a block of runs, with bounds of the states.

Axis 0 of x is the state and axis 1 the run, as in the functions of users: x[i] is a row over the runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple
from warnings import catch_warnings, filterwarnings

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
        return (x < self.low[:, None]) | (x > self.high[:, None])


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
        _move(done, *rk4_step(slope, now, h, done.x), later, bounds)
    return done


def apply_map(
    mapping: Slope, now: float, later: float, x: Float[Array, "nx runs"], bounds: Bounds | None = None
) -> Advance:
    """Move from a sample to the next one by a map (t, x) -> x(k+1)."""
    done = at_start(x, x.shape[1])
    _move(done, mapping(now, x), (), later, bounds)
    return done


def _move(done: Advance, end: Array, stages: tuple[Array, ...], later: float, bounds: Bounds | None) -> None:
    """Move all runs to the end of a step but those that are outside there or have been before."""
    first = None if bounds is None else first_outside(bounds, end, stages)
    if first is not None:
        left = first >= 0
        new = left & (done.state < 0)
        done.state[new], done.t[new] = first[new], later
        end[:, left] = done.x[:, left]
    done.x[:] = end


def first_outside(bounds: Bounds, end: Float[Array, "nx runs"], stages: tuple[Array, ...]) -> Array | None:
    """Return the first state of every run that is outside, -1 where none is; None where none is in any run."""
    if ((end >= bounds.low[:, None]) & (end <= bounds.high[:, None])).all():
        return None
    undefined = ~np.isfinite(end).all(axis=0)
    outside = bounds.outside(end)
    for stage in stages:
        outside |= bounds.outside(stage) & undefined
    return np.where(outside.any(axis=0), outside.argmax(axis=0), -1)


DEEPEST = 9
"""Halvings of a sample: 512 intervals."""
LARGEST_ERROR = 1e-3
"""Relative to the size of a state, with the shortest intervals."""
SMALLEST_SIZE, LARGEST_SIZE = 1e-6, 1e2
"""Relative to the state."""
DIFFERENCES, LARGEST_DIFFERENCE = 1e-5, 1.0
"""Error of the difference of two points relative to their distance; the largest one with the shortest intervals."""
NEAREST = 1e-3
"""Relative to the state: size of a state, at least, by which distances of points are measured."""
ROUNDING, NEGLIGIBLE = 1e-15, 1e-9
"""Error relative to the state that rounding explains; size relative to the scale below which no state is followed."""

Slopes = Callable[[Int[Array, " columns"]], Slope]
"""The slope of some columns of a block."""


# The Runge-Kutta method of order 4 with error control by halving, for a block of runs.
#
# Method  An interval, first the sample, is integrated by one step and by two of half the length.  Where |difference| /
#         15 is at most the tolerance times the size of every state, the two steps count.  Otherwise the left half, and
#         then the right half, are integrated in the same way, down to 1/512 of a sample.  There a larger error up to
#         1e-3 is accepted and noted; beyond it the run ends.
# Size    The scale of the state, which the caller gives.  It is at least the change over the interval and 1e-6 of the
#         state, in case the scale is unknown or too small; it is at most 100 times the state, in case the scale comes
#         from a run that grew without limit, or from much larger inputs.
# Points  Several points of a run, such as the sigma points of a filter, use the same intervals: differences between
#         them then are as smooth as the equation.  The intervals are those that the first point needs, and that the
#         difference of every point from it needs: its error is at most 1e-5 of their distance.  A fast state whose
#         first point is at rest has no error there, and all the same decides how far the others move.
# Blocks  All runs that are still in an interval are one call of the slope.  A run gets the same bits in every block.


class Tolerance(NamedTuple):
    """How exactly a sample is integrated."""

    rtol: float
    scale: Float[Array, " nx"]  # range that every state has; 0 where it is not known
    largest: float = LARGEST_ERROR  # error with the shortest intervals beyond which a run ends


def sizes(x: Array, two: Array, scale: Array) -> tuple[Array, Array]:
    """Return the size of the states over an interval, and their largest magnitude."""
    largest = np.maximum(np.abs(x), np.abs(two))
    size = np.maximum(np.maximum(scale, np.abs(two - x)), SMALLEST_SIZE * largest)
    return np.minimum(size, np.maximum(LARGEST_SIZE * largest, NEGLIGIBLE * scale)), largest


def relative_errors(one: Array, two: Array, size: Array, largest: Array, rtol: float) -> tuple[Array, Array]:
    """Return the error of two steps relative to the size of the states, and relative to what is allowed."""
    error = np.abs(two - one) / 15
    # An error of 0 of a state that stays at 0.
    none = np.where(error == 0.0, 1.0, 0.0)
    return error / (size + none), error / (rtol * size + ROUNDING * largest + none)


def distances(x: Array, first: Array, size: Array, largest: Array) -> Array:
    """Return how far the states of points are from those of the first one, relative to the size of the states."""
    unit = np.maximum(size, NEAREST * largest)
    return np.abs(x - first) / (unit + np.where(unit == 0.0, 1.0, 0.0))


def halve(
    slopes: Slopes,
    k: int,
    Ts: float,
    x: Float[Array, "nx columns"],
    tolerance: Tolerance,
    points: int = 1,
    bounds: Bounds | None = None,
    leading: int | None = None,
) -> Advance:
    """Integrate over sample k; the columns are the points of the first run, then those of the second one, and so on.

    The first `leading` points of a run decide on its intervals; all unless given.
    """
    done = at_start(x, x.shape[1] // points)
    done.failed[:] = ~np.isfinite(x[:, ::points]).all(axis=0)
    done.t[done.failed] = k * Ts
    with np.errstate(all="ignore"):
        sample = _Sample(slopes, k, Ts, tolerance, points, leading or points, bounds, done)
        sample.integrate(0.0, 0, np.flatnonzero(~done.failed), None)
    return done


class _Sample(NamedTuple):
    """One sample of a block; `done` is changed in place."""

    slopes: Slopes
    k: int
    Ts: float
    tolerance: Tolerance
    points: int
    leading: int
    bounds: Bounds | None
    done: Advance

    def integrate(self, start: float, level: int, runs: Int[Array, " some"], one: Array | None) -> None:
        """Integrate the interval at `start`, a part of the sample; `one` is the result of a single step, if known."""
        if not len(runs):
            return
        done, p, h, t = self.done, self.points, self.Ts / 2**level, (self.k + start) * self.Ts
        columns = self._columns(runs, p)
        x, slope = done.x[:, columns], self._slope(columns)
        if one is None:
            lead = slope if p == self.leading else self._slope(self._columns(runs, self.leading))
            one, _ = rk4_step(lead, t, h, self._leading(x))
            done.steps[runs] += 1
        middle, before = rk4_step(slope, t, h / 2, x)
        two, after = rk4_step(slope, t + h / 2, h / 2, middle)
        done.steps[runs] += 2
        error, share = self._errors(*(each.reshape(len(x), len(runs), -1) for each in (x, one, two)))
        fine = (share <= 1.0).all(axis=0)
        split = np.asarray(~fine & (level < DEEPEST))
        if split.any():
            going = runs[split]
            left = self._leading(middle)[:, np.repeat(split, self.leading)]
            self.integrate(start, level + 1, going, left)
            self.integrate(start + 0.5 / 2**level, level + 1, going[np.isnan(done.t[going])], None)
        stays = ~split & ~self._leave(runs, ~split, t + h / 2, x, middle, before)
        stays &= ~self._leave(runs, stays, t + h, middle, two, after)
        lost = stays & ~fine & ~(error <= self.tolerance.largest).all(axis=0)
        done.failed[runs[lost]], done.t[runs[lost]] = True, t
        rough = stays & ~fine & ~lost
        done.rough[runs[rough]] = share[:, rough].argmax(axis=0)
        keep = np.repeat(stays & ~lost, p)
        done.x[:, columns[keep]] = two[:, keep]

    def _leave(
        self, runs: Int[Array, " some"], among: Array, t: float, x: Array, end: Array, stages: tuple[Array, ...]
    ) -> Bool[Array, " some"]:
        """End the runs that have left their bounds after a step, at their states before it; return which."""
        assert self.bounds is None or self.points == 1, "runs and columns are the same only with one point"
        first = None if self.bounds is None else first_outside(self.bounds, end, stages)
        left = np.zeros(len(runs), dtype=bool) if first is None else among & (first >= 0)
        if first is not None:
            self.done.state[runs[left]], self.done.t[runs[left]] = first[left], t
            self.done.x[:, runs[left]] = x[:, left]
        return left

    def _errors(self, x: Array, one: Array, two: Array) -> tuple[Array, Array]:
        """Return (nx, runs) errors as `relative_errors`: of the first points, and of the differences from them."""
        size, largest = sizes(x[..., 0], two[..., 0], self.tolerance.scale[:, None])
        error, share = relative_errors(one[..., 0], two[..., 0], size, largest, self.tolerance.rtol)
        if self.leading == 1:
            return error, share
        first, others = (slice(None), slice(None), slice(1)), (slice(None), slice(None), slice(1, self.leading))
        size, largest = size[..., None], largest[..., None]
        away = distances(x[others], x[first], size, largest).max(axis=0)
        off, far = relative_errors(
            one[others] - one[first], two[others] - two[first], size * away, largest, DIFFERENCES
        )
        # A point where the equation is not defined stays undefined, with the intervals of the others.
        defined = np.isfinite(x[others]).all(axis=0)
        far = np.where(defined, np.where(np.isnan(far), np.inf, far), 0.0)
        off = np.where(np.isfinite(off), off, 0.0) * (LARGEST_ERROR / LARGEST_DIFFERENCE)
        return np.maximum(error, off.max(axis=2)), np.maximum(share, far.max(axis=2))

    def _leading(self, x: Array) -> Array:
        """Return the columns of the points that decide."""
        if self.leading == self.points:
            return x
        return x.reshape(len(x), -1, self.points)[..., : self.leading].reshape(len(x), -1)

    def _columns(self, runs: Int[Array, " some"], points: int) -> Int[Array, " columns"]:
        """Return the columns of the first points of some runs."""
        return runs if self.points == 1 else (self.points * runs[:, None] + np.arange(points)).ravel()

    def _slope(self, columns: Int[Array, " columns"]) -> Slope:
        return inside(self.slopes(columns), self.k, self.Ts)


MAX_CALLS = 50_000
"""Calls of the right-hand side in one sample of one run."""
MAX_RESETS = 32
"""Events in one sample after which a run is given up: they may accumulate, as those of a bouncing ball do."""
PAUSE = 1e-6
"""Part of a sample during which an event that has just replaced the state is not looked for again."""


# Integration of one run by `scipy.integrate.solve_ivp`, with bounds of the states and events.
#
# Bounds   The right-hand side is asked inside the bounds only: at a state outside, which an integrator may try or pass
#          through on its way out, it is asked at the nearest state inside.  A run has left its bounds when a state is
#          outside at the end of a step of the integrator.
# Events   A scalar function passes through 0.  The run ends there, or its state is replaced and the
#          integration goes on.
# Limits   Some integrators never return where a solution grows without limit in a finite time; they are stopped after
#          `MAX_CALLS` calls of the right-hand side.


class Tolerances(NamedTuple):
    """An integrator and its tolerances."""

    method: str
    rtol: float
    atol: float


class Event(NamedTuple):
    """An event: where `value` passes through 0."""

    value: Callable[[float, Array], float]
    direction: float  # positive: upwards only; negative: downwards only; 0: both
    reset: Callable[[float, Array], Array] | None  # returns the new state; None where the run ends


class Solution(NamedTuple):
    """Result of an integration of one run."""

    x: Float[Array, " nx"]
    t: float  # time at which it ended [s]
    state: int = -1  # index of the state that has left its bounds; -1 where none has
    event: int = -1  # index of the event that has ended the run; -1 where none has
    failure: str = ""  # what the integrator reports; empty where it has reached the end
    crowded: bool = False  # whether there were more than `MAX_RESETS` events


class _TooManyCalls(Exception):
    """The right-hand side has been called `MAX_CALLS` times."""


class _Run:
    """One run with the user's functions, whose calls are counted, and the exception that one has raised."""

    def __init__(self, slope: Callable[[float, Array], Array], tolerances: Tolerances, bounds: Bounds | None) -> None:
        self._slope, self._tolerances, self._bounds, self._calls = slope, tolerances, bounds, 0
        self.error: Exception | None = None

    def slope(self, t: float, x: Array) -> Array:
        """Time derivative at the nearest state inside the bounds."""
        self._calls += 1
        if self._calls > MAX_CALLS:
            raise _TooManyCalls
        x = x if self._bounds is None else np.clip(x, self._bounds.low, self._bounds.high)
        if not np.isfinite(x).all():
            # Functions of one number, such as math.sin, raise an exception there.
            return np.full(len(x), np.nan)
        return self._guarded(self._slope, t, x)

    def event(self, event: Event | None) -> Callable[[float, Array], float]:
        """Return an event as `solve_ivp` takes it; it never happens where there is None."""

        def value(t: float, x: Array) -> float:
            return 1.0 if event is None else float(self._guarded(event.value, t, x))

        value.terminal, value.direction = True, 0.0 if event is None else event.direction  # type: ignore[attr-defined]
        return value

    def _guarded(self, function: Callable[..., Any], t: float, x: Array) -> Any:
        try:
            return function(float(t), x)
        except Exception as error:
            self.error = error
            raise

    def piece(self, t: float, stop: float, x: Array, events: Sequence[Event | None]) -> Solution:
        """Integrate until the end, or until the first event."""
        from scipy.integrate import solve_ivp

        watched = [self.event(event) for event in events]
        method, rtol, atol = self._tolerances
        try:
            # Some integrators warn of what is returned as a failure here.
            with catch_warnings():
                filterwarnings("ignore", module="scipy")
                found = solve_ivp(self.slope, (t, stop), x, method, rtol=rtol, atol=atol, events=watched or None)
        except _TooManyCalls:
            return Solution(x, t, failure=f"more than {MAX_CALLS:,} calls of the right-hand side in one sample")
        except Exception as error:
            if error is self.error:
                raise
            # Such as a matrix of numbers that are not finite, within an implicit method.
            return Solution(x, t, failure=str(error))
        event = next((i for i, times in enumerate(found.t_events or ()) if len(times)), -1)
        inner = found.y[:, : -1 if event >= 0 else None]
        if self._bounds is not None and (outside := self._bounds.outside(inner)).any():
            step = int(outside.any(axis=0).argmax())
            return Solution(found.y[:, max(step - 1, 0)], float(found.t[step]), state=int(outside[:, step].argmax()))
        failure = str(found.message) if found.status < 0 else ""
        return Solution(
            found.y[:, -1], float(found.t[-1]) if event >= 0 or failure else stop, event=event, failure=failure
        )


def solve(
    slope: Callable[[float, Array], Array],
    start: float,
    end: float,
    x: Float[Array, " nx"],
    tolerances: Tolerances,
    bounds: Bounds | None = None,
    events: Sequence[Event] = (),
) -> Solution:
    """Integrate one run from ``start`` to ``end``."""
    run, t, last, resets = _Run(slope, tolerances, bounds), start, -1, 0
    while t < end:
        # An event that has just replaced the state is at its 0 still.
        stop = end if last < 0 else min(t + PAUSE * (end - start), end)
        active = [None if i == last else event for i, event in enumerate(events)]
        found = run.piece(t, stop, x, active)
        x, t, last = found.x, found.t, found.event
        if found.state >= 0 or found.failure:
            return found
        if last >= 0:
            reset, resets = events[last].reset, resets + 1
            if reset is None:
                return found
            if resets > MAX_RESETS:
                return Solution(x, t, crowded=True)
            x = reset(t, x)
    return Solution(x, end)
