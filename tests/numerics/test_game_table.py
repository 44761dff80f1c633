"""Tables of the game against the exact solution, and the cases in which they must not be used."""

import numpy as np
import pytest
from controllers import minimax_oracles as oracles

from rmpc_bench.controllers.state_feedback import game_of
from rmpc_bench.numerics.game_kernel import lookup_kernel
from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.lq_game import HALF, MIDDLE, solve, tables
from rmpc_bench.numerics.lq_windows import Stages


def looked_up(stages, M, M_w, x):
    """What the table says of every state, whether it holds, and whether the table is usable at all."""
    problem, root = game_of(stages, psd_sqrt(M_w)), psd_sqrt(M[None])
    made = tables([problem], root)
    first, holds = np.empty_like(x), np.zeros(len(x), dtype=bool)
    lookup_kernel(made.series[0], MIDDLE, HALF, x, first, holds)
    exact = np.array([solve(problem, root[0], row).first for row in x])
    return first, holds, bool(made.usable[0]), exact


@pytest.mark.parametrize("n", [2, 3, 4])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.long
def test_what_holds_is_the_exact_solution(n, seed):
    """Oracle: the solver without tables, state by state; 1e-10 of the first control is what the tables are for."""
    rng = np.random.default_rng((n, seed))
    stages = oracles.random_stages(rng, n, 1, 8)
    x = rng.standard_normal((60, n)) * np.geomspace(0.01, 30.0, 60)[:, None]
    first, holds, usable, exact = looked_up(stages, *oracles.random_sets(rng, n, 8), x)
    assert usable
    assert holds[:30].all()  # states of the size of the noise
    error = np.abs(first - exact).max(axis=1) / np.maximum(np.abs(exact).max(axis=1), 1e-3)
    assert error[holds].max() < 1e-10


def test_a_state_too_large_for_the_window_does_not_hold():
    """Oracle: its optimum off the edge (tests of lq_game), or beyond the window."""
    stages = oracles.paper_stages(0, 10)
    M, M_w = np.diag([20.0, 10.0]), np.broadcast_to(np.array([[5.0, 2.0], [2.0, 5.0]]), (10, 2, 2))
    x = np.array([[1e5, -1e5], [1e9, 1e9], [3.0, -2.0], [0.0, 0.0]])
    _, holds, usable, _ = looked_up(stages, M, M_w, x)
    assert usable
    np.testing.assert_array_equal(holds, [False, False, True, True])


def nearly_double(gap):
    """Two systems side by side whose eigenvalues of M^1/2 Y_0 M^1/2 differ by little and cross as the price changes."""
    A = np.broadcast_to(np.diag([0.9, 0.7]), (6, 2, 2))
    B, Q, R = np.ones((6, 2, 1)), np.broadcast_to(np.eye(2), (6, 2, 2)), np.ones((6, 1, 1))
    stages, M_w = Stages(A, B, np.ascontiguousarray(Q), R), np.broadcast_to(np.diag([0.3, 1.0]), (6, 2, 2))
    problem = game_of(stages, psd_sqrt(M_w))
    from rmpc_bench.numerics.game_kernel import Y, backward_kernel

    made = tables([problem], np.eye(2)[None])
    X = np.empty((6, 2, 2))
    price = made.tau_min[0] * (1.0 + np.exp(made.s[0] + 1.0))
    assert backward_kernel(*problem, np.full(6, price), X, np.empty((2, 0, 2, 2)))
    return stages, np.diag([1.0 / X[Y][0, 0], (1.0 + gap) / X[Y][1, 1]]), M_w


@pytest.mark.parametrize(("gap", "expected"), [(0.0, False), (1e-3, False), (-1e-3, False), (20.0, True)])
@pytest.mark.long
def test_crossing_eigenvalues_are_noticed(gap, expected):
    """Oracle: by construction; a series through a kink has a tail, one beside it has none."""
    stages, M, M_w = nearly_double(gap)
    usable = looked_up(stages, M, M_w, np.zeros((1, 2)))[2]
    assert usable == expected


def test_no_noise_makes_no_table():
    """Oracle: where there is no price there is no function of it."""
    stages = oracles.paper_stages(0, 3)
    made = tables([game_of(stages, np.zeros((3, 2, 2)))], np.eye(2)[None])
    assert not made.usable[0] and made.tau_min[0] == 0.0
