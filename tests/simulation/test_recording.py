"""Recorded runs: which, what of them, and that they are what was simulated."""

import zipfile
from dataclasses import replace

import numpy as np
import pytest
from small_experiment import arrays_of, cli, ran, spied, write

from rmpc_bench import load_config, load_trials, run, simulate
from rmpc_bench.simulation.closed_loop import _signal, simulate_block
from rmpc_bench.simulation.scenario import Recording
from rmpc_bench.types import ConfigError, Plant, Record

SIGNALS = ("y", "u", "x", "x_hat")
EVERY = "{runs: all, signals: [y, u, x, x_hat]}"
SWEEP = "{grid: {controller.Hp: [10, 12]}}"


@pytest.fixture
def load(tmp_path):
    """Return a function that loads the small experiment with some keys replaced."""
    return lambda runs=None, **keys: load_config(write(tmp_path, **keys), runs=runs)


def alone(experiment, name, i):
    """Trajectories of one run of one method, simulated by itself."""
    method, n_steps = experiment.method(name), experiment.n_steps
    draws = experiment.scenario.draw(experiment.plant, range(i, i + 1), n_steps)
    r = experiment.scenario.reference.sample(n_steps + 1 + method.controller.preview)
    return simulate(experiment.plant, method, draws, r, n_steps)[0]


@pytest.mark.parametrize(
    ("record", "expected"),
    [
        (None, Recording(("y", "u"), 0)),
        ("{runs: none}", Recording(("y", "u"), 0)),
        ("{runs: all}", Recording(("y", "u"), 6)),
        ("{runs: 2}", Recording(("y", "u"), 2)),
        ("{runs: 60, signals: [x, x_hat, x]}", Recording(("x", "x_hat"), 6)),
        ("{signals: [u]}", Recording(("u",), 0)),
    ],
)
def test_what_is_to_be_recorded(load, record, expected):
    """Of none, of the first N as far as there are as many, or of all; the output and the input unless told."""
    assert load(record=record).experiment.recording == expected


@pytest.mark.parametrize(
    ("record", "path"),
    [
        ("{runs: 0}", "record.runs"),
        ("{runs: some}", "record.runs"),
        ("{runs: 1.5}", "record.runs"),
        ("{signals: [y, z]}", "record.signals.1"),
        ("{runs: all, signals: []}", "record.signals"),
        ("{run: all}", "record.run"),
        ("all", "record"),
    ],
)
def test_what_cannot_be_recorded(load, record, path):
    """Unknown words, no run, no signal: at the place of the mistake."""
    with pytest.raises(ConfigError) as caught:
        load(record=record)
    assert [problem.path for problem in caught.value.problems] == [path]


def test_a_block_keeps_its_part_of_the_first_runs(load):
    """Oracle: the trajectories of every run simulated by itself."""
    experiment = replace(load().experiment, recording=Recording(SIGNALS, 4))
    for runs, kept in ((range(3), 3), (range(3, 6), 1), (range(4, 6), 0)):
        traces = simulate_block(experiment, experiment.method("R-MPC"), runs).traces
        assert set(traces) == (set(SIGNALS) if kept else set())
        for name, array in traces.items():
            expected = [getattr(alone(experiment, "R-MPC", i), name)[0] for i in runs[:kept]]
            np.testing.assert_array_equal(array, expected)


def test_traces_of_the_table(load, tmp_path):
    """Every signal of every recorded run as simulated, with the reference and the sampling time."""
    config = load(record="{runs: 2, signals: [y, u, x, x_hat]}")
    trials = run(config, directory=tmp_path / "out", jobs=1).trials
    assert [*trials.traces] == ["S-MPC", "R-MPC"]
    for name, traces in trials.traces.items():
        assert traces.runs.tolist() == [0, 1]
        np.testing.assert_array_equal(traces.r, np.full((11, 1), np.pi / 2))
        shapes = {"y": (2, 11, 1), "u": (2, 10, 1), "x": (2, 11, 4), "x_hat": (2, 11, 4)}
        assert {signal: array.shape for signal, array in traces.signals.items()} == shapes
        for i in (0, 1):
            record = alone(config.experiment, name, i)
            for signal, array in traces.signals.items():
                np.testing.assert_array_equal(array[i], getattr(record, signal)[0])
    assert run(load(), directory=tmp_path / "out", jobs=1).trials.traces == {}


def test_metrics_belong_to_the_traces(load, tmp_path):
    """Oracle: the mean square error and the mean square input of what was recorded."""
    trials = run(load(record="{runs: all}"), directory=tmp_path / "out", jobs=1).trials
    traces = trials.traces["S-MPC"]
    mse = ((traces.signals["y"] - traces.r)[:, :-1] ** 2).mean(axis=(1, 2))
    np.testing.assert_allclose(trials.column("mse", "S-MPC"), mse, rtol=1e-12)
    power = (traces.signals["u"] ** 2).mean(axis=(1, 2))
    np.testing.assert_allclose(trials.column("input_power", "S-MPC"), power, rtol=1e-12)


