"""Linear programs by HiGHS: failures are reported as a status, not as an exception.

Problem  Minimise c' x over col_lower <= x <= col_upper, row_lower <= A x <= row_upper.
Solver   Primal simplex method on one thread, without scaling or presolve, always from the same start: HiGHS has
         returned wrong objectives after a hot start (its issue 3294), and a non-unique solution depends on the start.
         If it fails, or its solution violates a bound, the dual method with scaling is used.  The dual method is not
         used first, because it has violated bounds by 1e-6 on degenerate programs.
Scale    HiGHS has absolute tolerances and drops very small entries: data and matrix should be of size 1.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array
from rmpc_bench.types.records import Explained

FEASIBLE = 1e-9
"""Tolerance for the bounds of rows, of columns and of reduced costs."""
VIOLATED = 1e-7
"""Violation of a bound from which on a solution is rejected, relative to 1 and to the largest unknown."""
ACTIVE = 1e-8
"""Size of a dual above which its bound is active, ten times the rounding error of 0.  An error of this decision changes
the first objective by at most this number times the distance to the bound."""


class LpStatus(Explained):
    """Result of a solver call; each status summarises one or several statuses of HiGHS."""

    OPTIMAL = 0, "an optimum has been found"
    INFEASIBLE = 1, "no point satisfies all bounds"
    UNBOUNDED = 2, "the objective is unbounded below"
    UNBOUNDED_OR_INFEASIBLE = 3, "there is no optimum: the program is unbounded or infeasible"
    NOT_FINITE = 4, "the data contain an entry that is not a number, or an infinite entry that must be finite"
    EMPTY = 5, "the program has no unknowns"
    ITERATION_LIMIT = 6, "the solver has used up its iterations"
    TIME_LIMIT = 7, "the solver has used up its time"
    OBJECTIVE_LIMIT = 8, "the objective has passed a given bound or target"
    OTHER_LIMIT = 9, "the solver has used up its memory, or has reached the limit of solutions"
    INTERRUPTED = 10, "the solver has been interrupted"
    FAILED = 11, "the solver has rejected the program, failed numerically or returned an unknown status"


MEANING = {
    "kOptimal": LpStatus.OPTIMAL,
    "kInfeasible": LpStatus.INFEASIBLE,
    "kUnbounded": LpStatus.UNBOUNDED,
    "kUnboundedOrInfeasible": LpStatus.UNBOUNDED_OR_INFEASIBLE,
    "kModelEmpty": LpStatus.EMPTY,
    "kIterationLimit": LpStatus.ITERATION_LIMIT,
    "kTimeLimit": LpStatus.TIME_LIMIT,
    "kObjectiveBound": LpStatus.OBJECTIVE_LIMIT,
    "kObjectiveTarget": LpStatus.OBJECTIVE_LIMIT,
    "kMemoryLimit": LpStatus.OTHER_LIMIT,
    "kSolutionLimit": LpStatus.OTHER_LIMIT,
    "kInterrupt": LpStatus.INTERRUPTED,
    "kHighsInterrupt": LpStatus.INTERRUPTED,
    **dict.fromkeys(("kNotset", "kLoadError", "kModelError", "kPresolveError", "kSolveError"), LpStatus.FAILED),
    **dict.fromkeys(("kPostsolveError", "kUnknown"), LpStatus.FAILED),
}
"""Every status of HiGHS 1.15; a status that a later version adds is treated as `FAILED`."""

OPTIONS: Mapping[str, Any] = {
    "output_flag": False,
    "threads": 1,
    "solver": "simplex",
    "presolve": "off",
    "primal_feasibility_tolerance": FEASIBLE,
    "dual_feasibility_tolerance": FEASIBLE,
    "small_matrix_value": 1e-12,
}
PRIMAL: Mapping[str, Any] = {"simplex_strategy": 4, "simplex_scale_strategy": 0}
DUAL: Mapping[str, Any] = {"simplex_strategy": 1, "simplex_scale_strategy": 2}


class Bounds(NamedTuple):
    """Feasible set of a program; a missing bound is infinite."""

    A: Float[Array, "m n"]
    row_lower: Float[Array, " m"]
    row_upper: Float[Array, " m"]
    col_lower: Float[Array, " n"]
    col_upper: Float[Array, " n"]


class LpResult(NamedTuple):
    """Solution of a program; NaN without an optimum."""

    x: Float[Array, " n"]
    duals: Float[Array, " m"]  # derivative of the optimum with respect to the bound of a row
    reduced_costs: Float[Array, " n"]  # derivative of the optimum with respect to the bound of a column
    objective: float
    status: LpStatus


def solve(c: Float[Array, " n"], bounds: Bounds, options: Mapping[str, Any] | None = None) -> LpResult:
    """Solve a linear program, with options of HiGHS in addition to those of this module."""
    if not _is_a_program(c, bounds):
        return _no_result(bounds, LpStatus.NOT_FINITE)
    result = _run(c, bounds, {**PRIMAL, **(options or {})})
    return _run(c, bounds, {**DUAL, **(options or {})}) if result.status is LpStatus.FAILED else result


def _run(c: Array, bounds: Bounds, options: Mapping[str, Any]) -> LpResult:
    import highspy

    highs = _silent(highspy.Highs)()
    for name, value in {**OPTIONS, **options}.items():
        highs.setOptionValue(name, value)
    if highs.passModel(_model(c, bounds)) == highspy.HighsStatus.kError:
        return _no_result(bounds, LpStatus.FAILED)
    highs.run()
    status = MEANING.get(highs.getModelStatus().name, LpStatus.FAILED)
    if status is not LpStatus.OPTIMAL:
        return _no_result(bounds, status)
    solution = highs.getSolution()
    x, duals, costs = (np.array(values) for values in (solution.col_value, solution.row_dual, solution.col_dual))
    if not _violation(x, bounds) <= VIOLATED * max(1.0, float(np.abs(x).max())):
        return _no_result(bounds, LpStatus.FAILED)
    return LpResult(x, duals, costs, highs.getObjectiveValue(), status)


@functools.cache
def _silent(solver: Any) -> Any:
    """Return a class of the solver that prints no version: HiGHS 1.16 does so before it takes an option."""

    class Silent(solver):  # type: ignore[misc]
        def enableCallbacks(self) -> None:  # noqa: N802 - the first call of its constructor
            self.setOptionValue("output_flag", False)
            super().enableCallbacks()

    return Silent


def _violation(x: Array, bounds: Bounds) -> float:
    """Return the largest violation of a bound at a point."""
    rows = bounds.A @ x
    beyond = (bounds.row_lower - rows, rows - bounds.row_upper, bounds.col_lower - x, x - bounds.col_upper)
    return float(np.concatenate(beyond).max())


def lexicographic(first: Float[Array, " n"], second: Float[Array, " n"], bounds: Bounds) -> LpResult:
    """Minimise one objective and, over its optima, a second one; objective and duals are those of the first program."""
    found = solve(first, bounds)
    if found.status is not LpStatus.OPTIMAL:
        return found
    rows = _kept(bounds.row_lower, bounds.row_upper, found.duals)
    columns = _kept(bounds.col_lower, bounds.col_upper, found.reduced_costs)
    chosen = solve(second, Bounds(bounds.A, *rows, *columns))
    if chosen.status is not LpStatus.OPTIMAL:
        return _no_result(bounds, chosen.status)
    return found._replace(x=chosen.x)


def _kept(lower: Array, upper: Array, duals: Array) -> tuple[Array, Array]:
    """Return the bounds of the set of optima: by complementary slackness a bound with a dual holds with equality."""
    return np.where(duals < -ACTIVE, upper, lower), np.where(duals > ACTIVE, lower, upper)


def _model(c: Array, bounds: Bounds) -> Any:
    import highspy

    model = highspy.HighsLp()
    model.num_row_, model.num_col_ = bounds.A.shape
    model.col_cost_, model.col_lower_, model.col_upper_ = c, bounds.col_lower, bounds.col_upper
    model.row_lower_, model.row_upper_ = bounds.row_lower, bounds.row_upper
    rows, columns = np.nonzero(bounds.A)
    model.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    model.a_matrix_.start_ = np.searchsorted(rows, np.arange(len(bounds.A) + 1)).astype(np.int32)
    model.a_matrix_.index_ = columns.astype(np.int32)
    model.a_matrix_.value_ = bounds.A[rows, columns]
    return model


def _is_a_program(c: Array, bounds: Bounds) -> bool:
    """Whether all data are numbers, and infinite only if this means a missing bound."""
    lower = np.concatenate([bounds.row_lower, bounds.col_lower])
    upper = np.concatenate([bounds.row_upper, bounds.col_upper])
    return bool(
        np.isfinite(c).all() and np.isfinite(bounds.A).all() and (lower < np.inf).all() and (upper > -np.inf).all()
    )


def _no_result(bounds: Bounds, status: LpStatus) -> LpResult:
    m, n = bounds.A.shape
    return LpResult(np.full(n, np.nan), np.full(m, np.nan), np.full(n, np.nan), np.nan, status)
