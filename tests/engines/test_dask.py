"""The engine on a dask cluster: the same results, whatever happens to its workers."""

import logging
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from cli.test_interruption import COMMAND, gone
from engines import misbehaving
from engines.misbehaving import BAD, do_nothing, experiment, tasks_of
from engines.test_contained import stores
from engines.test_disturbed import Slow, made_of, queue_of, results_of, serial_results
from engines.test_isolation import ENDS, LIMITS, N_RUNS, Stuck
from engines.worker_tree import DASK_WORKER, WORKER, below, disturbed, with_command
from small_experiment import cli, ran, write

from rmpc_bench.components.transport import dumps
from rmpc_bench.engines import dask_cluster as engine
from rmpc_bench.engines import dask_worker
from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.choice import serial
from rmpc_bench.engines.dask_cluster import dask_cluster
from rmpc_bench.engines.pool import Pool
from rmpc_bench.engines.tasks import Task
from rmpc_bench.engines.watch import Limits
from rmpc_bench.engines.workers import Job
from rmpc_bench.types.errors import WorkerError

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("default::ResourceWarning", "default::pytest.PytestUnraisableExceptionWarning")
ACTS = ("exit_at_once", "kill_itself", "loop_in_compiled_code", "fill_memory", "raise_value_error", "return_bad_status")


@pytest.fixture(scope="module")
def scheduler():
    """Start a cluster of two workers on this machine and return the address of its scheduler."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=0,
        silence_logs=logging.CRITICAL,
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def store_of(scheduler, tmp_path_factory):
    """Compute on the cluster."""

    def compute(made):
        return dask_cluster([made], TaskQueue(tasks_of(made, 15)), 2, scheduler, LIMITS)

    with stores(compute, N_RUNS, tmp_path_factory) as found:
        yield found


@pytest.mark.parametrize("act", ACTS)
@pytest.mark.long
def test_only_the_bad_runs_fail(store_of, act):
    """As with worker processes of this machine."""
    store, (status, message) = store_of(act), ENDS[act]
    runs, words = store.column(act, N_RUNS)
    assert [*words] == [status if run in BAD else "ok" for run in runs]
    good = [run for run in runs if run not in BAD]
    np.testing.assert_array_equal(store.values(act, "mse", good), store.values("do_nothing", "mse", good))
    failures = store.failures(act, N_RUNS)
    assert [failure.run for failure in failures] == [*BAD]
    assert all(failure.message.startswith(message) for failure in failures)


def test_the_workers_have_the_results_of_this_process(store_of):
    """Oracle: the same method in this process."""
    here = experiment([do_nothing], N_RUNS)
    values = np.concatenate([done.block.metrics[0] for done in serial([here], TaskQueue(tasks_of(here, 9)))])
    found = store_of("raise_value_error").values("do_nothing", "mse", range(N_RUNS))
    np.testing.assert_array_equal(found, values)


@pytest.mark.kill
def test_workers_that_are_killed_or_stopped(monkeypatch):
    """Dask workers that the engine has started, and worker processes below them; nothing stays."""
    monkeypatch.setattr(engine, "STOPPED", 0.5)
    made, notes, before = made_of(Slow(0.01), 80), [], {*below()}
    dones = dask_cluster([made], queue_of(made, 1), 2, note=lambda *each: notes.append(each))
    plan = {5: (DASK_WORKER, signal.SIGKILL), 20: (DASK_WORKER, signal.SIGSTOP), 50: (WORKER, signal.SIGKILL)}
    assert results_of(disturbed(dones, plan), 80) == serial_results(80)
    messages = [end.message for _, end in notes]
    assert {"the worker process was ended by SIGKILL", "a dask worker was stopped"} <= {*messages}
    assert not {*with_command(WORKER), *with_command(DASK_WORKER)} - before


def test_a_future_whose_workers_are_lost(monkeypatch):
    """Dask gives it up; its runs are repeated one by one, and one that is lost again and again has crashed."""
    task, lost = Task("A", 0, 3), []
    futures = engine._Futures(FakeCluster(lost), TaskQueue([task]), lambda *each: None)
    given = [*futures.results()]
    assert [each.task for each in given if each.task.first != 1] == [Task("A", 0, 1), Task("A", 2, 3)]
    [failed] = [each for each in given if each.task.first == 1]
    assert failed.failure.message == "the dask workers that had the run were lost (4 attempts)"
    assert lost == [[Job(task)]] + 4 * [lost[1]]


class FakeFuture:
    """A future that is finished; run 1 is lost wherever it takes part."""

    def __init__(self, key, jobs, lost):
        self.key, self.status, self._jobs, self._lost = key, "finished", jobs, lost

    def add_done_callback(self, call):
        """Call at once."""
        call(self)

    def result(self, timeout):
        """Return a report, or raise what dask raises."""
        if any(1 in job.task.runs for job in self._jobs):
            self._lost.append(self._jobs)
            raise distributed.KilledWorker("key", None, 3)
        return dask_worker.Report([job for job in self._jobs], [])


class FakeCluster:
    """A cluster without processes."""

    is_lost = False

    def __init__(self, lost):
        self._lost, self._n = lost, 0

    def submit(self, jobs):
        """Return a future that is finished."""
        self._n += 1
        # The attempts are what differs between repeated jobs.
        return FakeFuture(self._n, [job._replace(kills=0) for job in jobs], self._lost)

    def n_threads(self):
        """Return the number of threads."""
        return 1

    def replace_stopped(self):
        """Find none."""
        return ()


def test_a_scheduler_that_is_not_there(monkeypatch):
    """One line with its address."""
    made = made_of(Slow(0.0), 2)
    monkeypatch.setattr(engine, "CONNECT", 1.0)
    with pytest.raises(WorkerError, match=r"no connection to the scheduler at tcp://127.0.0.1:9"):
        [*dask_cluster([made], queue_of(made, 1), 2, "tcp://127.0.0.1:9")]


OWN_CLUSTER = """
import distributed, time
cluster = distributed.LocalCluster(
    n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address="127.0.0.1:0"
)
print(cluster.scheduler_address, flush=True)
time.sleep(100.0)
"""


@pytest.mark.kill
def test_a_scheduler_that_is_killed(monkeypatch, capfd):
    """One sentence soon, without a word of dask's own; what was finished before has been handed over."""
    monkeypatch.setattr(engine, "PATIENCE", 2.0)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    command = [sys.executable, "-c", OWN_CLUSTER]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        made, found, notes = made_of(Slow(0.05), 200), [], []
        address = process.stdout.readline().strip()
        queue = queue_of(made, 1)
        with pytest.raises(WorkerError, match=f"the scheduler at {address} was lost.*; finished blocks are stored"):
            for done in dask_cluster([made], queue, 1, address, note=lambda text, end: notes.append(text)):
                if not found:
                    os.killpg(process.pid, signal.SIGKILL)
                    killed = time.monotonic()
                found.append(done)
        assert time.monotonic() - killed < 15.0
        assert 0 < len(found) < 200 and notes[0] == "the connection to the dask scheduler was lost"
        assert "Traceback" not in capfd.readouterr().err
    finally:
        process.kill()
        process.communicate()


