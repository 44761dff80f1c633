"""The Runge-Kutta method of order 4 with error control by halving, for a block of runs.

Method  An interval, first the sample, is integrated by one step and by two of half the length.  Where |difference| / 15
        is at most the tolerance times the size of every state, the two steps count.  Otherwise the left half, and then
        the right half, are integrated in the same way, down to 1/512 of a sample.  There a larger error up to 1e-3 is
        accepted and noted; beyond it the run ends.
Size    The scale of the state, which the caller gives.  It is at least the change over the interval and 1e-6 of the
        state, in case the scale is unknown or too small; it is at most 100 times the state, in case the scale comes
        from a run that grew without limit, or from much larger inputs.
Points  Several points of a run, such as the sigma points of a filter, use the same intervals: differences between them
        then are as smooth as the equation.  The intervals are those that the first point needs, and that the difference
        of every point from it needs: its error is at most 1e-5 of their distance.  A fast state whose first point is at
        rest has no error there, and all the same decides how far the others move.
Blocks  All runs that are still in an interval are one call of the slope.  A run gets the same bits in every block.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rmpc_bench.numerics.integration import Advance, Bounds, Slope, at_start, first_outside, inside, rk4_step
from rmpc_bench.types import Array

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


class Tolerance(NamedTuple):
    """How exactly a sample is integrated."""

    rtol: float
    scale: Float[Array, " nx"]
    """Range that every state has; 0 where it is not known."""
    largest: float = LARGEST_ERROR
    """Error with the shortest intervals beyond which a run ends."""


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
    away: Array = np.abs(x - first) / (unit + np.where(unit == 0.0, 1.0, 0.0))
    return away


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
