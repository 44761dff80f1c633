"""trials.sqlite: blocks in, columns out, one writer, nothing lost."""

import math
import sqlite3

import numpy as np
import pytest

from rmpc_bench.received.plain_files import DamagedError, StoreError
from rmpc_bench.received.store import FILE, WriteError
from rmpc_bench.simulation.closed_loop import Block
from rmpc_bench.simulation.ensemble import Group
from rmpc_bench.store.differences import differences
from rmpc_bench.store.store import Store
from rmpc_bench.types import Journal, Status

OK, DIVERGED = Status.OK, Status.DIVERGED


def add(store, runs, *, method="m", metric="q", values=None, status=None):
    """Store a block whose value is the run's index unless given."""
    values = np.array([float(run) for run in runs] if values is None else values)
    status = np.array([OK] * len(runs) if status is None else status, dtype=np.int8)
    block = Block(status, values[None], {}, (), Journal())
    store.add_block(method, runs, block, {metric: values}, "d", [{"eps": 0.1 * run} for run in runs])


@pytest.fixture
def store(tmp_path):
    """Return a writable store in a directory that was not there."""
    with Store(tmp_path / "a" / "b") as opened:
        yield opened


def test_blocks_come_back_in_the_order_of_the_runs(store):
    """Whatever the order they were stored in; runs beyond the wanted number stay out."""
    add(store, [4, 5])
    add(store, [0, 1])
    assert store.column("m", 5) == ([0, 1, 4], ["ok", "ok", "ok"])
    np.testing.assert_array_equal(store.values("m", "q", [0, 4, 1]), [0.0, 4.0, 1.0])
    assert store.column("other", 5) == ([], [])


@pytest.mark.parametrize("value", [0.1 + 0.2, 0.0, 5e-324, 1.7976931348623157e308, math.inf, -math.inf])
def test_every_float_comes_back_bit_for_bit(store, value):
    """Infinity is a value (never), NaN is none."""
    add(store, [0, 1], values=[value, math.nan])
    found = store.values("m", "q", [0, 1, 2])
    assert found[:1].tobytes() == np.array([value]).tobytes()
    assert np.isnan(found[1:]).all()


def test_a_failed_run_is_finished(store):
    """It has a status and no values, and is not computed again."""
    add(store, [0, 1], status=[OK, DIVERGED], values=[1.0, math.nan])
    assert store.column("m", 2) == ([0, 1], ["ok", "diverged"])
    assert store.finished("m", ["q"]).tolist() == [0, 1]


def test_finished_wants_every_metric(store):
    """A run is finished when all metrics asked for are there."""
    add(store, [0, 1], metric="q")
    add(store, [1, 2], metric="p")
    assert store.finished("m", ["q"]).tolist() == [0, 1]
    assert store.finished("m", ["q", "p"]).tolist() == [1]
    assert store.finished("m", []).tolist() == [0, 1, 2]
    assert store.finished("other", ["q"]).tolist() == []


def test_uncertainty_is_stored_once_per_run(store):
    """Methods share it."""
    add(store, [1, 0], method="m")
    add(store, [0, 2], method="n")
    runs, values = store.uncertainty("d", 2)
    assert runs.tolist() == [0, 1] and [*values] == ["eps"] and values["eps"].tolist() == [0.0, 0.1]


def test_a_block_is_stored_whole_or_not_at_all(store):
    """A mistake in the middle leaves nothing behind, and the store goes on working."""
    bad = [Group(0, 1, None, np.zeros((1, 1)), np.zeros((0, 1, 1)))]
    with pytest.raises(WriteError, match="NOT NULL"):
        block = Block(np.array([OK], dtype=np.int8), np.array([[1.0]]), {}, bad, Journal())
        store.add_block("m", [0], block, {"q": np.array([1.0])}, "d", [{"eps": 1.0}])
    assert store.finished("m", []).tolist() == [] and not store.has_trials("m")
    assert store.uncertainty("d", 9)[1] == {}
    add(store, [0])
    assert store.finished("m", ["q"]).tolist() == [0]


def test_a_run_may_lack_a_quantity(store):
    """Runs without any are left out; whole columns are stored as well."""
    block = Block(np.zeros(3, dtype=np.int8), np.zeros((1, 3)), {}, (), Journal())
    store.add_block("m", range(3), block, {}, "d", [{"a": 1.0}, {}, {"b": 2.0}])
    store.add_block("m", range(3, 6), block, {}, "e", {"c": np.array([4.0, 5.0, 6.0])})
    runs, values = store.uncertainty("d", 9)
    assert runs.tolist() == [0, 2]
    np.testing.assert_array_equal(values["a"], [1.0, np.nan])
    np.testing.assert_array_equal(values["b"], [np.nan, 2.0])
    assert store.uncertainty("e", 4)[1]["c"].tolist() == [4.0]


def test_one_experiment_owns_the_directory(tmp_path):
    """Another one is refused, with every difference; the same one is welcome again."""
    with Store(tmp_path) as store:
        store.claim("hash", {"seed": 1, "time": {"step": 0.1, "steps": 10}})
    with Store(tmp_path) as store:
        store.claim("hash", {"seed": 1, "time": {"step": 0.1, "steps": 10}})
        with pytest.raises(StoreError) as caught:
            store.claim("other", {"seed": 2, "time": {"step": 0.1, "steps": 20}, "noise": "none"})
    assert str(caught.value).splitlines()[1:] == [
        "  seed: there 1, here 2",
        "  time.steps: there 10, here 20",
        '  noise: there null, here "none"',
    ]


