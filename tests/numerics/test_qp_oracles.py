"""Quadratic programs against other solvers and brute force, their statuses, and the traps of the solver."""

from __future__ import annotations

from itertools import product

import cvxpy as cp
import numpy as np
import pytest
import quadprog

from rmpc_bench.numerics.qp import FLAGS, QpStatus, QuadraticProgram


def random_problem(rng, n, rows, n_soft):
    """Return a program with `n_soft` soft rows, and data for which the hard rows have a point inside."""
    root = rng.standard_normal((n, n))
    H, A = root @ root.T + 0.1 * np.eye(n), rng.standard_normal((rows, n))
    soft = np.arange(rows) >= rows - n_soft
    linear, quadratic = 10.0 ** rng.uniform(-3, 1, rows), 10.0 ** rng.uniform(-3, 0, rows)
    middle = A @ rng.standard_normal(n)
    low, high = middle - rng.uniform(0.05, 1.0, rows), middle + rng.uniform(0.05, 1.0, rows)
    low[rng.random(rows) < 0.2] = -np.inf
    program = QuadraticProgram(H, A, soft, linear, quadratic)
    return program, (3.0 * rng.standard_normal(n), low, high)


def slack(program, x, low, high):
    """Smallest slack of every soft row at x; 0 for hard rows."""
    z = program.A @ x
    return np.where(program.soft, np.maximum(0.0, np.maximum(low - z, z - high)), 0.0)


def cost(program, x, f, low, high):
    """Cost at x with the smallest slacks."""
    eps = slack(program, x, low, high)
    return 0.5 * x @ program.H @ x + f @ x + program.linear @ eps + 0.5 * program.quadratic @ eps**2


def residual(program, answer, f, low, high):
    """Largest violation of the conditions of a minimum, from the multipliers of the answer."""
    x, lam, eps = answer.x, answer.multipliers, slack(program, answer.x, low, high)
    z, soft = program.A @ x, program.soft
    stationary = program.H @ x + f + program.A.T @ lam
    size = np.maximum(1.0, np.abs(lam))
    # A soft row with a slack has the multiplier linear + quadratic eps, one without at most `linear`.
    dual = np.where(eps > 1e-9, np.abs(np.abs(lam) - program.linear - program.quadratic * eps), 0.0)
    dual = np.where(soft, np.maximum(dual, np.abs(lam) - program.linear - program.quadratic * eps), 0.0)
    primal = np.maximum(0.0, np.maximum(low - eps - z, z - high - eps))
    gap = np.where(lam > 0, np.abs(z - high - eps), np.where(lam < 0, np.abs(low - eps - z), 0.0))
    return max(np.abs(stationary).max(), (dual / size).max(), primal.max(), np.abs(np.where(lam, gap, 0)).max())


def clarabel(program, f, low, high):
    """Minimum by cvxpy and Clarabel with explicit slacks."""
    n, rows = program.A.T.shape
    x, eps = cp.Variable(n), cp.Variable(rows, nonneg=True)
    objective = 0.5 * cp.quad_form(x, cp.psd_wrap(program.H)) + f @ x + program.linear @ eps
    objective += 0.5 * cp.sum(cp.multiply(program.quadratic, cp.square(eps)))
    upper, lower = np.isfinite(high), np.isfinite(low)
    rules = [(program.A @ x - eps)[upper] <= high[upper], (program.A @ x + eps)[lower] >= low[lower]]
    rules += [eps[i] == 0.0 for i in np.flatnonzero(~program.soft)]
    tight = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}
    return cp.Problem(cp.Minimize(objective), rules).solve(solver=cp.CLARABEL, **tight)


