"""Ensembles in trials.sqlite: whatever the blocks, the workers and the interruptions, they are those of the runs."""

import sqlite3

import numpy as np
import pytest
from conftest import ROUND
from small_experiment import cli, ran, spied
from uncertain_experiment import PLANT, write_estimation

from rmpc_bench import load_config, load_trials
from rmpc_bench.execution import engines
from rmpc_bench.execution.store import Store
from rmpc_bench.execution.stored_trials import n_complete
from rmpc_bench.simulation.closed_loop import Block
from rmpc_bench.simulation.ensemble import Group
from rmpc_bench.simulation.scenario import Recording
from rmpc_bench.types import Status

N = 130
KEYS = {"runs": N, "evaluate": "[runs, ensemble]", "execution": "{max_failures: 1000}"}
SMALL = 1e-13
"""Absolute, for means and covariances that are zero but for rounding; the states are about 1."""
ENSEMBLE = Recording(ensemble=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return trials.csv and the series of one uninterrupted run in this process."""
    directory = tmp_path_factory.mktemp("whole")
    return ran(write_estimation(directory, **KEYS), directory / "out"), load_trials(directory / "out").series


def assert_series(directory, expected):
    """Every row is the same, numbers to rounding."""
    found = load_trials(directory).series
    assert found.drop(columns="value").equals(expected.drop(columns="value"))
    np.testing.assert_allclose(found["value"], expected["value"], **ROUND, atol=SMALL)


def add(store, runs, groups, method="m"):
    """Store a block with groups of runs, each as (first, stop, n, value)."""
    groups = [
        Group(first, stop, n, np.full((2, 1), value), np.full((2, 1, 1), value)) for first, stop, n, value in groups
    ]
    block = Block(np.full(len(runs), Status.OK, dtype=np.int8), np.zeros((1, len(runs))), {}, groups)
    store.add_block(method, runs, block, {"q": np.zeros(len(runs))}, "d", [{} for _ in runs])


@pytest.mark.parametrize(("block", "jobs"), [(7, 1), (50, 2), (500, 1), (33, 2)])
def test_any_block_and_any_workers(tmp_path, whole, block, jobs):
    """trials.csv by bytes, ensembles to rounding."""
    path = write_estimation(tmp_path, **KEYS | {"execution": f"{{block: {block}}}"})
    assert ran(path, tmp_path / "out", jobs=jobs) == whole[0]
    assert_series(tmp_path / "out", whole[1])


def test_blocks_of_fifty_by_bytes(tmp_path, whole):
    """Groups are whole in every block, so that not even rounding differs."""
    path = write_estimation(tmp_path, **KEYS | {"execution": "{block: 100}"})
    ran(path, tmp_path / "out", jobs=2)
    assert load_trials(tmp_path / "out").series.equals(whole[1])


def test_interrupted_and_resumed_with_other_blocks(tmp_path, whole, monkeypatch):
    """What was stored in blocks of 7 goes on in blocks of 50, and in other blocks again."""
    path, simulate = write_estimation(tmp_path, **KEYS), engines.simulate_block
    for stop, block in ((20, 7), (70, 50), (90, 11)):

        def interrupted(experiment, method, runs, *draws, stop=stop):
            if runs.start >= stop:
                raise KeyboardInterrupt
            return simulate(experiment, method, runs, *draws)

        monkeypatch.setattr(engines, "simulate_block", interrupted)
        command = ("run", path, "-o", tmp_path / "out", "-j", 1, "-s", f"execution.block={block}")
        assert cli(*command).exit_code == 130
    monkeypatch.setattr(engines, "simulate_block", simulate)
    assert ran(path, tmp_path / "out", jobs=2) == whole[0]
    assert_series(tmp_path / "out", whole[1])
    blocks = spied(monkeypatch)
    ran(path, tmp_path / "out", "-s", "execution.block=13")
    assert blocks == []


def test_a_new_metric_with_other_blocks(tmp_path, whole, monkeypatch):
    """It is computed for all runs, in blocks that overlap the stored groups; none of them counts twice."""
    path = write_estimation(tmp_path, **KEYS | {"execution": "{block: 20}"})
    ran(path, tmp_path / "out")
    write_estimation(tmp_path, **KEYS | {"metrics": "[estimation_mse, nees]", "execution": "{block: 70}"})
    ran(path, tmp_path / "out")
    assert_series(tmp_path / "out", whole[1])
    blocks = spied(monkeypatch)
    ran(path, tmp_path / "out")
    assert blocks == []


def test_the_first_runs_of_a_larger_experiment(tmp_path, whole):
    """Fewer runs than are stored: by bytes those of a smaller experiment; a group that goes beyond is left out."""
    small, large = write_estimation(tmp_path, **KEYS | {"runs": 100}), tmp_path / "large"
    expected = ran(small, tmp_path / "small")
    assert whole[0].splitlines()[:101] == expected.splitlines()[:101]
    ran(write_estimation(tmp_path, **KEYS), large)
    assert ran(write_estimation(tmp_path, **KEYS | {"runs": 100}), large) == expected
    assert load_trials(large).series.equals(load_trials(tmp_path / "small").series)


def test_fewer_runs_than_a_group_has(tmp_path):
    """The group is made again for the runs that count, and with more runs once more."""
    path = write_estimation(tmp_path, **KEYS)
    ran(path, tmp_path / "out")
    write_estimation(tmp_path, **KEYS | {"runs": 120})
    expected = ran(path, tmp_path / "fresh")
    assert ran(path, tmp_path / "out") == expected
    assert_series(tmp_path / "out", load_trials(tmp_path / "fresh").series)


def test_failed_runs_are_left_out(tmp_path):
    """Of a plant that runs away where its F is large, about half of the runs count, and their numbers are finite."""
    own = {
        "plant": PLANT.replace("low: -1, high: 1", "low: 0, high: 4.6e18, per: run"),
        "model": "{kind: uncertain-linear, A: 0.5, C: [[1, 0]], W: 1, V: 1}",
        "methods": "{KF: {estimator: {kind: kalman-predictor}}}",
        "noise": "{process: {gaussian: {std: 1}}}",
    }
    path = write_estimation(tmp_path, **KEYS | own)
    ran(path, tmp_path / "out")
    trials = load_trials(tmp_path / "out")
    n = int((trials.frame["status"] == "ok").sum())
    assert 0 < n < N
    ensemble = trials.series[trials.series["quantity"] == "cov(e)"]
    assert set(ensemble["n"]) == {n}
    assert np.isfinite(ensemble["value"]).all()


def test_groups_come_back_bit_for_bit(tmp_path):
    """In the order of the runs; one that goes beyond the wanted number stays out."""
    with Store(tmp_path) as store:
        add(store, range(50, 60), [(50, 60, 9, 0.1 + 0.2)])
        add(store, range(0, 50), [(0, 50, 50, 5e-324)])
        found = store.ensemble("m", 60)
        assert [(group.first, group.stop, group.n) for group in found] == [(0, 50, 50), (50, 60, 9)]
        assert [group.mean[0, 0] for group in found] == [5e-324, 0.1 + 0.2]
        assert found[0].second.shape == (2, 1, 1)
        assert [group.stop for group in store.ensemble("m", 59)] == [50]
        assert store.ensemble("other", 60) == []


def test_overlapping_groups_give_way(tmp_path):
    """The new block's groups take the place of those that they overlap; what these had beside is computed again."""
    with Store(tmp_path) as store:
        add(store, range(0, 7), [(0, 7, 7, 1.0)])
        add(store, range(7, 14), [(7, 14, 7, 2.0)])
        add(store, range(0, 10), [(0, 10, 10, 3.0)])
        assert [(group.first, group.stop) for group in store.ensemble("m", 100)] == [(0, 10)]
        assert store.finished("m", ["q"]) == {*range(14)}
        assert store.finished("m", ["q"], ENSEMBLE) == {*range(10)}


def test_other_methods_keep_their_groups(tmp_path):
    """A block replaces the groups of its own method only."""
    with Store(tmp_path) as store:
        add(store, range(0, 7), [(0, 7, 7, 1.0)], method="a")
        add(store, range(0, 7), [(0, 7, 7, 2.0)], method="b")
        assert [store.ensemble(name, 7)[0].mean[0, 0] for name in "ab"] == [1.0, 2.0]


def test_a_block_without_groups_leaves_those_that_are_there(tmp_path):
    """Runs that are computed again for a metric, without an ensemble, are the same runs."""
    with Store(tmp_path) as store:
        add(store, range(0, 7), [(0, 7, 7, 1.0)])
        add(store, range(0, 7), [])
        assert len(store.ensemble("m", 7)) == 1


def test_a_store_from_before_there_were_ensembles(tmp_path, monkeypatch):
    """The next run adds the table and computes nothing but what is asked for now."""
    path = write_estimation(tmp_path)
    first = ran(path, tmp_path / "out")
    with sqlite3.connect(tmp_path / "out" / "trials.sqlite") as connection:
        connection.execute("DROP TABLE ensemble")
    connection.close()
    blocks = spied(monkeypatch)
    assert ran(path, tmp_path / "out") == first and blocks == []
    write_estimation(tmp_path, evaluate="[runs, ensemble]")
    assert ran(path, tmp_path / "out") == first and len(blocks) == 2


def test_a_missing_group_is_missing(tmp_path):
    """Runs whose group is lost are not complete."""
    path = write_estimation(tmp_path, **KEYS)
    ran(path, tmp_path / "out")
    with sqlite3.connect(tmp_path / "out" / "trials.sqlite") as connection:
        connection.execute("DELETE FROM ensemble WHERE first = 50")
    connection.close()
    assert n_complete(load_config(path), tmp_path / "out") == {"KF": N - 50, "ERP": N - 50}
