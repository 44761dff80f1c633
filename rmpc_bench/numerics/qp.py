"""Quadratic programs by DAQP: strictly convex, with two-sided rows that may be soft.

Problem  Minimise 1/2 x' H x + f' x + sum over soft rows of linear eps_i + 1/2 quadratic eps_i^2
         over low <= A x <= high (hard rows) and low - eps <= A x <= high + eps, eps >= 0 (soft rows: one slack each).
         H, A and the weights of the slacks are fixed; f, low and high differ from problem to problem.
Solver   DAQP, a dual active-set method (Arnstrom, Bemporad, Axehill 2022).  Every problem starts cold: a warm start
         gives other last digits if the same problems are solved in another order.  Its own soft rows need no variable
         for the slack.
Scale    DAQP has absolute tolerances: unknowns, rows and slacks should be of size 1.  The size of the cost does not
         matter.  DAQP treats the matrix of a small cost (1e-12) as 0 and reports a wrong point as optimal.  H, f and
         the weights of the slacks are therefore divided by a power of 4, so that H is of size 1.
Check    Stationarity, feasibility of point and multipliers, and complementarity of every answer are checked in the
         units of the problem, each one relative to its largest term.  DAQP takes nearly dependent rows for
         dependent ones: where an answer fails, or rows are so, `refined` solves the problem again.
Traps    DAQP reads the memory of an array that is not contiguous as if it were, and reports a problem as optimal
         that has an entry that is not a number, or a lower bound above the upper one.  `solve` copies every array and
         checks for both.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.numerics.linalg import SMALLEST, eliminated, mv
from rmpc_bench.types import Array
from rmpc_bench.types.records import Explained

SATISFIED = 1e-13
"""Largest violation of a row relative to its terms."""


# Quadratic programs whose active rows are nearly dependent: a dual active-set method without squared matrices.
#
# Problem  That of qp.py as a least distance: minimise |y|^2 over G y >= h with y = R x + R^-T f, H = R' R, and for
#          every soft row one more unknown e = sqrt(quadratic) (eps + linear / quadratic).
# Method   Goldfarb and Idnani, Mathematical Programming 27 (1983).  The normals of the active rows are factorised anew
#          in every step by `eliminated`, which keeps the digits of every unknown: an unknown that moves the rows 1e-36
#          times as much as others, as in predictions of unstable plants, counts exactly where the others are used up.
# Cost     About 1 ms for ten unknowns; only for problems that DAQP does not solve.


def refined(
    H: Float[Array, "n n"],
    A: Float[Array, "rows n"],
    soft: Bool[Array, " rows"],
    weights: tuple[Array, Array],
    f: Float[Array, " n"],
    low: Float[Array, " rows"],
    high: Float[Array, " rows"],
) -> tuple[Float[Array, " n"], Float[Array, " rows"]] | None:
    """Return the minimum and the multipliers, None without a point; a ValueError where the method fails."""
    n, rows = A.shape[1], np.arange(len(A))
    R = np.linalg.cholesky(H).T
    shift = np.linalg.solve(R.T, f)
    turned = np.linalg.solve(R.T, A.T).T
    of_slack = np.zeros((len(A), int(soft.sum())))
    linear, quadratic = (each[soft] for each in weights)
    of_slack[rows[soft], np.arange(len(linear))] = 1.0 / np.sqrt(quadratic)
    offset, eye = of_slack @ (linear / np.sqrt(quadratic)), np.eye(len(linear))
    moved = turned @ shift
    G = np.vstack(
        [np.hstack([np.zeros((len(linear), n)), eye]), np.hstack([turned, of_slack]), np.hstack([-turned, of_slack])]
    )
    h = np.concatenate([linear / np.sqrt(quadratic), low + moved + offset, offset - high - moved])
    there = np.isfinite(h)
    found = _least_distance(G[there], h[there], len(linear))
    if found is None:
        return None
    y, lam = found
    every = np.zeros(len(h))
    every[there] = lam
    below, above = np.split(every[len(linear) :], 2)
    return np.linalg.solve(R, y[:n] - shift), above - below


def _least_distance(G: Float[Array, "m n"], h: Float[Array, " m"], start: int) -> tuple[Array, Array] | None:
    """Return the y with the least |y| and G y >= h, and y = G' lam; the first ``start`` rows are active at first."""
    (m, n), active, p, lam = G.shape, list(range(start)), -1, np.zeros(len(G))
    sizes = np.abs(G).max(axis=0, initial=0.0)
    stack, short, violated = np.hstack([G.T, np.eye(n)]), 0.0, np.zeros(m)
    for _ in range(20 * (m + n)):
        k, scale = len(active), sizes.copy()
        T, order = eliminated(np.hstack([G[active].T, stack]), k, scale)
        R, first, rest = T[:k, :k], T[:k, k:], T[k:, k:]
        if p < 0:
            t = np.linalg.solve(R.T, h[active][order])
            both, lam[:] = t @ first, 0.0
            lam[np.array(active, dtype=int)[order]] = np.linalg.solve(R, t)
            y = both[m:]
            violated = h - both[:m]
            violated = np.where(violated > SATISFIED * (np.abs(h) + np.abs(G) @ np.abs(y)), violated, 0.0)
            violated[active] = 0.0
            p = int(np.argmax(violated))
            short = violated[p]
            if not short > 0.0:
                return y, lam
        r = np.zeros(k)
        r[order] = np.linalg.solve(R, first[:, p])
        left = np.where(np.abs(rest[:, p]) > SMALLEST * scale[k:], rest[:, p], 0.0)
        gain = float(left @ left)
        blocking = np.flatnonzero(r > SMALLEST * np.abs(r).max(initial=0.0))
        ratios = lam[active][blocking] / r[blocking]
        partial, full = ratios.min(initial=np.inf), short / gain if gain > 0.0 else np.inf
        step = min(partial, full)
        if step == np.inf:
            return None
        lam[active] -= step * r
        lam[p] += step
        short -= step * gain
        if full <= partial:
            active.append(p)
            p = -1
        else:
            dropped = active.pop(int(blocking[np.argmin(ratios)]))
            lam[dropped] = 0.0
    raise ValueError("too many steps")


