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
    """Time at which it was found outside; NaN where none did."""


def sample_times(k: int, n: int, Ts: float) -> list[float]:
    """Return the ends of n equal steps of sample k [s]; the first is k Ts and the last (k+1) Ts, without rounding."""
    return [(k + j / n) * Ts for j in range(n + 1)]


def rk4(
    slope: Slope, times: Sequence[float], x: Float[Array, "nx runs"], h: float, bounds: Bounds | None = None
) -> Advance:
    """Integrate over equal steps.

    A run leaves its bounds when a state is outside at the end of a step.  It also leaves them when the step ends in
    something that is not a number and a state was outside at one of its stages: beyond its bounds a right-hand side
    may be undefined, such as the root of a negative level.

    Parameters
    ----------
    slope : time derivative
    times : ends of the steps [s], that of the first step at index 1
    x : states at the start
    h : length of a step [s]
    bounds : of the states; None for none
    """
    x = x.copy()
    state, left_at = np.full(x.shape[1], -1), np.full(x.shape[1], np.nan)
    for now, later in pairwise(times):
        middle = (now + later) / 2
        k1 = slope(now, x)
        x2 = x + h / 2 * k1
        k2 = slope(middle, x2)
        x3 = x + h / 2 * k2
        k3 = slope(middle, x3)
        x4 = x + h * k3
        end = x + h / 6 * (k1 + 2 * (k2 + k3) + slope(later, x4))
        if bounds is not None:
            first = _left(bounds, end, (x2, x3, x4))
            if first is not None:
                left = first >= 0
                new = left & (state < 0)
                state[new], left_at[new] = first[new], later
                end[:, left] = x[:, left]
        x = end
    return Advance(x, state, left_at)


def apply_map(
    mapping: Slope, now: float, later: float, x: Float[Array, "nx runs"], bounds: Bounds | None = None
) -> Advance:
    """Move over one sample by a map.

    Parameters
    ----------
    mapping : x(k+1) of (t, x)
    now, later : beginning and end of the sample [s]
    x : states at the start
    bounds : of the states; None for none
    """
    end = mapping(now, x)
    state, left_at = np.full(x.shape[1], -1), np.full(x.shape[1], np.nan)
    first = None if bounds is None else _left(bounds, end, ())
    if first is not None:
        state, left = first, first >= 0
        left_at[left] = later
        end[:, left] = x[:, left]
    return Advance(end, state, left_at)


def _left(bounds: Bounds, end: Float[Array, "nx runs"], stages: tuple[Array, ...]) -> Int[Array, " runs"] | None:
    """First state of every run that is outside, -1 where none is; None where none is in any run."""
    if ((end >= bounds.low[:, None]) & (end <= bounds.high[:, None])).all():
        return None
    undefined = ~np.isfinite(end).all(axis=0)
    outside = bounds.outside(end)
    for stage in stages:
        outside |= bounds.outside(stage) & undefined
    return np.where(outside.any(axis=0), outside.argmax(axis=0), -1)