@pytest.mark.long
def test_a_scheduler_without_workers(monkeypatch):
    """It is said once, and the computation goes on with the worker that comes then."""
    monkeypatch.setattr(engine, "WITHOUT", 0.0)
    with distributed.LocalCluster(
        n_workers=0,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=0,
        silence_logs=logging.CRITICAL,
    ) as cluster:
        said, made = [], made_of(Slow(0.0), 2)

        def say(text):
            said.append(text)
            cluster.scale(1)

        dones = dask_cluster([made], queue_of(made, 1), 1, cluster.scheduler_address, say=say)
        assert results_of(dones, 2) == serial_results(2)
        assert said == [f"engine dask: the scheduler at {cluster.scheduler_address} has no workers; waiting for one"]


def test_an_experiment_that_a_worker_cannot_load(scheduler):
    """One error with the reason."""
    made = made_of(Stuck(do_nothing), 4)
    with pytest.raises(WorkerError, match="cannot load the experiment: .*invalid literal"):
        [*dask_cluster([made], queue_of(made, 2), 2, scheduler)]


def test_a_worker_with_other_versions(scheduler, monkeypatch):
    """It would compute other numbers."""
    monkeypatch.setattr(engine, "versions", lambda: {**dask_worker.versions(), "numpy": "0.9"})
    made = made_of(Slow(0.0), 2)
    with pytest.raises(WorkerError, match=r"has numpy \d.* instead of 0.9"):
        [*dask_cluster([made], queue_of(made, 1), 2, scheduler)]


