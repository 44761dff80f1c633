"""Speed of a sample of a differential equation; `pytest -m perf` of this file prints the table.

Nothing here asserts a time.
"""

import numpy as np
import pytest
from plants import tanks

from rmpc_bench.plants.ode import design
from rmpc_bench.plants.ode_stepping import Solver

pytestmark = pytest.mark.perf

BLOCK = 50


def plant(solver):
    """Return two tanks as a plant."""
    bounds = {"h1": (1e-4, 0.6), "h2": (1e-4, 0.6), "pump": (0.0, 30.0)}
    return design(5.0, 200, ode=tanks.rhs, output=tanks.output, states=tanks.STATES, inputs=tanks.INPUTS,
                  outputs=tanks.OUTPUTS, parameters=tanks.PARAMETERS, bounds=bounds, solver=solver,
                  x0=tanks.steady_state(8.0, tanks.PARAMETERS))  # fmt: skip


def sample(made, n_runs):
    """Arguments of a step of a block."""
    rng = np.random.default_rng(5)
    delta = made.draw({name: np.full(n_runs, value) for name, value in made.nominal.items()}, [], 1)
    x, u = rng.uniform(0.05, 0.5, (n_runs, 2)), rng.uniform(0.0, 30.0, (n_runs, 1))
    return 0, delta, x, u, np.zeros((n_runs, 2))


def test_block_of_50_runs_with_10_substeps(benchmark):
    """50 runs at once."""
    made = plant(Solver(substeps=10))
    benchmark(made.step, *sample(made, BLOCK))


def test_one_run_with_10_substeps(benchmark):
    """A run alone, which is filled up to a block of 8."""
    made = plant(Solver(substeps=10))
    benchmark(made.step, *sample(made, 1))


@pytest.mark.parametrize("method", ["LSODA", "RK45", "DOP853"])
def test_run_by_run(benchmark, method):
    """10 runs one after the other."""
    made = plant(Solver(method))
    benchmark.pedantic(made.step, sample(made, 10), rounds=5)


def test_design(benchmark):
    """Tests of blocks, trial runs and a timed step: what `check` pays for such a plant."""
    benchmark.pedantic(plant, (Solver(),), rounds=3)
