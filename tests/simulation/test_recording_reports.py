"""Recorded signals that only some methods have: what they report, and the bursts of the noise."""

import numpy as np
import pytest
from simulation.reporting import BURSTS, METHODS, matrix, registered
from small_experiment import arrays_of, ran, spied, write

from rmpc_bench import load_config, load_trials, run
from rmpc_bench.simulation.scenario import Recording
from rmpc_bench.types import ConfigError

ALL = "{runs: 2, signals: [x_hat, Q_yw, r, fallback]}"


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Return a function that loads the small experiment with a method that reports and one that does not."""
    registered(monkeypatch)
    return lambda runs=None, **keys: load_config(write(tmp_path, **{"methods": METHODS, **keys}), runs=runs)


def test_what_a_method_reports(load, tmp_path):
    """Row by row as (runs, samples, n); of the estimator at k = 0..N, of the controller at k = 0..N-1."""
    traces = run(load(record=ALL), directory=tmp_path / "out", jobs=1).trials.traces
    x_hat, signals = traces["R"].signals["x_hat"], traces["R"].signals
    assert {name: array.shape for name, array in signals.items()} == {
        "x_hat": (2, 11, 4),
        "Q_yw": (2, 10, 4),
        "r": (2, 11, 1),
        "fallback": (2, 11, 1),
    }
    np.testing.assert_array_equal(signals["Q_yw"], matrix(x_hat[:, :-1]).reshape(2, 10, 4))
    np.testing.assert_array_equal(signals["r"], x_hat[:, :, :1])
    np.testing.assert_array_equal(signals["fallback"], x_hat[:, :, :1] > 0)
    np.testing.assert_array_equal(traces["R"].r, np.full((11, 1), np.pi / 2))  # the reference, not what is reported
    assert traces["R"].shapes == {"Q_yw": (2, 2), "r": (1,), "fallback": ()}
    assert set(traces["S"].signals) == {"x_hat"} and traces["S"].shapes == {}


@pytest.mark.parametrize("record", [ALL, "{runs: all, signals: [Q_yw]}"])
def test_what_a_method_does_not_report_is_not_missing(load, tmp_path, monkeypatch, record):
    """Nothing is computed again for want of it, and all runs are complete; a method with nothing else has no traces."""
    first = run(load(record=record), directory=tmp_path / "out", jobs=1).trials
    blocks = spied(monkeypatch)
    again = run(load(record=record), directory=tmp_path / "out", jobs=1)
    assert blocks == [] and again.trials.frame.equals(first.frame)
    assert again.n_complete == {"R": 6, "S": 6}
    assert list(again.traces) == (["R", "S"] if "x_hat" in record else ["R"])


def test_a_reported_signal_later(load, tmp_path, monkeypatch):
    """Only the method that has it is computed again."""
    run(load(record="{runs: 2}"), directory=tmp_path / "out", jobs=1)
    blocks = spied(monkeypatch)
    run(load(record="{runs: 2, signals: [y, Q_yw]}"), directory=tmp_path / "out", jobs=1)
    assert blocks == [("R", [0, 1])]


@pytest.mark.parametrize(
    ("signals", "number", "message"),
    [
        ("[y, Q_yv]", 1, "'Q_yv' is not a known signal; did you mean 'Q_yw'?"),
        ("[zeta]", 0, "known: y, u, u_command, x, x_hat, P, r, fallback, Q_yw"),
        ("[secret]", 0, "'secret' is not a known signal"),  # in the info, but nobody has promised it
        ("[y, bursts]", 1, "'bursts' is not a known signal"),  # the noise has none
    ],
)
def test_a_signal_that_nothing_has(load, signals, number, message):
    """A mistake of the file, with the nearest name."""
    with pytest.raises(ConfigError) as caught:
        load(record=f"{{runs: 1, signals: {signals}}}")
    (problem,) = caught.value.problems
    assert problem.path == f"record.signals.{number}" and message in problem.message


def test_a_signal_of_some_points_of_a_sweep(load, tmp_path):
    """It is recorded where it is; there a figure may ask for it."""
    sweep = "{grid: {controller: [{kind: mpc, Hp: 10, Hu: 3, Q: 0.1, R: 0.1}, {kind: reporting}]}}"
    keys = {"methods": "{S: {estimator: {kind: kalman}}}", "sweep": sweep}
    config = load(record="{runs: 1, signals: [y, Q_yw]}", figures="[{kind: elements, signal: Q_yw}]", **keys)
    first, second = run(config, directory=tmp_path / "out", jobs=1).trials.points
    assert (set(first.traces["S"].signals), set(second.traces["S"].signals)) == ({"y"}, {"y", "Q_yw"})


def test_the_file_of_traces_has_both(load, tmp_path):
    """A reported signal does not take the place of the reference."""
    load(record=ALL)
    ran(tmp_path / "tiny.yaml", tmp_path / "out")
    file, traces = arrays_of(tmp_path / "out" / "traces.npz"), load_trials(tmp_path / "out").traces["R"]
    np.testing.assert_array_equal(file["R/r"], traces.r)
    np.testing.assert_array_equal(file["R/r_reported"], traces.signals["r"])
    np.testing.assert_array_equal(file["R/Q_yw"], traces.signals["Q_yw"])


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"record": "{runs: 1}"}, Recording(("y", "u", "bursts"), 1)),
        ({"record": "{runs: 1, signals: [bursts, x]}"}, Recording(("x", "bursts"), 1)),
        ({"record": "{runs: none}"}, Recording(("y", "u"), 0)),
        ({"record": "{runs: 1}", "noise": "none"}, Recording(("y", "u"), 1)),
    ],
)
def test_bursts_come_along(load, keys, expected):
    """Where there are some and anything is recorded; the configuration says what the user has written."""
    config = load(**{"noise": BURSTS, **keys})
    assert config.experiment.recording == expected
    assert "bursts" not in config.resolved["record"]["signals"] or "bursts" in keys["record"]


def test_recorded_bursts(load, tmp_path):
    """1 from the first to the last sample of the burst, for every method."""
    trials = run(load(noise=BURSTS, record="{runs: 2}"), directory=tmp_path / "out", jobs=1).trials
    expected = np.isin(np.arange(11), [3, 4, 5]).astype(float)
    for traces in trials.traces.values():
        np.testing.assert_array_equal(traces.signals["bursts"], np.tile(expected[:, None], (2, 1, 1)))


def test_figures_of_what_is_recorded(load, tmp_path):
    """From the configuration to the pictures; the method that reports nothing is left out of its matrix."""
    figures = "[{kind: signals, signals: [e, Q_yw.1, bursts]}, {kind: elements, signal: Q_yw, run: 1}]"
    load(noise=BURSTS, record="{runs: 2, signals: [y, Q_yw]}", figures=figures)
    ran(tmp_path / "tiny.yaml", tmp_path / "out")
    names = {path.name for path in (tmp_path / "out" / "figures").iterdir()}
    assert names >= {f"{kind}.{ending}" for kind in ("signals", "elements") for ending in ("svg", "pdf")}
