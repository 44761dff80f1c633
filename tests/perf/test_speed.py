"""Speed of what a user waits for; `make perf` prints the table.  Nothing here asserts a time."""

import subprocess
import sys

import numpy as np
import pytest
from plants import servo_twin

from rmpc_bench.config.load import load_config
from rmpc_bench.estimators import kalman, risk_sensitive, robust_kalman
from rmpc_bench.execution.results import run
from rmpc_bench.models.servo import ServoNoise
from rmpc_bench.models.servo import design as servo_model
from rmpc_bench.plants import servo
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.simulation.threads import single_thread

pytestmark = pytest.mark.perf

FIG7 = "configs/zenere2018/fig7.yaml"
BLOCK = 50


def block():
    """Arguments of one sample of a block: states on the move, a voltage, and the coefficients of the runs."""
    plant = servo.design(0.1)
    delta = plant.draw({name: np.full(BLOCK, value) for name, value in plant.nominal.items()}, [], 1)
    x = np.random.default_rng(1).standard_normal((BLOCK, 5)) * [1.0, 1.0, 0.0, 20.0, 1.0]
    x[:, 2] = 20.0 * x[:, 0]
    return plant, delta, x, np.full((BLOCK, 1), 50.0)


def test_servo_sample_compiled(benchmark):
    """One sample of 50 runs by the compiled kernel."""
    plant, delta, x, u = block()
    no_noise = np.zeros((BLOCK, 4))
    benchmark(plant.step, 0, delta, x, u, no_noise)


def test_servo_sample_plain(benchmark):
    """The same by its plain twin, run after run; numba has to beat it by a factor of three."""
    plant, delta, x, u = block()
    end = benchmark.pedantic(
        lambda: [servo_twin.step(plant.nominal, *row) for row in zip(x, u[:, 0], strict=True)], rounds=2
    )
    np.testing.assert_allclose(end, plant.step(0, delta, x, u, np.zeros((BLOCK, 4))).x, rtol=1e-9, atol=1e-9)


def test_fig7_simulated_on_one_core(benchmark):
    """200 runs x 4 methods x 200 samples, draws and metrics included, files and processes not."""
    experiment = load_config(FIG7).experiment
    experiment.plant.warm_up()
    blocks = [range(first, first + BLOCK) for first in range(0, experiment.n_runs, BLOCK)]

    def simulate_all():
        with single_thread():
            return [simulate_block(experiment, method, runs) for method in experiment.methods for runs in blocks]

    assert len(benchmark.pedantic(simulate_all, rounds=3)) == 16


@pytest.mark.parametrize("kind", ["kalman", "robust-kalman", "risk-sensitive"])
def test_gain_schedule(benchmark, kind):
    """Gains of 200 steps for the servomechanism."""
    model = servo_model(0.1, noise=ServoNoise(process=1.0, measurement=1.0))
    start = {"x0": np.zeros(4), "P0": model.Q_w}
    designs = {
        "kalman": lambda: kalman.design(model, 200, **start),
        "robust-kalman": lambda: robust_kalman.design(model, 200, **start, c=0.1),
        "risk-sensitive": lambda: risk_sensitive.design(model, 200, **start, theta=0.00245384),
    }
    benchmark(designs[kind])


@pytest.mark.parametrize("workers", [1, 2])
def test_workers(benchmark, tmp_path, workers):
    """8000 runs of Fig. 7, stored; two workers against one."""
    config = load_config(FIG7, runs=8000)
    directories = (tmp_path / str(number) for number in range(10))
    benchmark.pedantic(lambda: run(config, directory=next(directories), jobs=workers), rounds=1)


@pytest.mark.parametrize("arguments", [["--help"], ["check", FIG7]], ids=["help", "check"])
def test_command(benchmark, arguments):
    """Wall time of a command, the start of Python included."""
    command = [sys.executable, "-c", "from rmpc_bench.cli import main; main()", *arguments]
    benchmark.pedantic(subprocess.run, (command,), {"check": True, "capture_output": True}, rounds=5)


def test_fig7_command(benchmark, tmp_path):
    """The whole of `rmpc-bench run configs/zenere2018/fig7.yaml`, warm, with two workers, files and figures."""
    numbers = iter(range(10))

    def command():
        arguments = ["run", FIG7, "-o", str(tmp_path / str(next(numbers))), "--progress", "none"]
        code = "from rmpc_bench.cli import main; main()"
        subprocess.run([sys.executable, "-c", code, *arguments], check=True, capture_output=True)

    benchmark.pedantic(command, rounds=3)
