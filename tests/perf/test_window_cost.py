"""Speed of LP1 and of whole loops of belda2017; `make perf` prints the table.  Nothing here asserts a time."""

import numpy as np
import pytest
from numerics import lp_twin
from numerics.test_bounded_window import data, integrators

from rmpc_bench.config.load import load_config
from rmpc_bench.numerics.bounded_window import fit_anchored, fit_free
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.simulation.threads import single_thread

pytestmark = pytest.mark.perf

BLOCK = 50


@pytest.mark.parametrize("points", [4, 9])
def test_a_block_of_free_windows(benchmark, points):
    """LP1 of 50 runs at one sample: Ne = 3 needs no linear program, Ne = 8 mostly does."""
    window, C = integrators(np.random.default_rng(0), BLOCK, points)
    with single_thread():
        fit_free(window, C, points)
        benchmark(fit_free, window, C, points)


def test_a_block_of_anchored_windows(benchmark):
    """The anchored program of 50 runs, each solved twice."""
    window, C = integrators(np.random.default_rng(0), BLOCK, 4)
    with single_thread():
        benchmark.pedantic(fit_anchored, (window, C, 4), rounds=3, warmup_rounds=1)


def test_a_block_of_free_windows_by_scipy(benchmark):
    """The full program of 33 unknowns and 60 rows, run by run."""
    window, C = integrators(np.random.default_rng(0), BLOCK, 4)
    programs = [data(window, C, i, 4) for i in range(BLOCK)]
    with single_thread():
        benchmark.pedantic(lambda: [lp_twin.solve(each) for each in programs], rounds=3, warmup_rounds=1)


@pytest.mark.parametrize("method", ["constant", "tuned", "short"])
def test_a_block_of_loops(benchmark, method):
    """50 runs x 800 samples on one core, draws and metrics included; `short` without the state rows of LP2."""
    experiment = load_config("configs/belda2017/exp2.yaml").experiment
    pair = experiment.method(method)
    with single_thread():
        simulate_block(experiment, pair, range(2))
        benchmark.pedantic(simulate_block, (experiment, pair, range(BLOCK)), rounds=2)
