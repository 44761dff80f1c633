"""Speed of minimax control; `pytest -m perf` of this file prints the table.  Nothing here asserts a time.

Table II asks for 100 rounds x 100 steps x 3 methods = 30,000 solutions at N = 100.
"""

import numpy as np
import pytest
from controllers import minimax_oracles as oracles
from numerics import game_twin as twin

from rmpc_bench.controllers.minimax_lq import design
from rmpc_bench.controllers.state_feedback import game_of
from rmpc_bench.estimators.mixed import design as mixed
from rmpc_bench.models.mixed_noise import design as mixed_model
from rmpc_bench.numerics.linalg import psd_sqrt
from rmpc_bench.numerics.lq_game import solve
from rmpc_bench.numerics.stage_multipliers import solve_stages
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.types import Estimate

pytestmark = pytest.mark.perf

STEPS, N, BLOCK = 100, 100, 50
X = np.array([3.0, -2.0])
M_W = np.array([[5.0, 2.0], [2.0, 5.0]])


def law(n, wild=False):
    """The paper's system, or a random one with n states that varies as it does, with the mixed estimator.

    A wild one has another random A at every k: many of its states have their optimum off the edge of the domain, or
    nearly double eigenvalues, and are solved one by one.
    """
    rng = np.random.default_rng(n)
    if n == 2:
        A, B, C, M_w = oracles.paper_stages(0, STEPS + N).A, [[1.0], [0.3]], [[0.2, 1.0]], M_W
    else:
        wave = (1.0 + 0.1 * np.sin(np.arange(STEPS + N)))[:, None, None]
        A = oracles.random_stages(rng, n, 1, STEPS + N).A if wild else oracles.random_stages(rng, n, 1, 1).A * wave
        B, C = rng.standard_normal((n, 1)), rng.standard_normal((1, n))
        M_w = oracles.random_sets(rng, n, 1)[0]
    model = mixed_model(STEPS, A=A, B=B, C=C, P_w=0.25, M_w=M_w, P_v=0.25, M_v=5.0)
    estimator = mixed(model, STEPS, x0=np.zeros(n), P0=100.0 * np.eye(n), M0=400.0 * np.eye(n), use_y0=False)
    return design(model, STEPS, estimator, horizon=N, Q_x=[10.0, *[1.0] * (n - 1)], R_u=1.0)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_tables_of_100_steps(benchmark, n):
    """What is done once per method, for all runs."""
    with single_thread():
        benchmark.pedantic(lambda made: made.warm_up(), setup=lambda: ((law(n),), {}), rounds=3, warmup_rounds=1)


@pytest.mark.parametrize(("n", "wild"), [(2, False), (3, False), (4, False), (3, True), (4, True)])
def test_30000_solutions(benchmark, n, wild):
    """Three methods' worth of calls in blocks of 50 rows, after the tables have been made; one core."""
    made, rng = law(n, wild), np.random.default_rng(0)
    x = 3.0 * rng.standard_normal((STEPS, BLOCK, n))
    estimates = [Estimate(each, None, None, np.zeros(BLOCK, dtype=np.int8), {}) for each in x]
    state, y, r = made.init(BLOCK), np.zeros((BLOCK, 1)), np.zeros((1, 1))

    def solutions():
        for _ in range(6):
            for k, estimate in enumerate(estimates):
                made.control(k, state, y, estimate, r)

    with single_thread():
        solutions()
        benchmark.pedantic(solutions, rounds=3)


def problem(horizon):
    """One control step of the paper's system, k = 20."""
    stages, M_w = oracles.paper_stages(20, horizon), np.broadcast_to(M_W, (horizon, 2, 2))
    return stages, np.array([[28.0, -9.0], [-9.0, 12.0]]), M_w


@pytest.mark.parametrize("horizon", [5, 10, 20, 100, 1000])
def test_one_exact_solution(benchmark, horizon):
    """The solver without tables, one state; the smallest price, which a table has, is found anew."""
    stages, M, M_w = problem(horizon)
    game, root = game_of(stages, psd_sqrt(M_w)), psd_sqrt(M[None])[0]
    solve(game, root, X)
    benchmark(solve, game, root, X)


@pytest.mark.parametrize("horizon", [5, 10, 20])
def test_one_solution_by_cvxpy_and_clarabel(benchmark, horizon):
    """The semidefinite program as printed, one state."""
    stages, M, M_w = problem(horizon)
    benchmark.pedantic(oracles.semidefinite, args=(stages, M, M_w, X), rounds=3, warmup_rounds=1)


@pytest.mark.parametrize("horizon", [5, 20])
def test_one_solution_by_the_plain_twin(benchmark, horizon):
    """The same recursion in NumPy, by searches."""
    stages, M, M_w = problem(horizon)
    benchmark.pedantic(twin.solve, args=(stages, M, M_w, X), rounds=2)


@pytest.mark.parametrize("horizon", [10, 100])
def test_one_price_per_stage(benchmark, horizon):
    """The tightest certificate, one state."""
    stages, M, M_w = problem(horizon)
    game, root = game_of(stages, psd_sqrt(M_w)), psd_sqrt(M[None])[0]
    solve_stages(game, root, X)
    benchmark.pedantic(solve_stages, args=(game, root, X), rounds=3)