def test_one_writer_at_a_time(tmp_path):
    """A second one is told so at once; when the first has gone it may."""
    with Store(tmp_path) as store:
        add(store, [0])
        with pytest.raises(StoreError, match="another process writes to it"):
            Store(tmp_path)
    with Store(tmp_path) as store:
        add(store, [1])
        assert store.finished("m", ["q"]).tolist() == [0, 1]


def test_many_may_read(tmp_path):
    """Reading needs no lock of its own and cannot write."""
    with Store(tmp_path) as store:
        add(store, [0])
    with Store(tmp_path, writable=False) as first, Store(tmp_path, writable=False) as second:
        assert first.finished("m", ["q"]).tolist() == second.finished("m", ["q"]).tolist() == [0]
        with pytest.raises(WriteError, match="readonly"):
            add(first, [1])
            first.flush()


def test_rollback_journal_for_network_file_systems(tmp_path):
    """No write-ahead log, which needs shared memory."""
    with Store(tmp_path):
        pass
    connection = sqlite3.connect(tmp_path / FILE)
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("delete",)
    connection.close()
    assert [path.name for path in tmp_path.iterdir()] == [FILE]


@pytest.mark.parametrize("content", [b"not a database " * 100, b"SQLite format 3\x00" + b"\xff" * 4096])
def test_a_file_that_is_no_store(tmp_path, content):
    """It is left as it is."""
    (tmp_path / FILE).write_bytes(content)
    for writable in (True, False):
        with pytest.raises(StoreError, match="is not a trial store"):
            Store(tmp_path, writable=writable)
    assert (tmp_path / FILE).read_bytes() == content


def test_another_database_is_not_read_as_a_store(tmp_path):
    """Reading a database without our tables says so."""
    connection = sqlite3.connect(tmp_path / FILE)
    connection.execute("CREATE TABLE mine (a)")
    connection.close()
    with pytest.raises(StoreError, match="is not a trial store"):
        Store(tmp_path, writable=False)


def test_a_directory_that_cannot_be_made(tmp_path):
    """Below a regular file there is none."""
    (tmp_path / "file").touch()
    with pytest.raises(WriteError, match="file"):
        Store(tmp_path / "file" / "results")


def test_a_full_disk(tmp_path):
    """Writing fails, everything before is there, and room makes it go on."""
    with Store(tmp_path) as store:
        add(store, range(10))
        [pages] = store.file.connection.execute("PRAGMA page_count").fetchone()
        store.file.connection.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(WriteError, match="full"):
            add(store, range(10, 5000))
            store.flush()
        assert store.finished("m", ["q"]).tolist() == [*range(10)]
        store.file.connection.execute("PRAGMA max_page_count = 100000")
        add(store, range(10, 5000))
        assert store.finished("m", ["q"]).tolist() == [*range(5000)]


def test_a_damaged_chunk_is_damage_where_runs_are_added(store):
    add(store, [0, 1])
    store.file.connection.execute("UPDATE chunks SET data = x'00'")
    with pytest.raises(DamagedError):
        add(store, [2])


def test_a_parameter_with_the_name_of_the_hashes_is_a_setting():
    assert differences({"plant": {"code": 1}}, {"plant": {"code": 2}}, {}) == ["plant.code: there 1, here 2"]


def test_differences_of_equal_trees():
    """There are none, however the keys are ordered."""
    assert differences({"a": 1, "b": [1, 2]}, {"b": [1, 2], "a": 1}, {}) == []


def test_numbers_of_the_statuses_are_part_of_the_format():
    """A store has the numbers, not the words."""
    words = "ok diverged out-of-range too-many-events empty-set singular infeasible not-converged timeout crashed"
    assert [status.word for status in sorted(Status)] == words.split()
    assert [int(status) for status in sorted(Status)] == [*range(10)]


@pytest.mark.parametrize(("n_runs", "block", "limit"), [(100_000, 5000, 70e6), (10_000, 50, 6e6), (500, 1, 300e3)])
def test_size_of_a_trial(tmp_path, rng, n_runs, block, limit):
    """Four methods with four metrics and three uncertain quantities: at most 150 bytes a trial, whatever the blocks."""
    with Store(tmp_path) as store:
        for first in range(0, n_runs, block):
            sampled = {name: rng.random(block) for name in ("eps_min", "eps_max", "eps_jl")}
            for method in "abcd":
                values = rng.random((4, block))
                results = Block(np.zeros(block, dtype=np.int8), values, {}, (), Journal())
                columns = {64 * name: column for name, column in zip("efgh", values, strict=True)}
                store.add_block(64 * method, range(first, first + block), results, columns, 64 * "i", sampled)
    size = (tmp_path / FILE).stat().st_size
    assert size < limit and size / (4 * n_runs) <= 150
    with Store(tmp_path, writable=False) as store:
        assert len(store.finished(64 * "d", [64 * "h"])) == n_runs


def test_a_block_is_committed_although_no_other_comes(tmp_path):
    """A copy of the file has it."""
    import shutil
    import time

    with Store(tmp_path / "a") as store:
        add(store, [0])
        add(store, [1])
        deadline = time.monotonic() + 20.0
        found = []
        while found != [0, 1] and time.monotonic() < deadline:
            time.sleep(0.1)
            shutil.rmtree(tmp_path / "b", ignore_errors=True)
            shutil.copytree(tmp_path / "a", tmp_path / "b")
            with Store(tmp_path / "b", writable=False) as copy:
                found = copy.finished("m", ["q"]).tolist()
        assert found == [0, 1]
