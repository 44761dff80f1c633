"""The Runge-Kutta method of order 4 with error control by halving, for a block of runs.

Method  An interval, first the sample, is integrated by one step and by two of half the length.  Where |difference| / 15
        is at most the tolerance times the size of every state, the two steps count.  Otherwise the left half, and then
        the right half, are integrated in the same way, down to 1/512 of a sample.  There a larger error up to 1e-3 is
        accepted and noted; beyond it the run ends.
Size    The scale of the state, which the caller gives.  It is at least the change over the interval and 1e-6 of the
        state, in case the scale is unknown or too small; it is at most 1000 times the state, in case the scale comes
        from a run that grew without limit.
Points  Several points of a run, such as the sigma points of a filter, use the intervals of the first one: differences
        between them then are as smooth as the equation.
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
SMALLEST_SIZE, LARGEST_SIZE = 1e-6, 1e3
"""Relative to the state."""
ROUNDING, NEGLIGIBLE = 1e-15, 1e-9
"""Error relative to the state that rounding explains; size relative to the scale below which no state is followed."""

Slopes = Callable[[Int[Array, " columns"]], Slope]
"""The slope of some columns of a block."""


class Tolerance(NamedTuple):
    """How exactly a sample is integrated."""

    rtol: float
    scale: Float[Array, " nx"]
    """Range that every state has; 0 where it is not known."""


def relative_errors(x: Array, one: Array, two: Array, scale: Array, rtol: float) -> tuple[Array, Array]:
    """Return the error of two steps relative to the size of the states, and relative to what is allowed."""
    largest = np.maximum(np.abs(x), np.abs(two))
    size = np.maximum(np.maximum(scale, np.abs(two - x)), SMALLEST_SIZE * largest)
    size = np.minimum(size, np.maximum(LARGEST_SIZE * largest, NEGLIGIBLE * scale))
    error = np.abs(two - one) / 15
    # An error of 0 of a state that stays at 0.
    none = np.where(error == 0.0, 1.0, 0.0)
    return error / (size + none), error / (rtol * size + ROUNDING * largest + none)


def halve(
    slopes: Slopes,
    k: int,
    Ts: float,
    x: Float[Array, "nx columns"],
    tolerance: Tolerance,
    points: int = 1,
    bounds: Bounds | None = None,
) -> Advance:
    """Integrate over sample k; the columns are the points of the first run, then those of the second one, and so on."""
    done = at_start(x, x.shape[1] // points)
    done.failed[:] = ~np.isfinite(x[:, ::points]).all(axis=0)
    done.t[done.failed] = k * Ts
    with np.errstate(all="ignore"):
        sample = _Sample(slopes, k, Ts, tolerance, points, bounds, done)
        sample.integrate(0.0, 0, np.flatnonzero(~done.failed), None)
    return done


class _Sample(NamedTuple):
    """One sample of a block; `done` is changed in place."""

    slopes: Slopes
    k: int
    Ts: float
    tolerance: Tolerance
    points: int
    bounds: Bounds | None
    done: Advance

    def integrate(self, start: float, level: int, runs: Int[Array, " some"], one: Array | None) -> None:
        """Integrate the interval at `start`, a part of the sample; `one` is the result of a single step, if known."""
        if not len(runs):
            return
        done, p, h, t = self.done, self.points, self.Ts / 2**level, (self.k + start) * self.Ts
        columns = self._columns(runs)
        x, slope = done.x[:, columns], self._slope(columns)
        if one is None:
            one, _ = rk4_step(slope if p == 1 else self._slope(p * runs), t, h, x[:, ::p])
            done.steps[runs] += 1
        middle, before = rk4_step(slope, t, h / 2, x)
        two, after = rk4_step(slope, t + h / 2, h / 2, middle)
        done.steps[runs] += 2
        error, share = relative_errors(x[:, ::p], one, two[:, ::p], self.tolerance.scale[:, None], self.tolerance.rtol)
        fine = (share <= 1.0).all(axis=0)
        split = np.asarray(~fine & (level < DEEPEST))
        if split.any():
            self.integrate(start, level + 1, runs[split], middle[:, ::p][:, split])
            going = runs[split]
            self.integrate(start + 0.5 / 2**level, level + 1, going[np.isnan(done.t[going])], None)
        stays = ~split & ~self._leave(runs, ~split, t + h / 2, x, middle, before)
        stays &= ~self._leave(runs, stays, t + h, middle, two, after)
        lost = stays & ~fine & ~(error <= LARGEST_ERROR).all(axis=0)
        done.failed[runs[lost]], done.t[runs[lost]] = True, t
        rough = stays & ~fine & ~lost
        done.rough[runs[rough]] = share[:, rough].argmax(axis=0)
        keep = np.repeat(stays & ~lost, p)
        done.x[:, columns[keep]] = two[:, keep]

    def _leave(
        self, runs: Int[Array, " some"], among: Array, t: float, x: Array, end: Array, stages: tuple[Array, ...]
    ) -> Bool[Array, " some"]:
        """End the runs that have left their bounds after a step, at their states before it; return which."""
        first = None if self.bounds is None else first_outside(self.bounds, end, stages)
        left = np.zeros(len(runs), dtype=bool) if first is None else among & (first >= 0)
        if first is not None:
            self.done.state[runs[left]], self.done.t[runs[left]] = first[left], t
            self.done.x[:, runs[left]] = x[:, left]
        return left

    def _columns(self, runs: Int[Array, " some"]) -> Int[Array, " columns"]:
        p = self.points
        return runs if p == 1 else (p * runs[:, None] + np.arange(p)).ravel()

    def _slope(self, columns: Int[Array, " columns"]) -> Slope:
        return inside(self.slopes(columns), self.k, self.Ts)
