"""Speed of the predictors of souto2011; `pytest -m perf` of this file prints the table.

Nothing here asserts a time.  A row of `make perf` has a script that does the same run by run.
"""

import numpy as np
import pytest

from rmpc_bench.config.load import load_config
from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.choice import serial
from rmpc_bench.engines.tasks import Task
from rmpc_bench.estimators import enhanced_robust, kalman_predictor, lmmse
from rmpc_bench.models import uncertain_linear
from rmpc_bench.simulation.moments import exact_laws, exact_moments
from rmpc_bench.simulation.threads import single_thread

pytestmark = pytest.mark.perf

FIG4 = "configs/souto2011/fig4.yaml"
STEPS = 1500


@pytest.fixture(scope="module")
def experiment():
    """Fig. 4 at its first point: 500 runs, 1500 steps, two predictors."""
    return load_config(FIG4).experiment


@pytest.mark.parametrize("kind", ["error", "state", "tuned", "classic", "lmmse"])
def test_gains_of_1500_steps(benchmark, kind):
    """One design of the benchmark system; halved uncertainty for the rule that refuses it in full."""
    part = load_config(FIG4).methods["ERP"]["model"]
    model = uncertain_linear.design(STEPS, **{name: value for name, value in part.items() if name != "kind"})
    start = {"x0": np.array([2.0, 1.0]), "P0": 0.1 * np.eye(2)}
    designs = {
        "error": lambda: enhanced_robust.design(model, STEPS, **start, eps=0.1),
        "state": lambda: enhanced_robust.design(model, STEPS, **start, rule="state", gamma=1.0, design_scale=0.5),
        "tuned": lambda: enhanced_robust.design(model, STEPS, **start, eps=0.1, tuned=True),
        "classic": lambda: kalman_predictor.design(model, STEPS, **start, R=0.0),
        "lmmse": lambda: lmmse.design(model, STEPS, **start),
    }
    with single_thread():
        benchmark(designs[kind])


def test_500_runs_of_1500_steps_with_two_predictors(benchmark, experiment):
    """Draws, simulation, metrics and ensemble moments, on one core; files and processes not."""
    tasks = [Task(method.name, 0, 500) for method in experiment.methods]
    benchmark.pedantic(lambda: list(serial([experiment], TaskQueue(tasks))), rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("number", [0, 1], ids=["ERP", "classic"])
def test_exact_moments_of_1500_steps(benchmark, experiment, number):
    """Mean and covariance of state and estimate at every k, in place of all runs."""
    plant, method = experiment.plant, experiment.methods[number]
    laws = exact_laws(plant, method, experiment.scenario)
    with single_thread():
        benchmark(lambda: exact_moments(plant, method.estimator.gain_schedule, laws, STEPS))
