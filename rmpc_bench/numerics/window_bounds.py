"""Most probable states of a window under bounds of noises and states, as a least-distance problem.

Problem  Minimise |zeta|^2 over low <= value + rows zeta <= high, in the unknowns of window_posterior.py, in which the
         minimum without bounds is zeta = 0 and the Hessian the identity.
         If no bound is active the solution is therefore known and exact.
Scale    Every row is divided by the standard deviation of its value.  The problem is homogeneous: it is divided by its
         largest violation, so that the solver gets numbers of size 1.  Only the part of the unknowns that the rows
         depend on is left; the rest of the minimum is 0.
Fixed    A value without a standard deviation (no noise, or an exactly known state) cannot be moved: it is compared with
         its bounds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.intervals import Interval
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.qp import QpStatus, QuadraticProgram
from rmpc_bench.numerics.window_posterior import Chosen, WindowPosterior, WindowStages, window_laws
from rmpc_bench.types import Array

FREEDOM = 1e-13
"""A smaller standard deviation after the measurements, in units of that before them, is a rounding of 0."""
ROUNDING = 1e-12
"""Allowed violation of the bounds of a fixed value, in units of the largest number of the window."""


class WindowBounds(NamedTuple):
    """Bounds of the noises, without their means, and of the states at all samples of a window."""

    w: Interval
    x: Interval
    v: Interval

    def laws(
        self, stages: WindowStages, P_root: Float[Array, "nx n0"], measured: Bool[Array, "points ny"]
    ) -> Iterator[WindowPosterior]:
        """Yield the laws of the windows of 1, 2, .. samples with the values that have bounds, as `window_laws`."""
        return window_laws(stages, P_root, measured, Chosen(*(each.bounded for each in self)))

    def interval(self, measured: Bool[Array, "points ny"]) -> Interval:
        """Return the bounds of the values: w of all steps, then x, then v of all samples, if it is measured."""
        points = len(measured)
        ends = [
            [np.tile(end, n) for end in each.chosen(each.bounded)]
            for each, n in zip(self, (points - 1, points, points), strict=True)
        ]
        there = measured[:, self.v.bounded].ravel()
        ends[2] = [np.where(there, ends[2][0], -np.inf), np.where(there, ends[2][1], np.inf)]
        low, high = (np.concatenate([each[i] for each in ends]) for i in range(2))
        return Interval(low, high)

    def base(
        self, x_bar: Float[Array, "runs points nx"], e: Float[Array, "runs points ny"]
    ) -> Float[Array, "runs values"]:
        """Return the values before the measurement of their sample, for predictions and innovations."""
        runs, points = x_bar.shape[:2]
        states, outputs = x_bar[:, :, self.x.bounded], e[:, :, self.v.bounded]
        w = np.zeros((runs, (points - 1) * int(self.w.bounded.sum())))
        return np.concatenate([w, states.reshape(runs, -1), outputs.reshape(runs, -1)], axis=1)


class WindowFit(NamedTuple):
    """Last states of a window."""

    x: Float[Array, "runs nx"]
    """Without bounds where the program has no solution."""
    solved: Bool[Array, " runs"]
    """Whether a quadratic program was necessary."""
    status: list[QpStatus]
    """One per run; `OPTIMAL` where no program was necessary."""


@dataclass(frozen=True, eq=False)
class WindowProgram:
    """What is fixed in the problems of windows with the same matrices.

    Parameters
    ----------
    L : (points, nx, ny) gains of the Kalman filter of the window
    value_gain : (values, p) values with bounds from the innovations, without bounds
    interval : bounds of the values
    size : (values,) standard deviations of the values; 0 of a fixed one
    x_map : (nx, s) last state from the unknowns of the program
    program : the program of the values that are not fixed
    filter_map : predictions and innovations from the data, for short windows; see `ModelSeries.filter_map`
    """

    L: Float[Array, "points nx ny"]
    value_gain: Float[Array, "values p"]
    interval: Interval
    size: Float[Array, " values"]
    x_map: Float[Array, "nx s"]
    program: QuadraticProgram
    filter_map: Float[Array, "answers data"] | None = None

    @cached_property
    def _largest_bound(self) -> float:
        """Largest size of a finite bound."""
        return max(float(np.abs(end[np.isfinite(end)]).max(initial=0.0)) for end in self.interval)

    @classmethod
    def of(cls, law: WindowPosterior, interval: Interval) -> WindowProgram:
        """Prepare the problems of a law with the bounds of its values."""
        order = np.argsort(law.kind, kind="stable")
        rows = law.rows[order]
        after = np.linalg.norm(rows, axis=1)
        size = np.where(after > FREEDOM * law.before[order], after, 0.0)
        free = size > 0.0
        Q, R = np.linalg.qr((rows[free] / size[free, None]).T)
        program = QuadraticProgram(np.eye(len(R)), np.ascontiguousarray(R.T))
        return cls(law.L.copy(), law.gain[order], interval, size, law.X @ Q, program)

    def fit(
        self, x_bar: Float[Array, "runs nx"], r: Float[Array, "runs p"], base: Float[Array, "runs values"]
    ) -> WindowFit:
        """Return the most probable last state of every run.

        Parameters
        ----------
        x_bar : prediction of the last state
        r : innovations, 0 where a measurement is missing
        base : values with bounds before the measurement of their sample
        """
        x = x_bar + mv(self.L[-1], r[:, -self.L.shape[2] :])
        status = [QpStatus.OPTIMAL] * len(r)
        if not len(self.size):
            return WindowFit(x, np.zeros(len(r), dtype=bool), status)
        value = base + mv(self.value_gain, r)
        finite = np.isfinite(value).all(axis=1)
        fixed, largest = self.size == 0.0, np.maximum(np.abs(base).max(axis=1), np.abs(r).max(axis=1))
        impossible = finite & self._outside(value, fixed, ROUNDING * np.maximum(largest, self._largest_bound))
        asked = finite & ~impossible & self._outside(value, ~fixed, np.zeros(len(r)))
        for run in np.flatnonzero(impossible):
            status[run] = QpStatus.INFEASIBLE
        rows = np.flatnonzero(asked)
        if len(rows):
            shift, found = self._solved(value[rows][:, ~fixed])
            for run, each in zip(rows, found, strict=True):
                status[run] = each
            good = np.array([each.solved for each in found])
            x[rows[good]] += shift[good]
        return WindowFit(x, asked, status)

    def _outside(
        self, value: Float[Array, "runs values"], chosen: Bool[Array, " values"], margin: Float[Array, " runs"]
    ) -> Bool[Array, " runs"]:
        """Whether a chosen value leaves its bounds by more than the margin."""
        (low, high), seen = self.interval.chosen(chosen), value[:, chosen]
        outside = (seen < low - margin[:, None]) | (seen > high + margin[:, None])
        return np.asarray(outside.any(axis=1))

    def _solved(self, value: Float[Array, "asked free"]) -> tuple[Float[Array, "asked nx"], list[QpStatus]]:
        """Solve the programs; return the changes of the last states."""
        free = self.size > 0.0
        low, high = ((end - value) / self.size[free] for end in self.interval.chosen(free))
        zeta, status = self.program.nearest(low, high)
        return mv(self.x_map, zeta), status