@pytest.mark.kill
def test_closing_ends_a_run_that_hangs(scheduler):
    """Also on a cluster that goes on."""
    made = experiment([do_nothing, misbehaving.sleep], 12)
    dones = dask_cluster([made], TaskQueue(tasks_of(made, 4)), 2, scheduler, Limits())
    next(dones)
    dones.close()
    assert results_of(dask_cluster([made_of(Slow(0.0), 4)], queue_of(made_of(Slow(0.0), 4), 1), 2, scheduler), 4)


def test_a_thread_that_is_late_computes_nothing():
    """It has the experiment before the end of the computation, and takes or replaces a process after it."""
    made = experiment([do_nothing, misbehaving.sleep], 12)
    jobs = [Job(task) for task in tasks_of(made, 4)]
    kept = dask_worker.KeptPools(dask_worker.Setup("late", dumps([made]), Limits(), None, 1.0, dask_worker.versions()))
    kept.cancel()
    with pytest.raises(WorkerError, match="cancelled"):
        kept.compute(jobs)
    pool = Pool(dumps([made]), Limits(), None)
    pool.cancel()
    pool.start([0])
    with pytest.raises(WorkerError, match="cancelled"):
        [*pool.results(TaskQueue(), jobs)]
    pool.close()


KEYS = {
    "runs": "20",
    "noise": "{process: {gaussian: {std: 0.01}}, measurement: {same: {scale: 0.01}}}",
    "initial": "{x: {gaussian: {std: 0.1}}}",
    "metrics": "[mse, input_power, settling_time, steady_state_error]",
}
WAYS = {
    "serial": ("--engine", "serial"),
    "one worker process": ("--engine", "joblib", "-j", 1),
    "two workers": ("--engine", "joblib", "-j", 2, "-s", "execution.block=3"),
    "three workers": ("--engine", "joblib", "-j", 3, "-s", "execution.block=1"),
    "block of 7": ("-s", "execution.block=7"),
    "dask": ("--engine", "dask"),
    "dask, block of 3": ("--engine", "dask", "-s", "execution.block=3"),
}


@pytest.mark.long
def test_every_engine_gives_the_same_bytes(tmp_path, scheduler):
    """Any number of workers, any block."""
    path, found = write(tmp_path, **KEYS), {}
    for number, (way, options) in enumerate(WAYS.items()):
        address = ("--scheduler", scheduler) if "dask" in options else ()
        result = cli("run", path, "-o", tmp_path / str(number), "--progress", "none", *options, *address)
        assert result.exit_code == 0, result.output
        found[way] = (tmp_path / str(number) / "trials.csv").read_bytes()
    assert {*found.values()} == {ran(path, tmp_path / "default")}, found


WAITING = """
import time
from rmpc_bench import single_run

@single_run
class Own:
    def __init__(self, model):
        self.nx = model.nx
    def start(self, x0, run):
        self.x_hat = x0
    def update(self, y, k):
        print("computes", flush=True)
        time.sleep(0.05)
        return self.x_hat
"""


@pytest.mark.kill
def test_an_interruption(tmp_path):
    """Ctrl-C, which reaches all processes of the group, ends it without a traceback, and no process stays."""
    (tmp_path / "own.py").write_text(WAITING, encoding="utf-8")
    path = write(tmp_path, methods="{A: {estimator: {file: own.py:Own}}}", runs=200)
    command = [COMMAND, "run", path, "-o", tmp_path / "out", "--engine", "dask", "--progress", "none"]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60.0
    try:
        while time.monotonic() < deadline and not any(file.stat().st_size for file in tmp_path.glob("out/logs/*/*")):
            time.sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 130 and "the same command continues" in err and "Traceback" not in err, err
        with pytest.raises(ProcessLookupError):
            gone(process.pid)
    finally:
        process.kill()


@pytest.mark.parametrize("address", ["foo", "tcp://foo", "foo:x", "127.0.0.1:99999", ""])
def test_an_address_that_is_none(tmp_path, address):
    """A client of dask would wait for it without end."""
    result = cli("run", write(tmp_path), "-o", tmp_path / "out", "--engine", "dask", "--scheduler", address)
    assert result.exit_code == 2
    assert "is no address of a scheduler" in result.stderr
