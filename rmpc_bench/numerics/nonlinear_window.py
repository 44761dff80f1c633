"""Most probable states of windows of a nonlinear model with bounds: Gauss-Newton, the windows of many runs at once.

Problem  Minimise |x(0) - x_bar|^2 in P_bar^-1 + sum |x(j+1) - f(x(j), u(j))|^2 in Q_w^-1 + sum |y(j) - h(x(j))|^2 in
         R_v^-1 over the states x(0)..x(m) of the window, low <= x(j) <= high.
Method   f and h are linearised at all samples of all runs.  With the unknowns in units of 1 / sqrt(H_ii), H the matrix
         of the quadratic cost, the step solves a linear system per run, or a quadratic program where it leaves bounds.
         It is halved until the true cost decreases.  After a halving the next matrices are damped (Levenberg).
Valleys  Small Q_w make the valley of the cost narrow and curved.  Where a step is refused, its noises x(j+1) - f(x(j))
         are tried with the states that f makes of them; without it some problems do not converge in 50 iterations.
End      The largest step is below the tolerance, in standard deviations 1 / sqrt(H_ii), which are those of a state
         whose neighbours are known.  Without that, the last iterate is left.
Dense    The block tridiagonal matrix is solved as a full one: the quadratic program needs it, and for 33 unknowns a
         sweep over the blocks in NumPy takes as long.
Steps    With error control f jumps by its tolerance where the intervals change, which is enough for endless cycles.
         They are those of the iterate while it moves, and are kept after a step shorter than a tenth of a deviation.
Bits     A run is computed alone, whatever other runs there are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rmpc_bench.numerics.intervals import Interval
from rmpc_bench.numerics.moment_transform import CentralDifferences
from rmpc_bench.numerics.qp import QuadraticProgram
from rmpc_bench.types import Array
from rmpc_bench.types.angles import wrapped

DIFFERENCES = CentralDifferences()
HALVINGS = 20
DECREASE = 1e-4
"""Part of the decrease of the linearised cost that a step must have."""
ROUNDING = 1e-12
"""Increase of the cost that may be a rounding."""
EXHAUSTED = 1e-3
"""A shorter step that does not lower the cost is at the last digits of f."""
SMALL = 0.1
"""After a shorter step the intervals of the integration are kept, so that f is smooth."""
DAMPING = 1e-3
"""First damping, in units of H_ii; it grows and shrinks by the factor 4."""


class WindowMaps(NamedTuple):
    """The model at the samples of the windows; a linear f or h has its matrices, and needs no differences."""

    advance: Callable[[int, Array, Array, int], Array]
    """Maps a first sample, states (runs, moves, points, n) from there on, inputs (runs, moves, nu) and a number to f.

    So many points, the first ones, decide on the intervals of an integration with error control.
    """
    measure: Callable[[Array, Array], Array]
    """Maps states (runs, samples, points, n) of all samples, and the inputs of `Windows`, to h."""
    Q_inv: Float[Array, "moves n n"]
    A: Float[Array, "moves n n"] | None
    C: Float[Array, "samples ny n"] | None
    adaptive: bool
    """Whether f depends on these intervals."""
    x_period: Float[Array, " n"] | None = None
    """Periods of states and outputs, whose differences are wrapped; None without angles."""
    y_period: Float[Array, " ny"] | None = None


class Windows(NamedTuple):
    """Data of the windows of many runs."""

    x_bar: Float[Array, "runs n"]
    P_inv: Float[Array, "runs n n"]
    u: Float[Array, "runs inputs nu"]
    """One per move, and one more where h depends on it."""
    y: Float[Array, "runs samples ny"]
    """0 where a measurement is missing."""
    R_inv: Float[Array, "runs samples ny ny"]
    """0 in the rows and columns of a missing measurement."""
    size: Float[Array, "runs samples n"]
    """Standard deviations of predictions, for the steps of differences."""
    lead: Float[Array, "runs samples points n"] = np.zeros((0, 0, 0, 0))
    """Points that decide on intervals, which `solve` chooses; none if nothing depends on them."""

    def of(self, rows: Array) -> Windows:
        """Return those of some runs."""
        return Windows(*(each[rows] for each in self))


class Fits(NamedTuple):
    """States of the windows, and how they were found."""

    x: Float[Array, "runs samples n"]
    iterations: Int[Array, " runs"]
    converged: Bool[Array, " runs"]
    defined: Bool[Array, " runs"]  # whether the cost of the start is a number; elsewhere x is the start


class _Linearised(NamedTuple):
    """The cost at x, half its gradient and half its matrix of second derivatives without those of f and h."""

    f: Float[Array, "runs moves n"]
    F: Float[Array, "runs moves n n"]
    cost: Float[Array, " runs"]
    g: Float[Array, "runs unknowns"]
    H: Float[Array, "runs unknowns unknowns"]

    def of(self, rows: Array) -> _Linearised:
        """Return that of some runs."""
        return _Linearised(*(each[rows] for each in self))


@dataclass(frozen=True)
class WindowSolver:
    """The method with its bounds and its end."""

    limits: Interval | None  # bounds of the states; None where there are none
    tolerance: float  # step at which the iteration ends, in standard deviations
    iterations: int  # most iterations

    @np.errstate(all="ignore")  # trial points may overflow
    def solve(self, maps: WindowMaps, data: Windows, start: Float[Array, "runs samples n"]) -> Fits:
        """Return the states of all windows."""
        runs = len(start)
        x, lam, count = self._inside(start), np.zeros(runs), np.zeros(runs, dtype=int)
        converged, defined, rows = np.zeros(runs, dtype=bool), np.ones(runs, dtype=bool), np.arange(runs)
        data, fixed = data._replace(lead=self._leading(maps, x, data.size)), np.zeros(runs, dtype=bool)
        for iteration in range(self.iterations):
            some = data.of(rows)
            now = self._linearised(maps, some, x[rows])
            defined[rows] &= np.isfinite(now.cost) | (iteration > 0)
            size, step = self._step(now, x[rows], lam[rows])
            usable = np.isfinite(now.cost) & np.isfinite(size)
            if not usable.any():
                break
            count[rows[usable]] += 1
            rows, size, step, some, now = rows[usable], size[usable], step[usable], some.of(usable), now.of(usable)
            x[rows], t = self._searched(maps, some, now, x[rows], step, size)
            lam[rows] = np.where(t < 1.0, np.maximum(4.0 * lam[rows], DAMPING), 0.25 * lam[rows])
            lam[lam < 1e-3 * DAMPING] = 0.0
            small = size <= SMALL
            anew = rows[~(small & fixed[rows])]
            data.lead[anew], fixed[rows] = self._leading(maps, x[anew], data.size[anew]), small
            converged[rows] = (size <= self.tolerance) | ((t == 0.0) & (size <= EXHAUSTED))
            rows = rows[(t > 0.0) & ~converged[rows]]
            if not len(rows):
                break
        return Fits(x, count, converged, defined)

    def _leading(self, maps: WindowMaps, x: Array, size: Array) -> Float[Array, "runs samples points n"]:
        """Return the points that decide on intervals: x, and x with a step in every state."""
        (runs, m, n), flat = x.shape, x.reshape(-1, x.shape[2])
        if not maps.adaptive:
            return np.zeros((runs, m, 0, n))
        return DIFFERENCES.points(flat, size.reshape(-1, n), self.limits)[:, : n + 1].reshape(runs, m, n + 1, n)

    def _inside(self, x: Array) -> Array:
        return x.copy() if self.limits is None else np.clip(x, *self.limits)

    def _linearised(self, maps: WindowMaps, data: Windows, x: Float[Array, "runs samples n"]) -> _Linearised:
        """Linearise f and h at all samples."""
        (runs, m, n), Q_inv = x.shape, maps.Q_inv
        before = x[:, :-1]
        if maps.A is not None:
            f, F = _moved(maps, data, 0, before[:, :, None])[:, :, 0], np.broadcast_to(maps.A, (runs, m - 1, n, n))
        else:
            f, F = self._slopes(lambda z: _moved(maps, data, 0, z), before, data.size[:, :-1], maps.x_period)
        if maps.C is not None:
            h, C = maps.measure(x[:, :, None], data.u)[:, :, 0], np.broadcast_to(maps.C, (runs, *maps.C.shape))
        else:
            h, C = self._slopes(lambda z: maps.measure(z, data.u), x, data.size, maps.y_period)
        cost, (a, q, v) = _cost(maps, data, x, f, h)
        FQ, CR = F.mT @ Q_inv, C.mT @ data.R_inv
        g, D, every = (C.mT @ v[..., None])[..., 0], CR @ C, np.arange(m)
        g[:, 0] += a
        g[:, 1:] += q
        g[:, :-1] -= (F.mT @ q[..., None])[..., 0]
        D[:, 0] += data.P_inv
        D[:, 1:] += Q_inv
        D[:, :-1] += FQ @ F
        H = np.zeros((runs, m, n, m, n))
        # The axis of the samples comes first where it is indexed twice.
        H[:, every, :, every] = D.swapaxes(0, 1)
        H[:, every[:-1], :, every[1:]] = -FQ.swapaxes(0, 1)
        H[:, every[1:], :, every[:-1]] = -FQ.mT.swapaxes(0, 1)
        return _Linearised(f, F, cost, g.reshape(runs, -1), H.reshape(runs, m * n, m * n))

    def _slopes(
        self, function: Callable[[Array], Array], x: Array, size: Array, period: Array | None
    ) -> tuple[Array, Array]:
        """Return a function of all samples of all runs, and its Jacobians."""
        stack, n = x.shape[:2], x.shape[2]

        def flat(points: Array) -> Array:
            return function(points.reshape(*stack, *points.shape[1:])).reshape(*points.shape[:2], -1)

        if not x.size:
            return x, np.zeros((*stack, n, n))
        values, J = DIFFERENCES.slopes(flat, x.reshape(-1, n), size.reshape(-1, n), self.limits, period)
        return values.reshape(*stack, -1), J.reshape(*stack, -1, n)

    def _step(self, now: _Linearised, x: Array, lam: Float[Array, " runs"]) -> tuple[Array, Array]:
        """Return the size of the step in standard deviations, and the step; NaN where there is none."""
        runs, m, n = x.shape
        s = 1.0 / np.sqrt(np.einsum("rii->ri", now.H))
        H, g = now.H * s[:, :, None] * s[:, None], now.g * s
        H += lam[:, None, None] * np.eye(m * n)
        z = -_solved(H, g)
        if self.limits is not None:
            low, high = ((np.tile(end, m) - x.reshape(runs, -1)) / s for end in self.limits)
            bounded = np.tile(self.limits.bounded, m)
            leaves = ((z < low - ROUNDING) | (z > high + ROUNDING)).any(axis=1)
            for i in np.flatnonzero(leaves & np.isfinite(z).all(axis=1)):
                # The unknowns are 1 + z: the solver compares errors with the size of a bound, which may be 0 for z.
                program = QuadraticProgram(H[i], np.eye(m * n)[bounded])
                z[i] = program.solve(g[i] - H[i].sum(axis=1), 1.0 + low[i, bounded], 1.0 + high[i, bounded]).x - 1.0
        return np.abs(z).max(axis=1), (z * s).reshape(x.shape)

    def _searched(
        self, maps: WindowMaps, data: Windows, now: _Linearised, x: Array, step: Array, size: Float[Array, " runs"]
    ) -> tuple[Array, Float[Array, " runs"]]:
        """Return the first point of halved steps with a sufficient decrease, and the part of the step; 0 if none."""
        found, t, rows = x.copy(), np.ones(len(x)), np.arange(len(x))
        slope = 2.0 * (now.g * step.reshape(now.g.shape)).sum(axis=1)
        for _ in range(HALVINGS):
            some, part = data.of(rows), t[rows, None, None] * step[rows]
            enough = now.cost[rows] * (1.0 + ROUNDING) + DECREASE * t[rows] * slope[rows]
            trial = self._inside(x[rows] + part)
            cost = _cost_at(maps, some, trial)
            refused = np.flatnonzero(~(cost <= enough) & (size[rows] > EXHAUSTED)) if x.shape[1] > 1 else rows[:0]
            if len(refused):
                again, of = some.of(refused), rows[refused]
                other = self._with_noises_kept(maps, again, now.of(of), x[of], part[refused])
                cost_other = _cost_at(maps, again, other)
                better = ~(cost_other >= cost[refused]) & np.isfinite(cost_other)
                trial[refused[better]], cost[refused[better]] = other[better], cost_other[better]
            good = (cost <= enough) | (size[rows] <= self.tolerance)
            found[rows[good]] = trial[good]
            rows = rows[~good]
            if not len(rows):
                break
            t[rows] *= 0.5
        t[rows] = 0.0
        return found, t

    def _with_noises_kept(self, maps: WindowMaps, data: Windows, now: _Linearised, x: Array, step: Array) -> Array:
        """Return the states that f makes of x(0) and the process noises after a step."""
        found = self._inside(x + step)
        noise = x[:, 1:] + step[:, 1:] - now.f - (now.F @ step[:, :-1, :, None])[..., 0]
        for j in range(noise.shape[1]):
            found[:, j + 1] = self._inside(_moved(maps, data, j, found[:, j : j + 1, None])[:, 0, 0] + noise[:, j])
        return found


def _cost(maps: WindowMaps, data: Windows, x: Array, f: Array, h: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """Return the cost, and the weighted residuals of x(0), of the process noise and of the measurements."""
    terms = (
        wrapped(x[:, 0] - data.x_bar, maps.x_period),
        wrapped(x[:, 1:] - f, maps.x_period),
        wrapped(h - data.y, maps.y_period),
    )
    weights = (data.P_inv, maps.Q_inv, data.R_inv)
    a, q, v = ((W @ each[..., None])[..., 0] for W, each in zip(weights, terms, strict=True))
    sums = [(d * w).reshape(len(x), -1).sum(axis=1) for d, w in zip(terms, (a, q, v), strict=True)]
    return sums[0] + sums[1] + sums[2], (a, q, v)


def _cost_at(maps: WindowMaps, data: Windows, x: Array) -> Float[Array, " runs"]:
    f = _moved(maps, data, 0, x[:, :-1, None])[:, :, 0]
    return _cost(maps, data, x, f, maps.measure(x[:, :, None], data.u)[:, :, 0])[0]


def _moved(maps: WindowMaps, data: Windows, first: int, x: Float[Array, "runs moves points n"]) -> Array:
    """Return f of points at successive samples."""
    moves, leading = slice(first, first + x.shape[1]), data.lead.shape[2]
    points = np.concatenate([data.lead[:, moves], x], axis=2)
    return maps.advance(first, points, data.u[:, moves], leading)[:, :, leading:]


def _solved(H: Float[Array, "runs n n"], g: Float[Array, "runs n"]) -> Float[Array, "runs n"]:
    """Return H^-1 g; NaN for a singular matrix, which does not change the other runs."""
    try:
        return np.linalg.solve(H, g[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        if len(H) == 1:
            return np.full_like(g, np.nan)
        return np.concatenate([_solved(H[i : i + 1], g[i : i + 1]) for i in range(len(H))])
