"""Linear programs: every status, the second objective, and SciPy as the other front end."""

import subprocess
import sys

import highspy
import numpy as np
import pytest
from conftest import SOLVER
from scipy.optimize import linprog

from rmpc_bench.numerics import lp
from rmpc_bench.numerics.lp import MEANING, Bounds, LpStatus, lexicographic, solve

INF = np.inf
C = np.array([1.0, 1.0])


def bounds(A, row_lower, row_upper, col_lower=(0, 0), col_upper=(INF, INF)):
    """Bounds of two unknowns, which are not negative unless said."""
    return Bounds(*(np.array(each, dtype=float) for each in (A, row_lower, row_upper, col_lower, col_upper)))


SMALL = bounds([[1, 2]], [1], [INF])
NOTHING = Bounds(np.zeros((0, 0)), *np.zeros((4, 0)))
IPM = {"solver": "ipm", "run_crossover": "off"}  # the simplex method knows which of the two it is
ENDS = [
    (C, SMALL, {}, LpStatus.OPTIMAL),
    (C, bounds([[1, 2], [1, 2]], [1, -INF], [INF, 0]), {}, LpStatus.INFEASIBLE),
    (C, bounds([[1, 2]], [2], [1]), {}, LpStatus.INFEASIBLE),
    (C, bounds([[1, 2]], [-INF], [1], (1, 0), (0, INF)), {}, LpStatus.INFEASIBLE),
    (-C, bounds([[1, -1]], [1], [INF]), {}, LpStatus.UNBOUNDED),
    (-C, bounds([[1, -1]], [1], [INF]), IPM, LpStatus.UNBOUNDED_OR_INFEASIBLE),
    (C, bounds([[1, np.nan]], [1], [INF]), {}, LpStatus.NOT_FINITE),
    (C, bounds([[1, INF]], [1], [INF]), {}, LpStatus.NOT_FINITE),
    (np.array([1.0, -INF]), SMALL, {}, LpStatus.NOT_FINITE),
    (C, bounds([[1, 2]], [INF], [INF]), {}, LpStatus.NOT_FINITE),
    (C, bounds([[1, 2]], [np.nan], [INF]), {}, LpStatus.NOT_FINITE),
    (C, bounds([[1, 2]], [0], [1], (0, 0), (1, -INF)), {}, LpStatus.NOT_FINITE),
    (np.zeros(0), NOTHING, {}, LpStatus.EMPTY),
    (C, SMALL, {"simplex_iteration_limit": 0}, LpStatus.ITERATION_LIMIT),
    (C, SMALL, {"time_limit": 0.0}, LpStatus.TIME_LIMIT),
    (C, bounds([[1, 2e16]], [1], [INF]), {}, LpStatus.FAILED),  # HiGHS refuses entries beyond 1e15
]


@pytest.mark.parametrize(("c", "program", "options", "status"), ENDS)
def test_every_end_is_a_status(c, program, options, status):
    """Oracle: by hand; without an optimum there are no numbers, and never an exception."""
    result = solve(c, program, options)
    assert result.status is status and result.status.explanation
    for values in (result.x, result.duals, result.reduced_costs, result.objective):
        assert np.isfinite(values).all() == (status is LpStatus.OPTIMAL) or np.size(values) == 0


def test_a_bound_of_the_objective_is_a_status():
    """Oracle: the dual method stops as soon as the optimum is certainly beyond the bound."""
    rng = np.random.default_rng(1)
    A, c = rng.random((20, 30)), 1.0 + rng.random(30)
    program = Bounds(A, np.ones(20), np.full(20, INF), np.zeros(30), np.full(30, INF))
    least = solve(c, program).objective
    result = solve(c, program, {**lp.DUAL, "objective_bound": 0.1 * least})
    assert result.status is LpStatus.OBJECTIVE_LIMIT


def test_every_status_of_highs_has_a_meaning():
    """Oracle: the members of the enum of the installed HiGHS; every meaning is explained."""
    assert set(MEANING) >= set(highspy.HighsModelStatus.__members__)
    assert {status for status in LpStatus} == {*MEANING.values(), LpStatus.NOT_FINITE}
    assert len({status.explanation for status in LpStatus}) == len(LpStatus)


@pytest.mark.parametrize("name", ["kUnknown", "kSolveError", "kMemoryLimit", "kHighsInterrupt", "a new one"])
def test_statuses_that_cannot_be_provoked(name, monkeypatch):
    """Oracle: the table, and FAILED for what it does not know; the solver says it twice."""

    class Highs(highspy.Highs):
        def getModelStatus(self):
            return type("Status", (), {"name": name})

    monkeypatch.setattr(highspy, "Highs", Highs)
    result = solve(C, SMALL)
    assert result.status is MEANING.get(name, LpStatus.FAILED) and np.isnan(result.x).all()