def test_random_problems_have_the_cost_of_another_solver():
    """Oracle: cvxpy with Clarabel, whose slacks are variables, in cost to 1e-6; conditions of the minimum to 1e-8."""
    rng = np.random.default_rng(19)
    for _ in range(40):
        program, data = random_problem(rng, int(rng.integers(2, 7)), int(rng.integers(4, 12)), 3)
        answer = program.solve(*data)
        assert answer.status.solved and residual(program, answer, *data) < 1e-8
        expected = clarabel(program, *data)
        np.testing.assert_allclose(cost(program, answer.x, *data), expected, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(answer.value, cost(program, answer.x, *data), rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_500_random_problems_have_the_cost_of_another_solver():
    """Oracle: as above, 500 problems."""
    rng = np.random.default_rng(500)
    for _ in range(500):
        program, data = random_problem(rng, int(rng.integers(2, 7)), int(rng.integers(4, 12)), 3)
        answer = program.solve(*data)
        assert answer.status.solved and residual(program, answer, *data) < 1e-8
        np.testing.assert_allclose(cost(program, answer.x, *data), clarabel(program, *data), rtol=1e-6, atol=1e-6)


def test_500_random_problems_satisfy_the_conditions_of_the_minimum():
    """Oracle: stationarity, both feasibilities and complementarity; they are sufficient, as the program is convex."""
    rng, softened = np.random.default_rng(7), 0
    for _ in range(500):
        program, data = random_problem(rng, int(rng.integers(2, 9)), int(rng.integers(4, 16)), 4)
        answer = program.solve(*data)
        assert answer.status.solved and residual(program, answer, *data) < 1e-8
        in_use = slack(program, answer.x, *data[1:]).max() > 1e-9
        assert (answer.status is QpStatus.SOFTENED) == in_use
        softened += in_use
    assert 50 < softened < 450


def test_hard_problems_have_the_minimum_of_quadprog():
    """Oracle: quadprog (Goldfarb and Idnani), the minimum itself."""
    rng = np.random.default_rng(3)
    for _ in range(100):
        program, (f, low, high) = random_problem(rng, 4, 8, 0)
        lower = np.isfinite(low)
        C, b = np.vstack([program.A[lower], -program.A]).T, np.concatenate([low[lower], -high])
        expected = quadprog.solve_qp(program.H, -f, C, b)[0]
        np.testing.assert_allclose(program.solve(f, low, high).x, expected, rtol=1e-9, atol=1e-10)


def test_small_problems_have_the_minimum_of_brute_force():
    """Oracle: the best feasible point among the minima on all faces."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        program, (f, low, high) = random_problem(rng, 2, 4, 0)
        H, A, best = program.H, program.A, (np.inf, None)
        for face in product((None, low, high), repeat=4):
            active = [i for i, bound in enumerate(face) if bound is not None]
            b = np.array([face[i][i] for i in active])
            if len(active) > 2 or not np.isfinite(b).all():
                continue
            K = np.block([[H, A[active].T], [A[active], np.zeros((len(active), len(active)))]])
            x = np.linalg.solve(K, np.concatenate([-f, b]))[:2]
            z = A @ x
            if (z >= low - 1e-9).all() and (z <= high + 1e-9).all():
                best = min(best, (0.5 * x @ H @ x + f @ x, tuple(x)))
        np.testing.assert_allclose(program.solve(f, low, high).x, best[1], rtol=1e-8, atol=1e-9)


def test_a_block_has_the_bytes_of_single_problems_in_any_order():
    """Oracle: every problem starts cold; the naive way, which keeps the state of the solver, has other last digits."""
    rng = np.random.default_rng(5)
    program, _ = random_problem(rng, 5, 10, 4)
    f, middle = 3.0 * rng.standard_normal((200, 5)), rng.standard_normal((200, 5)) @ program.A.T
    low, high = middle - 0.2, middle + 0.3
    x, statuses = program.solve_block(f, low, high)
    order = rng.permutation(200)
    again, _ = program.solve_block(f[order], low[order], high[order])
    np.testing.assert_array_equal(again, x[order])
    for i in range(0, 200, 7):
        answer = program.solve(f[i], low[i], high[i])
        assert answer.status is statuses[i]
        np.testing.assert_array_equal(answer.x, x[i])


def test_arrays_that_are_not_contiguous_are_read_as_they_are():
    """Oracle: the contiguous copies; the solver itself reads memory of such arrays as if they were contiguous."""
    rng = np.random.default_rng(6)
    program, (f, low, high) = random_problem(rng, 4, 8, 2)
    expected = program.solve(f, low, high)

    def spread(values):
        wide = np.full((len(values), 3), 1e9)
        wide[:, 0] = values
        return wide[:, 0]

    turned = QuadraticProgram(np.asfortranarray(program.H), np.asfortranarray(program.A), *_soft_keys(program))
    for each in (program, turned):
        answer = each.solve(spread(f), spread(low), spread(high))
        np.testing.assert_array_equal(answer.x, expected.x)
        block, _ = each.solve_block(np.array([f, f]).T.copy().T, np.array([low] * 2), np.array([high] * 2))
        np.testing.assert_array_equal(block, [expected.x] * 2)


def _soft_keys(program):
    return program.soft, program.linear, program.quadratic


@pytest.mark.parametrize("place", ["f", "low", "high"])
def test_what_is_not_a_number_is_not_solved(place):
    """Oracle: the solver itself calls such a problem optimal, with moves that are not numbers."""
    data = {"f": np.array([1.0, 1.0]), "low": np.array([-1.0, -1.0]), "high": np.array([1.0, 1.0])}
    data[place][0] = np.nan
    program = QuadraticProgram(np.eye(2), np.eye(2))
    assert program.solve(**data).status is QpStatus.FAILED
    x, statuses = program.solve_block(*(np.array([data[name], np.ones(2)]) for name in ("f", "low", "high")))
    assert statuses == [QpStatus.FAILED, QpStatus.OPTIMAL] and np.isnan(x[0]).all() and (x[1] == 1.0).all()


def test_every_flag_has_a_status():
    """Oracle: the flags of the documentation of DAQP; statuses of problems made for them."""
    assert set(FLAGS) == {1, 2, -1, -2, -3, -4, -5, -6}
    square = QuadraticProgram(np.eye(2), np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
    low, high = np.array([-1.0, -1.0, -9.0]), np.array([1.0, 1.0, 9.0])
    assert square.solve([0.0, 0.0], low, high).status is QpStatus.OPTIMAL
    # The corner (1, 1) has the sum 2.
    assert square.solve([0.0, 0.0], [-1.0, -1.0, 3.0], high).status is QpStatus.INFEASIBLE
    x, statuses = square.solve_block(
        np.zeros((2, 2)), np.array([[-1.0, -1.0, 3.0], [2.0, 0.0, 0.0]]), np.tile(high, (2, 1))
    )
    assert statuses == [QpStatus.INFEASIBLE] * 2 and np.isnan(x).all()
    limited = QuadraticProgram(np.eye(2), square.A, iteration_limit=1)
    assert limited.solve([-9.0, -9.0], low, high).status is QpStatus.ITERATION_LIMIT
    assert limited.solve_block(np.full((1, 2), -9.0), low[None], high[None])[1] == [QpStatus.ITERATION_LIMIT]


@pytest.mark.parametrize("size", [1e-20, 1e-12, 1e-6, 1e9, 1e15])
def test_the_size_of_the_cost_does_not_matter(size):
    """Cost and weights of the slacks in another unit have the same minimum; DAQP takes a small H for 0."""
    rng = np.random.default_rng(20260119)
    for _ in range(20):
        factor = rng.standard_normal((3, 3))
        H, A, f = factor @ factor.T + 0.1 * np.eye(3), rng.standard_normal((6, 3)), 3.0 * rng.standard_normal(3)
        high, soft = 0.3 * np.abs(rng.standard_normal(6)), np.arange(6) >= 3
        linear, quadratic = np.full(6, 0.03), np.full(6, 1e-3)
        expected = QuadraticProgram(H, A, soft, linear, quadratic).solve(f, -high, high)
        other = QuadraticProgram(size * H, A, soft, size * linear, size * quadratic)
        found = other.solve(size * f, -high, high)
        assert found.status is expected.status
        np.testing.assert_allclose(found.x, expected.x, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.multipliers, size * expected.multipliers, rtol=1e-6, atol=1e-9 * size)
        np.testing.assert_allclose(found.value, size * expected.value, rtol=1e-9)
        moves, statuses = other.solve_block(size * f[None], -high[None], high[None])
        assert statuses == [found.status]
        np.testing.assert_array_equal(moves[0], found.x)
