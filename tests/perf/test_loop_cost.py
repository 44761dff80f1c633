"""Closed loops on one core: the compiled simulation of a period beside the simulation step by step, and the draws.

The rows are ratios in one session; nothing here asserts a time.  CPU time, so that other programs matter little.
"""

from time import process_time

import numpy as np
import pytest

from rmpc_bench.config.load import load_config
from rmpc_bench.simulation import closed_loop
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.simulation.random_streams import first_uniforms, generators, stream
from rmpc_bench.simulation.threads import single_thread

pytestmark = [pytest.mark.perf, pytest.mark.benchmark(timer=process_time)]

CONFIGURATIONS = ["zenere2018/fig7", "zenere2018/sim1", "benchmarks/wang2021"]
RUNS = range(200)


@pytest.mark.parametrize("way", ["compiled", "step by step"])
@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_closed_loops(benchmark, monkeypatch, name, way):
    """A block of 200 runs of all methods, with draws and metrics."""
    experiment = load_config(f"configs/{name}.yaml").experiment
    if way == "step by step":
        monkeypatch.setattr(closed_loop, "applies", lambda experiment, method: False)

    def simulate_all():
        with single_thread():
            draws = experiment.scenario.draw(experiment.plant, RUNS, experiment.n_steps)
            return [simulate_block(experiment, method, RUNS, draws) for method in experiment.methods]

    simulate_all()
    blocks = benchmark.pedantic(simulate_all, rounds=3)
    assert all(block.metrics.shape[1] == len(RUNS) for block in blocks)


@pytest.mark.parametrize("way", ["at once", "run by run"])
def test_first_numbers_of_streams(benchmark, way):
    """One uncertain quantity of 10,000 runs."""
    ways = {
        "at once": lambda: first_uniforms(1, range(10_000), "uncertainty/eps"),
        "run by run": lambda: [stream(1, run, "uncertainty/eps").random() for run in range(10_000)],
    }
    assert np.shape(benchmark.pedantic(ways[way], rounds=3)) == (10_000,)


@pytest.mark.parametrize("way", ["at once", "run by run"])
def test_generators_of_streams(benchmark, way):
    """One noise of 10,000 runs."""
    ways = {
        "at once": lambda: generators(1, range(10_000), "v/0"),
        "run by run": lambda: (stream(1, run, "v/0") for run in range(10_000)),
    }
    assert benchmark.pedantic(lambda: sum(1 for _ in ways[way]()), rounds=3) == 10_000


@pytest.mark.parametrize("runs", [200, 5000])
def test_draws_of_fig7(benchmark, runs):
    """Named quantities, parameters and coefficients of the plant."""
    experiment = load_config("configs/zenere2018/fig7.yaml").experiment
    draw = experiment.scenario.draw
    found = benchmark.pedantic(lambda: draw(experiment.plant, range(runs), experiment.n_steps), rounds=3)
    assert len(found.x0) == runs
