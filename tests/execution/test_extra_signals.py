"""Extra signals of a plant from the configuration to records, figures and replayed runs."""

import numpy as np
import pytest

import rmpc_bench
from rmpc_bench import load_config
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.types import ConfigError

SMALL = [
    "time={step: 0.1, duration: 2}",
    "record={runs: 2, signals: [x, shaft_torque, motor_torque]}",
    "metrics=[mse, {kind: largest, of: shaft_torque, between: 2}]",
    "statistics={primary: mse, baseline: S-MPC}",
    "claims=[]",
    "figures=[{kind: signals, signals: [shaft_torque]}]",
]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return a small run of the perturbed servomechanism."""
    config = load_config("configs/zenere2018/fig7.yaml", overrides=SMALL, runs=3)
    return rmpc_bench.run(config, directory=tmp_path_factory.mktemp("signals"), jobs=1)


@pytest.mark.long
def test_recorded_torque(results):
    """Oracle: the recorded states with the drawn rigidity and gear ratio of the run, from their random factor."""
    table = results.trials
    eps = table.uncertainty.set_index("run")["eps_min"]
    for traces in table.traces.values():
        x = traces.signals["x"]
        for row, run in enumerate(traces.runs):
            k_theta, rho = 1280.2 * (1 + eps[run]), 20.0 * (1 + eps[run])
            expected = k_theta * (x[row, :, 2] / rho - x[row, :, 0])
            np.testing.assert_allclose(traces.signals["shaft_torque"][row, :, 0], expected, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(traces.signals["motor_torque"][row, :, 0], expected / rho, rtol=1e-9, atol=1e-9)
    assert table.units["shaft_torque"] == "N m"


def test_figure_of_the_torque(results):
    """Oracle: the name with a blank, and the unit."""
    figure = rmpc_bench.figure(results, "signals", signals=["shaft_torque"])
    assert figure.axes[0].get_ylabel() == "shaft torque [N m]"


def test_replayed_run_has_the_torque(results):
    """Oracle: the stored metric, and the recorded signal."""
    again = rmpc_bench.replay(results.directory, 1, "R-MPC1")
    assert again.differing == {} and again.units["shaft_torque"] == "N m"
    recorded = results.trials.traces["R-MPC1"].signals["shaft_torque"][1]
    np.testing.assert_allclose(again.signals["shaft_torque"], recorded, rtol=1e-9, atol=1e-9)
    assert "shaft_torque" in again.to_frame().columns


def test_compiled_and_stepwise_simulation_agree(monkeypatch):
    """Oracle: the simulation step by step, bit for bit, also between the samples."""
    config = load_config("configs/zenere2018/fig7.yaml", overrides=SMALL, runs=3)
    experiment = config.experiment
    method, found = experiment.method("S-MPC"), []
    for compiled in (True, False):
        monkeypatch.setattr("rmpc_bench.simulation.closed_loop.applies", lambda *_, now=compiled: now)
        block = simulate_block(experiment, method, range(3))
        found.append([block.metrics, *(block.traces[name] for name in ("shaft_torque", "motor_torque"))])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_blocks_do_not_matter():
    """Oracle: the runs of a block have the same bits alone."""
    experiment = load_config("configs/zenere2018/fig7.yaml", overrides=SMALL, runs=3).experiment
    method = experiment.method("S-MPC")
    together = simulate_block(experiment, method, range(3)).metrics
    for run in range(3):
        np.testing.assert_array_equal(
            simulate_block(experiment, method, range(run, run + 1)).metrics[:, 0], together[:, run]
        )


def test_unknown_signal_to_record():
    """Oracle: the nearest name."""
    wrong = [*SMALL, "record={runs: 2, signals: [shaft_torqe]}", "figures=[]"]
    with pytest.raises(ConfigError, match="'shaft_torqe' is not a known signal; did you mean 'shaft_torque'"):
        load_config("configs/zenere2018/fig7.yaml", overrides=wrong, runs=3)
