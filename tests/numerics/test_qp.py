"""Quadratic programs: solutions known in closed form, and problems without one."""

from __future__ import annotations

import pickle

import numpy as np

from rmpc_bench.numerics.qp import QpStatus, QuadraticProgram


def test_a_box_clips_the_minimum_of_a_diagonal_cost() -> None:
    program = QuadraticProgram(np.diag([1.0, 2.0, 4.0]), np.eye(3))
    answer = program.solve([1.0, 1.0, 1.0], [-0.4] * 3, [0.4] * 3)
    np.testing.assert_allclose(answer.x, [-0.4, -0.4, -0.25], rtol=1e-12)
    assert answer.status is QpStatus.OPTIMAL


def test_problems_without_a_point_are_infeasible() -> None:
    program = QuadraticProgram(np.eye(2), np.array([[1.0, 0.0], [1.0, 0.0]]))
    assert program.solve([0.0, 0.0], [1.0, -1.0], [2.0, 0.0]).status is QpStatus.INFEASIBLE
    # A lower bound above the upper one, which the solver itself calls optimal.
    assert program.solve([0.0, 0.0], [1.0, -1.0], [0.0, 1.0]).status is QpStatus.INFEASIBLE


def test_a_program_can_be_sent_to_another_process_after_it_has_been_used() -> None:
    program = QuadraticProgram(np.eye(2), np.eye(2))
    before = program.solve([1.0, 2.0], [-0.5] * 2, [0.5] * 2)
    after = pickle.loads(pickle.dumps(program)).solve([1.0, 2.0], [-0.5] * 2, [0.5] * 2)
    np.testing.assert_array_equal(before.x, after.x)
