"""Most probable states of a window under bounds of noises and states, as a least-distance problem.

Problem  Minimise |zeta|^2 over low <= value + E zeta <= high, where xi = mean + root zeta is the window of
         `window_posterior`.  This is the problem in xi, in coordinates in which its minimum without bounds is zeta = 0
         and its Hessian the identity.  If no bound is active the solution is therefore known and exact.
Scale    Every row is divided by the standard deviation of its value.  The problem is homogeneous: it is divided by its
         largest violation, so that the solver gets numbers of size 1.  Only the part of the unknowns that the rows
         depend on is left; the rest of the minimum is 0.
Fixed    A value without a standard deviation (no noise, or an exactly known state) cannot be moved: it is compared with
         its bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.intervals import Interval
from rmpc_bench.numerics.linalg import mv
from rmpc_bench.numerics.qp import QpStatus, QuadraticProgram
from rmpc_bench.numerics.window_posterior import WindowPosterior
from rmpc_bench.types import Array

FREEDOM = 1e-13
"""A smaller standard deviation after the measurements, in units of that before them, is a rounding of 0."""
ROUNDING = 1e-12
"""Allowed violation of the bounds of a fixed value, in units of the largest number of the window."""


class BoundedValues(NamedTuple):
    """Values with bounds: value = base + E xi."""

    E: Float[Array, "values n"]
    interval: Interval


class WindowBounds(NamedTuple):
    """Bounds of the noises, without their means, and of the states at all samples of a window."""

    w: Interval
    x: Interval
    v: Interval

    def values(
        self, posterior: WindowPosterior, W_root: Float[Array, "m nw nr"], measured: Bool[Array, "points ny"]
    ) -> BoundedValues:
        """Return the noises and states that have bounds: w of all steps, then x, then v of all samples.

        Parameters
        ----------
        posterior : law of the window
        W_root : roots of the process noise in its own coordinates
        measured : which outputs are there; v of the others has no bound
        """
        m, n = len(W_root), posterior.states.shape[2]
        w, x, v = (each.bounded for each in self)
        nr = W_root.shape[2]
        noises = np.zeros((m, int(w.sum()), n))
        for j in range(m):
            begin = n - (m - j) * nr
            noises[j, :, begin : begin + nr] = W_root[j, w]
        parts = (noises, posterior.states[:, x], -posterior.outputs[:, v])
        ends = [[np.tile(end, len(each)) for end in interval.chosen(some)] for each, interval, some in
                zip(parts, self, (w, x, v), strict=True)]  # fmt: skip
        there = measured[:, v].ravel()
        ends[2] = [np.where(there, ends[2][0], -np.inf), np.where(there, ends[2][1], np.inf)]
        low, high = (np.concatenate([each[i] for each in ends]) for i in range(2))
        return BoundedValues(
            np.concatenate([each.reshape(len(each) * each.shape[1], n) for each in parts]), Interval(low, high)
        )

    def base(
        self, x_bar: Float[Array, "runs points nx"], r: Float[Array, "runs points ny"]
    ) -> Float[Array, "runs values"]:
        """Return the same values in the window without noise."""
        runs, points = x_bar.shape[:2]
        states, outputs = x_bar[:, :, self.x.bounded], r[:, :, self.v.bounded]
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
    x_gain : (nx, p) last state from the residuals, without bounds
    value_gain : (values, p) values with bounds from the residuals, without bounds
    interval : bounds of the values
    size : (values,) standard deviations of the values; 0 of a fixed one
    x_map : (nx, s) last state from the unknowns of the program
    program : the program of the values that are not fixed
    """

    x_gain: Float[Array, "nx p"]
    value_gain: Float[Array, "values p"]
    interval: Interval
    size: Float[Array, " values"]
    x_map: Float[Array, "nx s"]
    program: QuadraticProgram

    @cached_property
    def _largest_bound(self) -> float:
        """Largest size of a finite bound."""
        return max(float(np.abs(end[np.isfinite(end)]).max(initial=0.0)) for end in self.interval)

    @classmethod
    def of(cls, posterior: WindowPosterior, values: BoundedValues) -> WindowProgram:
        """Prepare the problems.

        Parameters
        ----------
        posterior : law of the window
        values : values with bounds
        """
        last, E, root = posterior.states[-1], values.E, posterior.root
        rows = E @ root
        after, before = np.linalg.norm(rows, axis=1), np.linalg.norm(E, axis=1)
        size = np.where(after > FREEDOM * before, after, 0.0)
        free = size > 0.0
        Q, R = np.linalg.qr((rows[free] / size[free, None]).T)
        program = QuadraticProgram(np.eye(len(R)), np.ascontiguousarray(R.T))
        return cls(last @ posterior.gain, E @ posterior.gain, values.interval, size, last @ root @ Q, program)

    def fit(
        self, x_bar: Float[Array, "runs nx"], r: Float[Array, "runs p"], base: Float[Array, "runs values"]
    ) -> WindowFit:
        """Return the most probable last state of every run.

        Parameters
        ----------
        x_bar : last state without noise
        r : residuals of the measurements, 0 where one is missing
        base : values with bounds without noise
        """
        x, status = x_bar + mv(self.x_gain, r), [QpStatus.OPTIMAL] * len(r)
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