def test_an_optimum_that_violates_a_bound_is_none(monkeypatch):
    """Oracle: a solver that answers with another point, first by one method, then by both."""
    wrong = []

    class Solution:
        col_value, row_dual, col_dual = [0.0, 0.4], [0.5], [0.5, 0.0]

    class Highs(highspy.Highs):
        def getSolution(self):
            return Solution() if self.getOptionValue("simplex_strategy")[1] in wrong else super().getSolution()

    monkeypatch.setattr(highspy, "Highs", Highs)
    wrong.append(4)
    np.testing.assert_allclose(solve(C, SMALL).x, [0.0, 0.5])
    wrong.append(1)
    assert solve(C, SMALL).status is LpStatus.FAILED


def test_solutions_and_duals_are_scipys(rng):
    """Oracle: linprog on 30 programs; duals are its marginals."""
    for _ in range(30):
        A, c = rng.standard_normal((8, 5)), rng.standard_normal(5)
        b = A @ rng.random(5) + rng.random(8)
        program = Bounds(A, np.full(8, -INF), b, np.zeros(5), np.full(5, 3.0))
        ours, theirs = solve(c, program), linprog(c, A, b, bounds=[(0.0, 3.0)] * 5)
        np.testing.assert_allclose(ours.objective, theirs.fun, **SOLVER)
        np.testing.assert_allclose(ours.x, theirs.x, atol=1e-6)  # SciPy's tolerance is 1e-7
        np.testing.assert_allclose(ours.duals, theirs.ineqlin.marginals, atol=1e-6)
        np.testing.assert_allclose(ours.reduced_costs, theirs.lower.marginals + theirs.upper.marginals, atol=1e-6)


def test_the_same_program_twice_gives_the_same_bits(rng):
    """Oracle: the first answer; between them another program."""
    A, c = rng.random((20, 30)), rng.random(30)
    program = Bounds(A, np.ones(20), np.full(20, INF), np.zeros(30), np.full(30, INF))
    first = solve(c, program)
    solve(C, SMALL)
    np.testing.assert_array_equal(solve(c, program).x, first.x)


def test_the_second_objective_chooses_among_the_optima_of_the_first():
    """Oracle: by hand; x + y is least on the segment x + y = 1, where 2 x + y is least at (0, 1)."""
    program = bounds([[1, 1]], [1], [INF])
    for second, end in (([2.0, 1.0], [0.0, 1.0]), ([1.0, 2.0], [1.0, 0.0])):
        result = lexicographic(C, np.array(second), program)
        np.testing.assert_allclose(result.x, end, atol=1e-12)
        np.testing.assert_allclose((result.objective, *result.duals), (1.0, 1.0))


def test_the_second_objective_is_scipys_on_the_optimal_face(rng):
    """Oracle: linprog with the first objective held at its optimum, on programs with many optima."""
    for _ in range(20):
        A, b = rng.integers(0, 3, (6, 8)).astype(float), rng.integers(1, 4, 6).astype(float)
        A[:, 0] = 1.0  # so that it is feasible
        program = Bounds(A, b, np.full(6, INF), np.zeros(8), np.full(8, INF))
        first, second = np.ones(8), rng.random(8)
        ours = lexicographic(first, second, program)
        best = linprog(first, -A, -b).fun
        theirs = linprog(second, np.vstack([-A, first]), np.append(-b, best + 1e-9))
        np.testing.assert_allclose(first @ ours.x, best, rtol=1e-9)
        np.testing.assert_allclose(second @ ours.x, theirs.fun, rtol=1e-6, atol=1e-7)  # SciPy's face has a width


@pytest.mark.parametrize(("first", "second"), [(-C, C), (np.array([1.0, 0.0]), -C)])
def test_a_program_without_optimum_has_no_second_one(first, second):
    """Oracle: by hand; either the first objective falls without end, or the second one does on x = 0, y >= 1/2."""
    result = lexicographic(first, second, SMALL)
    assert result.status is LpStatus.UNBOUNDED and np.isnan(result.x).all()


def test_nothing_is_printed():
    """HiGHS 1.16 prints its version on the first use of a process, where the output of a command belongs."""
    code = (
        "import numpy as np; from rmpc_bench.numerics.lp import Bounds, solve; "
        "one = np.ones(1); solve(one, Bounds(np.eye(1), one, one, one, one))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == done.stderr == ""
