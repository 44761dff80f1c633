"""Speed of predictive control with tuned penalties; `make perf` prints the table.  Nothing here asserts a time.

The robot of belda2017 has six states, four inputs, three outputs, Np = 10, 800 steps and blocks of 50 runs.
"""

import numpy as np
import pytest
from controllers.gpc_twin import dense, full_lp2
from controllers.test_noise_tuning import windows
from numerics.test_tracking import problems, tracked

from rmpc_bench.controllers.noise_tuning import LpNoise, NoiseTuning
from rmpc_bench.simulation.threads import single_thread

pytestmark = pytest.mark.perf

BLOCK = 50


def test_a_block_by_the_recursion(benchmark):
    """First inputs of 50 runs, another model and weight each."""
    given = problems(np.random.default_rng(0), 6, 4, 3, 10, BLOCK)
    with single_thread():
        tracked(*given)
        benchmark(tracked, *given)


def test_a_block_by_stacked_systems(benchmark):
    """The same by the plain twin: a dense system of 70 rows and 40 columns per run."""
    A, B, f, C, Q_yw, Q_u, w, x = problems(np.random.default_rng(0), 6, 4, 3, 10, BLOCK)

    def solved():
        return [dense(A[i], B[i], f, C, Q_yw[i], Q_u, w, x[i]) for i in range(BLOCK)]

    with single_thread():
        benchmark.pedantic(solved, rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("state_rows", [False, True])
def test_a_block_of_lp2(benchmark, state_rows):
    """Bounds, correlations, covariances and penalties of 50 runs at one sample."""
    window = np.concatenate(windows(np.random.default_rng(0), BLOCK)[: 4 if state_rows else 2], axis=2)
    found, before = NoiseTuning(LpNoise(state_rows=state_rows), 0, 6, 3), np.tile(np.eye(3), (BLOCK, 1, 1))
    with single_thread():
        found.penalties(0, window, before)
        benchmark(found.penalties, 0, window, before)


def test_a_block_of_lp2_by_highs(benchmark):
    """The full program of 27 unknowns and 270 rows, run by run."""
    parts = windows(np.random.default_rng(0), BLOCK)

    def solved():
        return [full_lp2(*(each[i] for each in parts)) for i in range(BLOCK)]

    with single_thread():
        benchmark.pedantic(solved, rounds=2)