def test_recording_more_computes_what_is_missing(load, tmp_path, monkeypatch):
    """Runs or signals that were not recorded; the metrics stay, bit for bit, and less costs nothing."""
    out, blocks = tmp_path / "out", spied(monkeypatch)

    def computed(record):
        blocks.clear()
        trials = run(load(record=record), directory=out, jobs=1).trials
        return sorted(blocks), trials

    (_, plain), (again, recorded) = computed(None), computed("{runs: 2}")
    assert again == [("R-MPC", [0, 1]), ("S-MPC", [0, 1])] and recorded.frame.equals(plain.frame)
    assert computed("{runs: 5}")[0] == [("R-MPC", [2, 3, 4]), ("S-MPC", [2, 3, 4])]
    assert computed("{runs: 3}")[0] == []
    again, recorded = computed("{runs: 3, signals: [y, x]}")
    assert again == [("R-MPC", [0, 1, 2]), ("S-MPC", [0, 1, 2])]
    again, recorded = computed("{runs: all}")
    assert again == [("R-MPC", [5]), ("S-MPC", [5])] and recorded.frame.equals(plain.frame)
    fresh = run(load(record="{runs: all}"), directory=tmp_path / "fresh", jobs=1).trials
    for name in ("S-MPC", "R-MPC"):
        assert recorded.traces[name].runs.tolist() == [*range(6)]
        np.testing.assert_array_equal(recorded.traces[name].signals["u"], fresh.traces[name].signals["u"])


def test_fewer_runs_than_are_recorded(load, tmp_path):
    """Show fewer."""
    keys = {"record": "{runs: 5}"}
    run(load(**keys), directory=tmp_path / "out", jobs=1)
    assert run(load(runs=2, **keys), directory=tmp_path / "out", jobs=1).trials.traces["S-MPC"].runs.tolist() == [0, 1]


def test_a_failed_run_is_recorded_too(load, tmp_path):
    """It has no values but a trajectory, which stands still from its failure on."""
    keys = {"uncertainty": "{eps: +-150%}", "record": EVERY, "runs": 12}
    trials = run(load(**keys), directory=tmp_path / "out", jobs=1).trials
    failed = np.isnan(trials.column("mse", "S-MPC"))
    traces = trials.traces["S-MPC"]
    assert 0 < failed.sum() < 12 and traces.runs.tolist() == [*range(12)]
    moving = (traces.signals["x"] != traces.signals["x"][:, :1]).any(axis=(1, 2))
    np.testing.assert_array_equal(moving, ~failed)


def test_the_file_of_traces(tmp_path):
    """Every recorded array under its method, with its runs, times and reference: what the table has."""
    ran(write(tmp_path, record="{runs: 3, signals: [u, x]}"), tmp_path / "out")
    file, trials = arrays_of(tmp_path / "out" / "traces.npz"), load_trials(tmp_path / "out")
    assert {*file} == {f"{m}/{part}" for m in ("S-MPC", "R-MPC") for part in ("u", "x", "runs", "r", "t")}
    for name, traces in trials.traces.items():
        np.testing.assert_array_equal(file[f"{name}/runs"], [0, 1, 2])
        assert file[f"{name}/t"].tolist() == [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
        np.testing.assert_array_equal(file[f"{name}/r"], traces.r)
        for signal in ("u", "x"):
            np.testing.assert_array_equal(file[f"{name}/{signal}"], traces.signals[signal])


def test_the_file_of_traces_of_a_sweep(tmp_path):
    """Every point by its name; the same bytes at any time, and no file of an earlier configuration."""
    out = tmp_path / "out"
    ran(write(tmp_path, record="{runs: 1}", sweep=SWEEP), out)
    file, trials = arrays_of(out / "traces.npz"), load_trials(out)
    assert len({*file}) == 2 * 2 * 5
    for point in trials.points:
        for name, traces in point.traces.items():
            np.testing.assert_array_equal(file[f"{point.title}/{name}/y"], traces.signals["y"])
    times = {entry.date_time for entry in zipfile.ZipFile(out / "traces.npz").infolist()}
    assert times == {(1980, 1, 1, 0, 0, 0)}
    ran(write(tmp_path, sweep=SWEEP), out)
    assert not (out / "traces.npz").exists()


def test_a_smoke_run_records_its_own_size(tmp_path):
    """As many runs and samples as it has; report writes the same file again."""
    keys = {"record": "{runs: 5}", "smoke": "{runs: 2, steps: 4}", "sweep": SWEEP}
    ran(write(tmp_path, **keys), tmp_path / "out", "--smoke")
    file = tmp_path / "out" / "traces.npz"
    assert arrays_of(file)["controller.Hp=12/R-MPC/y"].shape == (2, 5, 1)
    before = file.read_bytes()
    file.unlink()
    assert cli("report", tmp_path / "out").exit_code == 0
    assert file.read_bytes() == before


def test_the_reported_covariance_of_every_run(load, tmp_path):
    """Recorded row by row, as the estimator reports it; it is stored, and nothing is computed again."""
    config = load(record="{runs: 2, signals: [x, x_hat, P]}")
    results = run(config, directory=tmp_path / "out", jobs=1)
    for name, traces in results.traces.items():
        P = results.trials.matrix_series("P", name)
        nx = P.shape[1]
        assert traces.shapes["P"] == (nx, nx) and traces.signals["P"].shape[0] == 2
        for row in traces.signals["P"]:
            np.testing.assert_array_equal(row.reshape(-1, nx, nx), np.broadcast_to(P, (len(row), nx, nx)))
    assert load_trials(tmp_path / "out").traces.keys() == results.traces.keys()


def test_a_method_without_a_covariance_records_nan():
    """One of every run is kept as it is; NaN stands for none, so that the runs count as complete."""
    record = Record.of_run(x=[0.0, 1.0, 2.0], x_hat=[0.0, 1.0, 2.0])
    plant = Plant()
    assert _signal(record, "P", plant).shape == (1, 3, 1) and np.isnan(_signal(record, "P", plant)).all()
    own = np.arange(3.0).reshape(1, 3, 1, 1)
    np.testing.assert_array_equal(_signal(record._replace(P=own), "P", plant), own[:, :, 0])
    # What a method reports itself under this name comes first.
    assert _signal(record._replace(info={"P": own[:, :, 0] + 7}), "P", plant)[0, 0, 0] == 7
