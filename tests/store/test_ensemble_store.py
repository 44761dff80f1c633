"""Ensembles in trials.sqlite: whatever the blocks, the workers and the interruptions, they are those of the runs."""

import signal
import sqlite3

import numpy as np
import pytest
from small_experiment import cli, ran, spied
from uncertain_experiment import PLANT, write_estimation

from rmpc_bench import load_results, load_trials
from rmpc_bench.engines import tasks
from rmpc_bench.simulation.closed_loop import Block
from rmpc_bench.simulation.ensemble import SIZE, Group, groups
from rmpc_bench.simulation.scenario import Recording
from rmpc_bench.store.store import Store
from rmpc_bench.types import Journal, Status

N = 130
KEYS = {"runs": N, "evaluate": "[runs, ensemble]", "execution": "{max_failures: 1000}"}
ENSEMBLE = Recording(ensemble=True)


FILES = ("trials.csv", "series.csv")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return trials.csv and series.csv of one uninterrupted run in this process."""
    directory = tmp_path_factory.mktemp("whole")
    ran(write_estimation(directory, **KEYS), directory / "out")
    return files(directory / "out")


def files(directory):
    """Return trials.csv and series.csv of a directory."""
    return [(directory / name).read_bytes() for name in FILES]


def filled(path, directory, *options, jobs=1):
    """Run, and return trials.csv and series.csv."""
    ran(path, directory, *options, jobs=jobs)
    return files(directory)


def single(run, value, n=1, samples=2):
    """Return a group of one run."""
    return Group(run, run + 1, n, np.full((samples, 1), value * n), np.empty((0, 1, 1)))


def group(first, value=1.0):
    """Return a whole group."""
    return Group(first, first + SIZE, SIZE, np.full((2, 1), value), np.full((2, 1, 1), value))


def add(store, runs, groups, method="m", status=Status.OK):
    """Store a block with groups of runs."""
    block = Block(np.full(len(runs), status, dtype=np.int8), np.zeros((1, len(runs))), {}, groups, Journal())
    store.add_block(method, runs, block, {"q": np.zeros(len(runs))}, "d", [{} for _ in runs])


def spans(store, n_runs):
    """Return (first, stop) of what is stored of the ensemble."""
    return [(part.first, part.stop) for part in store.ensemble("m", n_runs)]


@pytest.mark.parametrize(("block", "jobs"), [(1, 1), (7, 1), (50, 2), (64, 2), (500, 1), (33, 2), (100, 2)])
def test_any_block_and_any_workers(tmp_path, whole, block, jobs):
    """The same bytes in trials.csv and series.csv."""
    path = write_estimation(tmp_path, **KEYS | {"execution": f"{{block: {block}}}"})
    assert filled(path, tmp_path / "out", jobs=jobs) == whole


def test_interrupted_and_resumed_with_other_blocks(tmp_path, whole, monkeypatch):
    """What was stored in blocks of 7 goes on in blocks of 50, and in other blocks again."""
    path, simulate = write_estimation(tmp_path, **KEYS), tasks.simulate_block
    for stop, block in ((20, 7), (70, 50), (90, 11)):

        def interrupted(experiment, method, runs, *draws, stop=stop):
            if runs.start >= stop:
                signal.raise_signal(signal.SIGINT)
            return simulate(experiment, method, runs, *draws)

        monkeypatch.setattr(tasks, "simulate_block", interrupted)
        command = ("run", path, "-o", tmp_path / "out", "-j", 1, "-s", f"execution.block={block}")
        assert cli(*command).exit_code == 130
    monkeypatch.setattr(tasks, "simulate_block", simulate)
    assert filled(path, tmp_path / "out", jobs=2) == whole
    blocks = spied(monkeypatch)
    ran(path, tmp_path / "out", "-s", "execution.block=13")
    assert blocks == []


@pytest.mark.parametrize("block", [7, 50])
def test_more_runs_later(tmp_path, whole, monkeypatch, block):
    """Only the new runs are computed, and the files are those of all runs at once."""
    path = write_estimation(tmp_path, **KEYS | {"execution": f"{{block: {block}}}"})
    for n_runs in (23, 60, 110):
        ran(path, tmp_path / "out", "--runs", n_runs)
    blocks = spied(monkeypatch)
    assert filled(path, tmp_path / "out") == whole
    assert sorted({run for _, runs in blocks for run in runs}) == [*range(110, N)]


def test_a_new_metric_with_other_blocks(tmp_path, whole, monkeypatch):
    """It is computed for all runs, in blocks that overlap the stored groups; none of them counts twice."""
    path = write_estimation(tmp_path, **KEYS | {"execution": "{block: 20}"})
    ran(path, tmp_path / "out")
    write_estimation(tmp_path, **KEYS | {"metrics": "[estimation_mse, nees]", "execution": "{block: 70}"})
    ran(path, tmp_path / "out")
    assert (tmp_path / "out" / "series.csv").read_bytes() == whole[1]
    blocks = spied(monkeypatch)
    ran(path, tmp_path / "out")
    assert blocks == []


def test_the_first_runs_of_a_larger_experiment(tmp_path, whole, monkeypatch):
    """Fewer runs than are stored: by bytes those of a smaller experiment; a group that goes beyond is left out."""
    small, large = write_estimation(tmp_path, **KEYS | {"runs": 100}), tmp_path / "large"
    expected = filled(small, tmp_path / "small")
    assert whole[0].splitlines()[:101] == expected[0].splitlines()[:101]
    ran(write_estimation(tmp_path, **KEYS), large)
    blocks = spied(monkeypatch)
    assert filled(write_estimation(tmp_path, **KEYS | {"runs": 100}), large) == expected
    assert blocks == []


def test_fewer_runs_than_a_group_has(tmp_path, whole, monkeypatch):
    """Runs of a group that is whole are computed again for a part of it; the whole one stays."""
    path = write_estimation(tmp_path, **KEYS | {"runs": 150})
    large = filled(path, tmp_path / "out")
    assert filled(path, tmp_path / "out", "--runs", N) == whole
    blocks = spied(monkeypatch)
    assert filled(path, tmp_path / "out", "--runs", N) == whole
    assert filled(path, tmp_path / "out") == large
    assert blocks == []


def test_failed_runs_are_left_out(tmp_path):
    """A plant diverges where its F is large: about half of the runs count, and their numbers are finite."""
    own = {
        "plant": PLANT.replace("low: -1, high: 1", "low: 0, high: 500, per: run"),
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
        add(store, range(50, 60), [single(run, 0.1 + 0.2) for run in range(50, 60)])
        add(store, range(0, 50), [group(0, 5e-324)])
        found = store.ensemble("m", 60)
        assert [(part.first, part.stop, part.n) for part in found[:2]] == [(0, 50, 50), (50, 51, 1)]
        assert [part.mean[0, 0] for part in found[:2]] == [5e-324, 0.1 + 0.2]
        assert (found[0].second.shape, found[1].second.shape) == ((2, 1, 1), (0, 1, 1))
        assert spans(store, 59)[-1] == (58, 59)
        assert store.ensemble("other", 60) == []


def test_single_runs_become_a_group(tmp_path, rng):
    """As soon as all are there, in any order, failed ones included; oracle: the group of one block."""
    x, ok = rng.standard_normal((SIZE, 4, 2)), rng.random(SIZE) > 0.2
    [expected] = groups(x, x[..., :1], ok, range(SIZE))
    rows = rng.permutation(SIZE)
    with Store(tmp_path) as store:
        for at, row in enumerate(map(int, rows)):
            assert [part.is_single for part in store.ensemble("m", SIZE)] == [True] * at
            part = slice(row, row + 1)
            add(store, [row], groups(x[part], x[part, :, :1], ok[part], range(row, row + 1)))
        [found] = store.ensemble("m", SIZE)
        assert found[:3] == expected[:3]
        np.testing.assert_array_equal(found.mean, expected.mean)
        np.testing.assert_array_equal(found.second, expected.second)
        assert store.finished("m", ["q"], ENSEMBLE).tolist() == [*range(SIZE)]


def test_single_runs_beside_a_group(tmp_path):
    """They count where the group reaches beyond the wanted number, until the group is stored again."""
    with Store(tmp_path) as store:
        add(store, range(SIZE), [group(0)])
        add(store, range(2), [single(0, 2.0), single(1, 3.0)])
        assert (spans(store, SIZE), spans(store, 2)) == ([(0, SIZE)], [(0, 1), (1, 2)])
        assert store.finished("m", ["q"], ENSEMBLE, 2).tolist() == [0, 1]
        add(store, range(SIZE), [group(0)])
        assert (spans(store, SIZE), spans(store, 2)) == ([(0, SIZE)], [])


def copied(tmp_path, here, there):
    """Fill two stores, copy the second one into the first, and return (first, stop, mean) of the moments there."""
    with Store(tmp_path / "here") as target, Store(tmp_path / "there") as source:
        here(target)
        there(source)
        target.copy_from(source)
        return [(part.first, part.stop, part.mean[0, 0]) for part in target.ensemble("m", 2 * SIZE)]


@pytest.mark.parametrize("known", [[0, 1, 2], [7], [SIZE - 1]])
def test_a_copied_group_takes_the_place_of_single_runs(tmp_path, known):
    """Wherever they lie in the group."""

    def here(store):
        add(store, known, [single(run, 2.0) for run in known])

    assert copied(tmp_path, here, lambda store: add(store, range(SIZE), [group(0)])) == [(0, SIZE, 1.0)]


def test_a_copied_single_run_leaves_the_others(tmp_path):
    """A run that both have stays; a group that the target has stays whole."""

    def here(store):
        add(store, range(2), [single(run, 2.0) for run in range(2)])
        add(store, range(SIZE, 2 * SIZE), [group(SIZE, 4.0)])

    def there(store):
        runs = [1, 2, SIZE]
        add(store, runs, [single(run, 3.0) for run in runs])

    expected = [(0, 1, 2.0), (1, 2, 2.0), (2, 3, 3.0), (SIZE, 2 * SIZE, 4.0)]
    assert copied(tmp_path, here, there) == expected


def test_moments_of_a_run_with_another_status_are_not_copied(tmp_path):
    """Neither of the run itself, nor of a group that has it; those of other groups are."""

    def here(store):
        add(store, [5], [], status=Status.TIMEOUT)
        add(store, [SIZE + 1], [], status=Status.TIMEOUT)

    def there(store):
        add(store, range(SIZE), [group(0)])
        runs = range(SIZE, SIZE + 3)
        add(store, runs, [single(run, 3.0) for run in runs])

    assert copied(tmp_path, here, there) == [(run, run + 1, 3.0) for run in (SIZE, SIZE + 2)]


def test_other_methods_keep_their_groups(tmp_path):
    """A block replaces the groups of its own method only."""
    with Store(tmp_path) as store:
        add(store, range(SIZE), [group(0, 1.0)], method="a")
        add(store, range(SIZE), [group(0, 2.0)], method="b")
        assert [store.ensemble(name, SIZE)[0].mean[0, 0] for name in "ab"] == [1.0, 2.0]


def test_a_block_without_groups_leaves_those_that_are_there(tmp_path):
    """Runs that are computed again for a metric, without an ensemble, are the same runs."""
    with Store(tmp_path) as store:
        add(store, range(SIZE), [group(0)])
        add(store, range(SIZE), [])
        assert len(store.ensemble("m", SIZE)) == 1


def test_a_missing_group_is_missing(tmp_path):
    """Runs whose group is lost are not complete."""
    path = write_estimation(tmp_path, **KEYS)
    ran(path, tmp_path / "out")
    with sqlite3.connect(tmp_path / "out" / "trials.sqlite") as connection:
        connection.execute("DELETE FROM ensemble_groups WHERE first = 50")
    connection.close()
    assert load_results(tmp_path / "out").n_complete == {"KF": N - 50, "ERP": N - 50}
