"""The second method for quadratic programs, the check of every answer, and the elimination of graded rows."""

import mpmath as mp
import numpy as np
import pytest
from controllers.exact_programs import boxed_minimum, cost_of
from controllers.predictions import predict_moves
from numerics.test_qp_oracles import random_problem, residual

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.numerics.linalg import eliminated
from rmpc_bench.numerics.qp import QpSolution, QpStatus, QuadraticProgram, refined


def test_both_methods_have_the_same_minima():
    """Oracle: DAQP, and the conditions of the minimum; hard and soft rows."""
    rng = np.random.default_rng(8)
    for number in range(60):
        program, data = random_problem(rng, int(rng.integers(2, 7)), int(rng.integers(4, 12)), 3 * (number % 2))
        weights = np.where(program.soft, program.linear, 0.0), np.where(program.soft, program.quadratic, 1.0)
        x, lam = refined(program.H, program.A, program.soft, weights, *data)
        np.testing.assert_allclose(x, program.solve(*data).x, rtol=0, atol=1e-8)
        assert residual(program, QpSolution(QpStatus.OPTIMAL, x, 0.0, lam), *data) < 1e-8


def test_rows_without_a_point():
    """Oracle: x >= 1 and x <= -1, in a direction that is 1e-30 times as long as the other one."""
    A, low, high = np.array([[1.0, 1e-30], [1.0, -1e-30]]), np.array([1.0, -2.0]), np.array([2.0, -1.0])
    nothing = np.zeros(2), np.ones(2)
    # x_1 = 0 and x_2 = 1e30 satisfies both.
    x, _ = refined(np.eye(2), A, np.zeros(2, dtype=bool), nothing, np.zeros(2), low, high)
    np.testing.assert_allclose(A @ x, [1.0, -1.0], rtol=1e-12)
    found, (status,) = QuadraticProgram(np.eye(2), A).nearest(low[None], high[None])
    assert status.solved
    np.testing.assert_allclose(found[0], x, rtol=1e-9, atol=1e-9)
    assert refined(np.eye(2), A[[0, 0]], np.zeros(2, dtype=bool), nothing, np.zeros(2), low, high) is None


@pytest.mark.parametrize("Hp", [20, 30, 40])
def test_a_badly_conditioned_cost_is_never_solved_wrongly(Hp):
    """Oracle: 27 active sets in exact arithmetic; DAQP alone returned -0.61638 for -0.8 at Hp 30, flag 1."""
    A, B, C = np.array([[1.5, 0.1], [0.0, 0.9]]), np.array([[1.0], [0.1]]), np.array([[1.0, 0.0]])
    x, before, S = np.array([1.43013, -0.155130]), -0.500686, np.tril(np.ones((3, 3)))
    Psi, Upsilon, Theta = predict_moves(LinearModel(A, B, C, np.eye(2), np.eye(1)), Hp, 3)
    error = Psi @ x + Upsilon @ [before] - 1.0
    program = QuadraticProgram(2.0 * (Theta.T @ Theta + 0.1 * np.eye(3)), S)
    answer = program.solve(2.0 * Theta.T @ error, np.full(3, -0.8 - before), np.full(3, 0.8 - before))
    with mp.workdps(100):
        expected = boxed_minimum(*cost_of(A, B, C, [[1]], [[0.1]], x, [1.0], Hp, 3, [before]), -0.8, 0.8)
    assert answer.status is QpStatus.FAILED or abs(answer.x[0] + before - expected[0]) < 1e-6


def test_a_wrong_answer_of_the_solver_is_replaced(monkeypatch):
    """The solver calls wrong points and wrong multipliers optimal: every condition is checked."""
    rng = np.random.default_rng(9)

    class Wrong:
        def __init__(self, solver, change):
            self.solver, self.change, self.update = solver, change, solver.update

        def solve(self):
            x, value, flag, info = self.solver.solve()
            x, lam = self.change(np.array(x), np.array(info["lam"]))
            return x, value, flag, {**info, "lam": lam}

    changes = (
        lambda x, lam: (x + 1e-6, lam),
        lambda x, lam: (x, -lam),
        lambda x, lam: (x, lam + 1e-6),
        lambda x, lam: (0.0 * x, 0.0 * lam),
    )
    for change in changes:
        program, data = random_problem(rng, 4, 8, 2)
        expected = program.solve(*data)
        program.__dict__["_solver"] = Wrong(program._solver, change)
        found = program.solve(*data)
        assert found.status is expected.status
        np.testing.assert_allclose(found.x, expected.x, rtol=0, atol=1e-8)


def test_elimination_keeps_the_digits_of_small_rows(rng):
    """Oracle: 60 digits; without interchanges a row of size 1 beside one of size 1e20 is rounding."""
    T = rng.standard_normal((6, 5)) * np.array([1.0, 1e20, 1e-10, 1e8, 1.0, 1e15])[:, None]
    turned, order = eliminated(T, 3)
    assert sorted(order) == [0, 1, 2]
    with mp.workdps(60):
        M = mp.matrix(T.tolist())
        x = mp.lu_solve(M[:, :3].T * M[:, :3], M[:, :3].T * M[:, 3])
        expected = np.array([float(each) for each in x])
    np.testing.assert_allclose(np.linalg.lstsq(turned[:3, :3], turned[:3, 3], rcond=None)[0], expected, rtol=1e-9)
    with pytest.raises(ValueError, match="does not determine"):
        eliminated(np.ones((4, 3)), 2, np.ones(4))
