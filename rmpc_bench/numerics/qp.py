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
Traps    DAQP reads the memory of an array that is not contiguous as if it were, and reports a problem as optimal
         that has an entry that is not a number, or a lower bound above the upper one.  `solve` copies every array and
         checks for both.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types import Array

PRIMAL_TOL = 1e-10
"""Largest violation of a hard row, in units of the row."""
MOST_ITERATIONS = 1000
SOFT = 8
"""Mark of a soft row for DAQP."""


class QpStatus(IntEnum):
    """Result of a solver call; each status summarises one or several flags of DAQP."""

    explanation: str

    def __new__(cls, value: int, explanation: str) -> QpStatus:
        """Attach the explanation to the number."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.explanation = explanation
        return member

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
    x: Float[Array, " n"]
    """The minimum; NaN unless the status is `solved`."""
    value: float
    """Cost at the minimum, slacks included; NaN unless solved."""
    multipliers: Float[Array, " rows"]
    """Positive where an upper bound is active, negative where a lower one is."""


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """Problems that have H, the rows and the weights of their slacks in common.

    Parameters
    ----------
    H : (n, n) positive definite matrix
    A : (rows, n) matrix of the rows
    soft : (rows,) which rows are soft; none if not given
    linear : (rows,) weights of the slacks, not negative; not used in hard rows
    quadratic : (rows,) weights of the squares of the slacks, positive; not used in hard rows
    iteration_limit : largest number of iterations

    Examples
    --------
    The point of the line x_1 + x_2 = 1 that is closest to 0, and the same with a soft row of weight 0.1:

    >>> H, A = np.eye(2), np.ones((1, 2))
    >>> QuadraticProgram(H, A).solve(np.zeros(2), [1.0], [1.0]).x.round(6).tolist()
    [0.5, 0.5]
    >>> soft = QuadraticProgram(H, A, np.array([True]), np.array([0.1]), np.array([1e-3]))
    >>> answer = soft.solve(np.zeros(2), [1.0], [1.0])
    >>> answer.status.name, answer.x.round(4).tolist()
    ('SOFTENED', [0.1008, 0.1008])
    """

    H: Float[Array, "n n"]
    A: Float[Array, "rows n"]
    soft: Bool[Array, " rows"] | None = None
    linear: Float[Array, " rows"] | None = None
    quadratic: Float[Array, " rows"] | None = None
    iteration_limit: int = MOST_ITERATIONS

    def solve(self, f: Any, low: Any, high: Any) -> QpSolution:
        """Solve one problem.

        Parameters
        ----------
        f : (n,) linear part of the cost
        low, high : (rows,) bounds of the rows; infinite where there is none
        """
        f, low, high = (np.array(each, dtype=float) for each in (f, low, high))
        size = self._cost_size
        if not np.isfinite(f).all() or np.isnan(low).any() or np.isnan(high).any():
            return self._failed(QpStatus.FAILED)
        # DAQP reports such a problem as optimal, too.
        if ((low > high) & (self._marks != SOFT)).any():
            return self._failed(QpStatus.INFEASIBLE)
        # The marks are given again, which starts the solver cold.
        self._solver.update(f=f / size, bupper=high, blower=low, sense=self._marks.copy())
        x, value, flag, info = self._solver.solve()
        status = FLAGS.get(int(flag), QpStatus.FAILED)
        if not status.solved:
            return self._failed(status)
        return QpSolution(status, np.array(x), float(value) * size, np.array(info["lam"]) * size)

    def solve_block(
        self, f: Float[Array, "problems n"], low: Float[Array, "problems rows"], high: Float[Array, "problems rows"]
    ) -> tuple[Float[Array, "problems n"], list[QpStatus]]:
        """Solve many problems, each from a cold start; return their minima, NaN unless solved, and their statuses.

        The numbers are those of `solve`; the arrays are checked and copied once.

        Parameters
        ----------
        f, low, high : as in `solve`, one row per problem
        """
        f, low, high = (np.array(each, dtype=float, order="C") for each in (f, low, high))
        missing = np.asarray(~np.isfinite(f).all(axis=1) | np.isnan(low).any(axis=1) | np.isnan(high).any(axis=1))
        empty = ((low > high) & (self._marks != SOFT)).any(axis=1)
        # The solver may write into its marks: every problem has its own.
        marks = np.tile(self._marks, (len(f), 1))
        x, statuses = np.full(f.shape, np.nan), []
        f /= self._cost_size
        update, solve = self._solver.update, self._solver.solve
        for i, wrong in enumerate((missing | empty).tolist()):
            if wrong:
                statuses.append(QpStatus.FAILED if missing[i] else QpStatus.INFEASIBLE)
                continue
            update(f=f[i], bupper=high[i], blower=low[i], sense=marks[i])
            found, _, flag, _ = solve()
            status = FLAGS.get(flag, QpStatus.FAILED)
            statuses.append(status)
            if status.solved:
                x[i] = found
        return x, statuses

    def _failed(self, status: QpStatus) -> QpSolution:
        rows, n = self.A.shape
        return QpSolution(status, np.full(n, np.nan), float("nan"), np.full(rows, np.nan))

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
        if self.soft is not None and self.soft.any():
            assert self.linear is not None and self.quadratic is not None
            size = self._cost_size
            inverse = np.where(self.soft, size / np.where(self.soft, self.quadratic, 1.0), 1.0)
            weights = np.where(self.soft, self.linear / size, 0.0)
            model.soft_weights(rho_l=inverse, rho_u=inverse.copy(), w_l=weights, w_u=weights.copy())
        return model

    def __getstate__(self) -> dict[str, Any]:
        """Leave the solver out, which cannot be copied to another process."""
        made = ("_solver", "_marks", "_matrices", "_cost_size")
        return {name: value for name, value in self.__dict__.items() if name not in made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
