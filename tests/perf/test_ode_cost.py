"""Speed of a sample of a differential equation; `pytest -m perf` of this file prints the table.

Nothing here asserts a time.  A row of `make perf` has a block of 50 runs.
"""

import pytest

from perf.solvers import tanks_plant, tanks_sample
from rmpc_bench.plants.ode_stepping import Solver

pytestmark = pytest.mark.perf


def test_one_run_with_10_substeps(benchmark):
    """A run alone, which is filled up to a block of 8."""
    made = tanks_plant(Solver(substeps=10))
    benchmark(made.step, *tanks_sample(made, 1))


@pytest.mark.parametrize("method", ["LSODA", "RK45", "DOP853"])
def test_run_by_run(benchmark, method):
    """10 runs one after the other."""
    made = tanks_plant(Solver(method))
    benchmark.pedantic(made.step, tanks_sample(made, 10), rounds=5)


def test_design(benchmark):
    """Tests of blocks, trial runs and a timed step: what `check` pays for such a plant."""
    benchmark.pedantic(tanks_plant, (Solver(),), rounds=3)