PRIMAL_TOL = 1e-10
"""Largest violation of a hard row, in units of the row."""
MOST_ITERATIONS = 1000
KKT = 1e-9
"""Residual of a condition of the minimum, relative to its largest term, above which a problem is solved again."""
ACCEPTED = 1e-7
"""Largest residual of an answer: large weights of slacks beside larger multipliers leave no better one."""
DEPENDENT = 1e-4
"""Ratio of singular values of the rows below which DAQP's word for an infeasible problem is checked."""
TINY = float(np.finfo(float).tiny)
SOFT = 8
"""Mark of a soft row for DAQP."""


class QpStatus(Explained):
    """Result of a solver call; each status summarises one or several flags of DAQP."""

    OPTIMAL = 0, "the minimum has been found, and no slack is in use"
    SOFTENED = 1, "the minimum has been found, and a slack is in use"
    INFEASIBLE = 2, "no point satisfies all hard rows"
    ITERATION_LIMIT = 3, "the solver has used up its iterations"
    FAILED = 4, "the solver has failed numerically or rejected the problem, or an entry is not a number"

    @property
    def solved(self) -> bool:
        """Whether the answer is the minimum."""
        return self <= QpStatus.SOFTENED


FLAGS = {
    1: QpStatus.OPTIMAL,
    2: QpStatus.SOFTENED,
    -1: QpStatus.INFEASIBLE,
    -2: QpStatus.FAILED,
    -3: QpStatus.FAILED,
    -4: QpStatus.ITERATION_LIMIT,
    -5: QpStatus.FAILED,
    -6: QpStatus.FAILED,
}
"""Flag of DAQP -> status: -2 cycling, -3 unbounded, -5 bad data, -6 overdetermined initial set."""


