"""When workers start; and one that the system does not start: what is said, and that nothing of it stays open."""

import errno
import os

import pytest
from engines.misbehaving import do_nothing, exit_by_sys, experiment, raise_value_error
from engines.test_disturbed import Slow, made_of, queue_of, results_of
from engines.worker_tree import WORKER, with_command
from small_experiment import write

from rmpc_bench import load_config, run
from rmpc_bench.engines import blocks, workers
from rmpc_bench.engines import pool as engine
from rmpc_bench.engines.blocks import BlockLengths, TaskQueue
from rmpc_bench.engines.choice import ComputeOptions, choose_engine, here_first
from rmpc_bench.engines.pool import Pool, processes
from rmpc_bench.engines.tasks import Done, Task
from rmpc_bench.engines.watch import Limits
from rmpc_bench.types.errors import WorkerError

NAMES = ("do_nothing", "raise_value_error")
MADE = experiment([do_nothing, raise_value_error])


def queue_after(seconds, seconds_left, n_points=1):
    """Return a queue that has computed for a time [s] and will for another one."""
    n = round(seconds_left / 2e-2)
    tasks = [Task(name, 0, n, point) for name in NAMES for point in range(n_points)]
    queue = TaskQueue(tasks, BlockLengths([MADE] * n_points))
    for name in NAMES:
        for part in (1, 2):
            runs = round(seconds * part / 6e-2)
            queue.note(Done(Task(name, 0, runs), None, [], 1e-2 * runs))
    return queue


@pytest.mark.parametrize("n_points", [1, 3])
@pytest.mark.parametrize("workers", [1, 2, 5])
def test_a_further_worker_saves_two_seconds(workers, n_points):
    """Oracle: the time that so many workers and one more take; points that are not measured count as the others."""
    for seconds_left in (3.0, 5.0, 11.0, 13.0, 59.0, 61.0):
        total = seconds_left * n_points
        saved = total / workers - total / (workers + 1)
        queue = queue_after(6.0, seconds_left, n_points)
        assert queue.seconds_left == pytest.approx(total, rel=1e-6) and queue.pays(workers) == (saved > 2.0)
    assert not queue_after(0.6, 61.0).pays(1)


def test_another_queue_for_the_same_methods_knows_their_time():
    """Methods with different files of the user are computed apart."""
    queue = queue_after(6.0, 61.0)
    part = queue.part({(0, NAMES[0])})
    assert part.pays(1) and part.seconds_left == pytest.approx(30.5, rel=1e-6)
    assert queue.seconds_left == pytest.approx(30.5, rel=1e-6)


@pytest.mark.parametrize(("name", "expected"), [(None, True), ("joblib", False)])
def test_jobs_are_the_most_workers(tmp_path, name, expected):
    """Unless an engine is named: that starts all of them."""
    config = load_config(write(tmp_path))
    tasks = [Task("S-MPC", 0, 3), Task("R-MPC", 0, 3)]
    found = choose_engine(config, tasks, ComputeOptions(4, name), tmp_path, print)
    assert (found.func is here_first) == expected
    of_workers = found.keywords["workers"] if expected else found
    assert of_workers.func is processes and of_workers.keywords["gradually"] == expected
    assert of_workers.keywords["workers"] == 4


def test_workers_that_join_change_no_byte(tmp_path, monkeypatch):
    """Oracle: the table of this process alone."""
    started, start = [], Pool.start
    monkeypatch.setattr(Pool, "start", lambda pool, numbers: started.extend(numbers) or start(pool, numbers))
    path = write(tmp_path, runs=40, noise="{process: {gaussian: {std: 0.01}}}")
    whole = run(load_config(path), directory=tmp_path / "one", jobs=1)
    for name in ("MEASURED", "PAYS"):
        monkeypatch.setattr(blocks, name, 0.0)
    parts = run(load_config(path, overrides=["execution.block=3"]), directory=tmp_path / "three", jobs=3)
    assert started == [0, 1, 2] and parts.trials.frame.to_csv() == whole.trials.frame.to_csv()


@pytest.mark.parametrize(("silent", "expected"), [(0.1, 2), (60.0, 1)])
def test_a_further_worker_starts_while_a_block_takes_very_long(monkeypatch, silent, expected):
    """Its time is not known before it ends."""
    monkeypatch.setattr(engine, "SILENT", silent)
    monkeypatch.setattr(engine, "LONGEST_PAUSE", 0.05)
    made, found, most = made_of(Slow(0.1), 4), [], 0
    for done in processes([made], queue_of(made, 1), 2, gradually=True):
        found.append(done)
        most = max(most, len(with_command(WORKER)))
    assert most == expected and len(results_of(found, 4)) == 4


class Idle:
    """A worker without a process."""

    def __init__(self):
        self.jobs = []

    def give(self, job):
        """Take a job."""
        self.jobs.append(job.task)


def test_workers_share_the_methods_of_the_last_range():
    """None waits in a worker while another one has nothing to do."""
    pool, fakes = Pool(b"", Limits(), None), {0: Idle(), 1: Idle()}
    pool._workers = fakes
    names = (*NAMES, "exit_by_sys")
    made = experiment([do_nothing, raise_value_error, exit_by_sys])
    queue = TaskQueue([Task(name, 0, 10) for name in names], BlockLengths([made], 10))
    pool._feed(queue)
    assert [worker.jobs for worker in fakes.values()] == [[Task(names[0], 0, 10)], [Task(names[2], 0, 10)]]
    assert len(queue) == 1


@pytest.mark.parametrize("number", [errno.EMFILE, errno.EAGAIN])
def test_a_worker_that_does_not_start(monkeypatch, number):
    """Oracle: the sentence, which is no report on results, and as many open files as before."""

    def refused(*arguments, **keys):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(workers, "start", refused)
    pool, before = Pool(b"", Limits(), None), os.listdir("/dev/fd")
    with pytest.raises(WorkerError) as error:
        pool.start([12])
    assert str(error.value) == f"cannot start worker 13: {os.strerror(number)}; give fewer workers (--jobs)"
    # The error holds the frames in which the files were opened: nothing is closed by chance.
    assert len(os.listdir("/dev/fd")) == len(before)
