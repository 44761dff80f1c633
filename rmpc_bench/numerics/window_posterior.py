"""States and noises of a window of samples, given its measurements: the normal law of all of them at once.

Model   x(j+1) = A_j x(j) + .. + G_j xi_{j+1},  y(j) = C_j x(j) + R_j^(1/2) eta_j,  x of the first sample has the
        covariance P P' with the root P.  xi = [xi_0, xi_1 .. xi_m] and eta are independent, N(0, I).
Method  Sample by sample: given y up to a sample, state and values are a mean plus a root times zeta, N(0, I).
        A measurement rotates zeta so that only its first coordinates act on y.  What y says of every value is then its
        gain on the innovation e(j) of a Kalman filter that starts with the window.  Everything is a response of the
        error of this filter, which is stable: no power of A appears, also for a plant that is unstable.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rmpc_bench.numerics.intervals import Interval
from rmpc_bench.numerics.linalg import eliminated, mv, psd_sqrt, symmetrise
from rmpc_bench.numerics.qp import QpStatus, QuadraticProgram
from rmpc_bench.types import Array

RANK = 1e-14
"""Smaller eigenvalues of a matrix of correlations are roundings of 0."""


class WindowStages(NamedTuple):
    """Matrices of the samples j = 0..m of a window."""

    A: Float[Array, "m nx nx"]
    W: Float[Array, "m nw nr"]  # roots of the process noise in its own coordinates
    G: Float[Array, "m nx nr"]  # roots of the process noise in the state: its covariance is G G'
    C: Float[Array, "points ny nx"]
    R_v: Float[Array, "points ny ny"]


class WindowPosterior(NamedTuple):
    """The last state and chosen values of a window, given its measurements."""

    X: Float[Array, "nx n"]  # root of the covariance of the last state
    rows: Float[Array, "values n"]  # root of the covariance of the values, in the same unknowns
    gain: Float[Array, "values p"]  # mean of the values from the innovations of all samples
    before: Float[Array, " values"]  # standard deviations of the values before the measurement of their sample
    kind: Int[Array, " values"]  # 0 for w, 1 for x, 2 for v of a sample
    L: Float[Array, "points nx ny"]  # gains of the last state of every sample on its innovation


class Chosen(NamedTuple):
    """Which coordinates of every sample are values."""

    w: Bool[Array, " nw"]
    x: Bool[Array, " nx"]
    v: Bool[Array, " ny"]


def window_laws(
    stages: WindowStages, P_root: Float[Array, "nx n0"], measured: Bool[Array, "points ny"], chosen: Chosen
) -> Iterator[WindowPosterior]:
    """Yield the laws of the windows of 1, 2, .. samples; each one is valid until the next one is asked for.

    A missing output becomes noise alone.  A LinAlgError says that the covariance of an innovation is singular.
    """
    (points, ny), (nx, n), nr = measured.shape, P_root.shape, stages.G.shape[2]
    sizes = [each.sum() for each in chosen]
    there = measured[:, :, None] & measured[:, None, :]
    roots, C = psd_sqrt(np.where(there, stages.R_v, np.eye(ny))), np.where(measured[:, :, None], stages.C, 0.0)
    # Transposed: a row per unknown, the first ny of them for the noise of the outputs; a column per state and value.
    total, m = nx + points * sum(sizes) - sizes[0], nx
    S, gain = np.zeros((ny + n + (points - 1) * nr, total)), np.zeros((total, points * ny))
    L = np.zeros((points, nx, ny))
    before, kind = np.zeros(total), np.zeros(total, dtype=int)
    S[ny : ny + n, :nx] = P_root.T
    for j in range(points):
        old, x = m, S[ny : ny + n, :nx]
        if j > 0:
            x[:] = x @ stages.A[j - 1].T
            new, n, m = slice(ny + n, ny + n + nr), n + nr, m + sizes[0]
            S[new, :nx], S[new, old:m] = stages.G[j - 1].T, stages.W[j - 1, chosen.w].T
            x = S[ny : ny + n, :nx]
        outputs, first = x @ C[j].T, m
        m += sizes[1] + sizes[2]
        S[ny : ny + n, first : first + sizes[1]], kind[first:m] = x[:, chosen.x], 1
        S[ny : ny + n, first + sizes[1] : m], kind[first + sizes[1] : m] = -outputs[:, chosen.v], 2
        before[old:m] = np.sqrt(np.einsum("ij,ij->j", S[: ny + n, old:m], S[: ny + n, old:m]))
        array = np.empty((ny + n, ny + m))
        array[:ny, :ny], array[ny:, :ny], array[:, ny:] = roots[j], outputs, S[: ny + n, :m]
        array[:ny, ny:] = 0.0
        turned = eliminated(array, ny)[0]
        S[ny : ny + n, :m], now = turned[ny:, ny:], slice(j * ny, (j + 1) * ny)
        gain[:m, now] = np.linalg.solve(turned[:ny, :ny], turned[:ny, ny:]).T * measured[j]
        L[j] = gain[:nx, now]
        root, every = S[ny : ny + n, :m].T, slice(nx, m)
        yield WindowPosterior(root[:nx], root[nx:], gain[every, : now.stop], before[every], kind[every], L[: j + 1])


def range_root(Q: Float[Array, "n n"]) -> Float[Array, "n rank"]:
    """Return a root of a positive semidefinite matrix, Q = root root', with as many columns as its rank.

    The rank is that of the correlations, so that it does not depend on the units of the coordinates.
    """
    size = np.sqrt(np.maximum(Q.diagonal(), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    lam, U = np.linalg.eigh(symmetrise(Q / unit[:, None] / unit))
    kept = lam > RANK
    return unit[:, None] * U[:, kept] * np.sqrt(lam[kept])


def range_of_root(root: Float[Array, "n r"]) -> Float[Array, "n rank"]:
    """Return a root of the same matrix with as many columns as its rank, by the singular values of the correlations."""
    size = np.linalg.norm(root, axis=1)
    unit = np.where(size > 0.0, size, 1.0)[:, None]
    U, sizes, _ = np.linalg.svd(root / unit)
    kept = sizes > RANK
    return root if kept.all() else unit * U[:, : len(sizes)][:, kept] * sizes[kept]


FREEDOM = 1e-13
"""A smaller standard deviation after the measurements, in units of that before them, is a rounding of 0."""
ROUNDING = 1e-12
"""Allowed violation of the bounds of a fixed value, in units of the largest number of the window."""


# Most probable states of a window under bounds of noises and states, as a least-distance problem.
#
# Problem  Minimise |zeta|^2 over low <= value + rows zeta <= high, in the unknowns of window_posterior.py, in which the
#          minimum without bounds is zeta = 0 and the Hessian the identity.
#          If no bound is active the solution is therefore known and exact.
# Scale    Every row is divided by the standard deviation of its value.  The problem is homogeneous: it is divided by
#          its largest violation, so that the solver gets numbers of size 1.  Only the part of the unknowns that the
#          rows depend on is left; the rest of the minimum is 0.
# Fixed    A value without a standard deviation (no noise, or an exactly known state) cannot be moved: it is compared
#          with its bounds.


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

    x: Float[Array, "runs nx"]  # without bounds where the program has no solution
    solved: Bool[Array, " runs"]  # whether a quadratic program was necessary
    status: list[QpStatus]  # one per run; `OPTIMAL` where no program was necessary


@dataclass(frozen=True, eq=False)
class WindowProgram:
    """What is fixed in the problems of windows with the same matrices."""

    L: Float[Array, "points nx ny"]  # gains of the Kalman filter of the window
    value_gain: Float[Array, "values p"]  # values with bounds from the innovations, without bounds
    interval: Interval  # bounds of the values
    size: Float[Array, " values"]  # standard deviations of the values; 0 of a fixed one
    x_map: Float[Array, "nx s"]  # last state from the unknowns of the program
    program: QuadraticProgram  # the program of the values that are not fixed
    # predictions and innovations from the data, for short windows; see `ModelSeries.filter_map`
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

        r are innovations, 0 where a measurement is missing; `base` are values with bounds before the measurement.
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