class QpSolution(NamedTuple):
    """Answer of the solver."""

    status: QpStatus
    x: Float[Array, " n"]  # the minimum; NaN unless the status is `solved`
    value: float  # cost at the minimum, slacks included; NaN unless solved
    multipliers: Float[Array, " rows"]  # positive where an upper bound is active, negative where a lower one is


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """Problems that have H, the rows and the weights of their slacks in common."""

    H: Float[Array, "n n"]  # positive definite
    A: Float[Array, "rows n"]
    soft: Bool[Array, " rows"] | None = None  # which rows are soft; none if not given
    linear: Float[Array, " rows"] | None = None  # weights of the slacks, not negative; not used in hard rows
    quadratic: Float[Array, " rows"] | None = None  # those of their squares, positive; not used in hard rows
    iteration_limit: int = MOST_ITERATIONS

    def solve(self, f: Any, low: Any, high: Any) -> QpSolution:
        """Solve one problem with the linear part f of the cost; bounds of rows are infinite where there is none."""
        f, low, high = (np.array(each, dtype=float)[None] for each in (f, low, high))
        (x,), (lam,), (status,) = self._solved(f, low, high)
        eps = self._slacks(mv(self._matrices[1], x[None]), low, high)[0]
        linear, quadratic = self._weights
        value = 0.5 * x @ self.H @ x + f[0] @ x + linear @ eps + 0.5 * quadratic @ eps**2
        return QpSolution(status, x, float(value), lam)

    def solve_block(
        self, f: Float[Array, "problems n"], low: Float[Array, "problems rows"], high: Float[Array, "problems rows"]
    ) -> tuple[Float[Array, "problems n"], list[QpStatus]]:
        """Solve many problems, each from a cold start; return their minima, NaN unless solved, and their statuses."""
        x, _, statuses = self._solved(f, low, high)
        return x, statuses

    def nearest(
        self, low: Float[Array, "problems rows"], high: Float[Array, "problems rows"]
    ) -> tuple[Float[Array, "problems n"], list[QpStatus]]:
        """Solve many problems with f = 0; without soft rows they are divided by their largest violation."""
        unit = np.ones((len(low), 1))
        if not self._marks.any():
            largest = np.maximum(np.maximum(low, -high), 1.0).max(axis=1, initial=1.0)
            # A power of 2 changes no digits.
            unit = np.exp2(np.round(np.log2(largest)))[:, None]
        x, statuses = self.solve_block(np.zeros((len(low), len(self.H))), low / unit, high / unit)
        return unit * x, statuses

    def _solved(self, f: Any, low: Any, high: Any) -> tuple[Array, Array, list[QpStatus]]:
        """Return minima, multipliers and statuses; the arrays are checked and copied once."""
        f, low, high = (np.array(each, dtype=float, order="C") for each in (f, low, high))
        missing = np.asarray(~np.isfinite(f).all(axis=1) | np.isnan(low).any(axis=1) | np.isnan(high).any(axis=1))
        # DAQP reports such a problem as optimal, too.
        empty = ((low > high) & (self._marks != SOFT)).any(axis=1)
        # The solver may write into its marks: every problem has its own, which starts it cold.
        marks = np.tile(self._marks, (len(f), 1))
        x, lam, statuses = np.full(f.shape, np.nan), np.full(low.shape, np.nan), []
        scaled = f / self._cost_size
        update, solve = self._solver.update, self._solver.solve
        for i, wrong in enumerate((missing | empty).tolist()):
            if wrong:
                statuses.append(QpStatus.FAILED if missing[i] else QpStatus.INFEASIBLE)
                continue
            update(f=scaled[i], bupper=high[i], blower=low[i], sense=marks[i])
            found, _, flag, info = solve()
            status = FLAGS.get(flag, QpStatus.FAILED)
            statuses.append(status)
            if status.solved:
                x[i], lam[i] = found, info["lam"]
        lam *= self._cost_size
        sound = self._kkt(f, low, high, x, lam, KKT) <= KKT
        for i in np.flatnonzero(~sound & ~missing & ~empty).tolist():
            # Hard rows only leave no point; DAQP says so of soft rows in small units, too.
            unsure = self._nearly_dependent or self._marks.any()
            believed = statuses[i] is QpStatus.INFEASIBLE and not unsure
            if statuses[i] is not QpStatus.ITERATION_LIMIT and not believed:
                statuses[i] = self._again(f[i], low[i], high[i], x[i], lam[i])
        return x, lam, statuses

    def _again(self, f: Array, low: Array, high: Array, x: Array, lam: Array) -> QpStatus:
        """Solve a problem by the other method, and write the better one of both answers, NaN unless it is solved."""
        answers = [(x.copy(), lam.copy())]
        x[:], lam[:] = np.nan, np.nan
        with suppress(ValueError, np.linalg.LinAlgError):
            found = refined(self.H, self.A, self._marks == SOFT, self._weights, f, low, high)
            if found is None:
                return QpStatus.INFEASIBLE
            answers.append(found)
        points, multipliers = (np.array(each) for each in zip(*answers, strict=True))
        residuals = self._kkt(f[None], low[None], high[None], points, multipliers, ACCEPTED)
        if not np.nanmin(np.append(residuals, np.inf)) <= ACCEPTED:
            return QpStatus.FAILED
        found = answers[int(np.nanargmin(residuals))]
        x[:], lam[:] = found
        used = (self._slacks(mv(self._matrices[1], x[None]), low, high) > 0.0).any()
        return QpStatus.SOFTENED if used else QpStatus.OPTIMAL

    def _slacks(self, z: Array, low: Array, high: Array) -> Float[Array, "problems rows"]:
        """Return the slacks of soft rows with the values z; 0 for hard rows."""
        return np.where(self._marks == SOFT, np.maximum(np.maximum(low - z, z - high), 0.0), 0.0)

    def _kkt(
        self, f: Array, low: Array, high: Array, x: Array, lam: Array, rounding: float
    ) -> Float[Array, " problems"]:
        """Return the largest residual of a condition of the minimum, relative to its largest term; NaN if unsolved."""
        # A soft row that is violated by less than `rounding`, relative to its size, is not taken for one that gives
        # way.
        rows, gradient, all_terms = self._conditions
        n, both = x.shape[1], np.concatenate([x, lam], axis=1)
        sizes, z = np.abs(both), mv(rows, x)
        terms = mv(all_terms, sizes)
        # Stationarity, then the rows: largest term of each, and the end that its multiplier belongs to.
        slope = np.abs(mv(gradient, both) + f) / np.maximum(np.maximum(terms[:, :n], np.abs(f)), TINY)
        size = np.maximum(terms[:, n:], np.maximum(np.minimum(np.abs(low), np.abs(high)), TINY))
        end, worst = np.where(lam > 0.0, high, low), [slope]
        distance, share = z - end, sizes[:, n:] / np.maximum(sizes[:, n:].max(axis=1, initial=TINY), TINY)[:, None]
        outside = np.maximum(low - z, z - high)
        if self._marks.any():
            (linear, quadratic), soft, eps = self._weights, self._marks == SOFT, self._slacks(z, low, high)
            outside, distance = outside - eps, distance - np.copysign(eps, lam)
            price = sizes[:, n:] - linear - quadratic * eps
            price = np.where(eps > rounding * size, np.abs(price), price) / np.maximum(
                np.maximum(sizes[:, n:], linear), TINY
            )
            worst.append(np.where(soft, price, 0.0))
        worst += [outside / size, np.minimum(np.abs(distance) / size, share)]
        return np.concatenate(worst, axis=1).max(axis=1, initial=0.0)

    @cached_property
    def _conditions(self) -> tuple[Array, Array, Array]:
        """A, the matrix [H A'] of the gradient, and the sizes of what x and multipliers add to gradient and rows."""
        H, A = np.array(self.H, dtype=float), self._matrices[1]
        gradient = np.hstack([H, A.T])
        return A, gradient, np.abs(np.vstack([gradient, np.pad(A, ((0, 0), (0, len(A))))]))

    @cached_property
    def _nearly_dependent(self) -> bool:
        """Whether rows may differ in a direction so short that DAQP takes them for contradictory."""
        sizes = np.linalg.svd(self._matrices[1], compute_uv=False)
        return bool(sizes.min(initial=np.inf) < DEPENDENT * sizes.max(initial=0.0))

    @cached_property
    def _weights(self) -> tuple[Array, Array]:
        """Weights of the slacks; 0 and 1 in hard rows."""
        if self.linear is None or self.quadratic is None:
            return np.zeros(len(self.A)), np.ones(len(self.A))
        soft = self._marks == SOFT
        return np.where(soft, self.linear, 0.0), np.where(soft, self.quadratic, 1.0)

    @cached_property
    def _marks(self) -> Array:
        soft = np.zeros(len(self.A), dtype=bool) if self.soft is None else self.soft
        return np.where(soft, SOFT, 0).astype(np.int32)

    @cached_property
    def _cost_size(self) -> float:
        """Power of 4 next to the largest entry of H."""
        largest = np.abs(np.diag(self.H)).max(initial=0.0)
        return float(4.0 ** np.round(np.log2(largest) / 2.0)) if 0.0 < largest < np.inf else 1.0

    @cached_property
    def _matrices(self) -> tuple[Array, Array]:
        """Contiguous copies of H, in the unit of the cost, and A, which live as long as the solver."""
        H, A = (np.array(each, dtype=float, order="C") for each in (self.H, self.A))
        return H / self._cost_size, A

    @cached_property
    def _solver(self) -> Any:
        """The solver with its factorisation of H; made again in every process."""
        import daqp

        rows, n = self.A.shape
        wide = np.full(rows, 1e30)
        model: Any = daqp.Model()
        H, A = self._matrices
        model.setup(H, np.zeros(n), A, wide, -wide, self._marks.copy())
        model.settings = {**model.settings, "primal_tol": PRIMAL_TOL, "iter_limit": self.iteration_limit}
        if self._marks.any():
            (linear, quadratic), size = self._weights, self._cost_size
            inverse, weights = size / quadratic, linear / size
            model.soft_weights(rho_l=inverse, rho_u=inverse.copy(), w_l=weights, w_u=weights.copy())
        return model

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is computed: the solver cannot be copied to another process."""
        return {each.name: getattr(self, each.name) for each in fields(self)}
