"""Workers that are killed, stopped or hang through no fault of a run: the results are those of an undisturbed run."""

import os
import signal
import threading
import time

import numpy as np
import pytest
from engines.misbehaving import STEPS, Misbehaving, experiment
from engines.worker_tree import WORKER, disturbed, with_command
from simulation.toy import Halfway, Proportional

from rmpc_bench import child_process
from rmpc_bench.engines import pool as engine
from rmpc_bench.engines import workers
from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.choice import serial
from rmpc_bench.engines.pool import processes
from rmpc_bench.engines.tasks import Task
from rmpc_bench.engines.watch import Limits
from rmpc_bench.engines.workers import MAX_DEATHS, MAX_KILLS, End, Job, after
from rmpc_bench.store.columns import by_name
from rmpc_bench.types import Method

OUTSIDE, INSIDE, LATE = End("killed", outside=True), End("exit code 3"), End("late", timed_out=True)


class Slow(Halfway):
    """The toy estimator, which takes its time; a file has the number of the process that has called it last."""

    def __init__(self, seconds, file=None):
        self.seconds, self.file = seconds, file

    def correct(self, k, state, y):
        """Wait, then estimate."""
        if self.file is not None:
            replaced = f"{self.file}-{os.getpid()}"
            with open(replaced, "w") as file:
                file.write(str(os.getpid()))
            os.replace(replaced, self.file)
        time.sleep(self.seconds)
        return super().correct(k, state, y)


def made_of(estimator, n_runs):
    """Return an experiment of one method on the toy plant."""
    made = experiment([], n_runs)
    object.__setattr__(made, "methods", (Method("A", estimator, Proportional()),))
    return made


def queue_of(made, block):
    """Return its tasks."""
    return TaskQueue(Task("A", first, min(first + block, made.n_runs)) for first in range(0, made.n_runs, block))


def results_of(dones, n_runs):
    """Return (metric, uncertain values, status) of every run, which must be there once."""
    found = {}
    for done in dones:
        values = by_name(done.uncertainty)
        for row, run in enumerate(done.task.runs):
            assert run not in found
            drawn = {name: each[row] for name, each in values.items()}
            found[run] = (done.block.metrics[0, row], drawn, done.block.status[row])
    return [found[run] for run in range(n_runs)]


def serial_results(n_runs):
    """Return those of this process."""
    made = made_of(Halfway(), n_runs)
    return results_of(serial([made], queue_of(made, 7)), n_runs)


@pytest.mark.kill
def test_a_worker_that_is_killed_or_stopped(tmp_path, monkeypatch):
    """By any signal, in the middle of a run; another worker repeats what it had."""
    monkeypatch.setattr(workers, "STOPPED", 0.5)
    at_work, notes = tmp_path / "at_work", []
    made = made_of(Slow(0.03, str(at_work)), 60)
    dones = processes([made], queue_of(made, 1), 2, note=lambda *each: notes.append(each))
    signals = (signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP)
    plan = {5 + 15 * place: (at_work, number) for place, number in enumerate(signals)}
    assert results_of(disturbed(dones, plan), 60) == serial_results(60)
    messages = [end.message for _, end in notes]
    assert messages == [
        "the worker process was ended by SIGKILL",
        "the worker process was ended by SIGTERM",
        "the worker process was stopped",
    ]
    assert all(end.outside for _, end in notes)
    assert all("method A, run" in text and "attempt 1" in text for text, _ in notes)
    assert with_command(WORKER) == []


@pytest.mark.kill
def test_a_worker_that_is_stopped_while_it_starts(monkeypatch):
    """Nobody waits for it, however large the experiments are that it would have read; another one takes its place."""
    monkeypatch.setattr(workers, "STOPPED", 0.5)
    start, started, notes = workers.start, [], []

    def stopped_at_first(*arguments, **keys):
        started.append(start(*arguments, **keys))
        if len(started) == 1:
            os.kill(started[0].pid, signal.SIGSTOP)
        return started[-1]

    monkeypatch.setattr(workers, "start", stopped_at_first)
    estimator = Halfway()
    # More than a pipe takes before somebody reads.
    estimator.data = bytes(4_000_000)
    made = made_of(estimator, 4)
    dones = processes([made], queue_of(made, 4), 1, note=lambda *each: notes.append(each))
    assert results_of(dones, 4) == serial_results(4)
    assert [end.message for _, end in notes] == ["the worker process was stopped"] and len(started) == 2


@pytest.mark.kill
def test_a_worker_that_is_stopped_in_the_middle_of_a_message(monkeypatch):
    """Nobody waits for the rest of it; another worker computes the block again."""
    monkeypatch.setattr(workers, "STOPPED", 0.5)
    receive, stopped, notes, n_runs = workers.WorkerProcess.receive, [], [], 60_000

    def stop_it(worker):
        found = receive(worker)
        if worker.loaded and not found and not stopped:
            stopped.append(worker.pid)
            os.kill(worker.pid, signal.SIGSTOP)
        return found

    monkeypatch.setattr(workers.WorkerProcess, "receive", stop_it)
    made = made_of(Halfway(), n_runs)
    [done] = processes([made], queue_of(made, n_runs), 1, note=lambda *each: notes.append(each))
    assert len(stopped) == 1 and [end.message for _, end in notes] == ["the worker process was stopped"]
    [expected] = serial([made], queue_of(made, n_runs))
    np.testing.assert_array_equal(done.block.metrics, expected.block.metrics)


class HangsOnce(Halfway):
    """Waits without end the first time that it is called."""

    def __init__(self, marker):
        self.marker = marker

    def correct(self, k, state, y):
        """Wait if nobody has done so."""
        if not os.path.exists(self.marker):
            with open(self.marker, "w"):
                time.sleep(1000.0)
        return super().correct(k, state, y)


@pytest.mark.kill
def test_a_worker_that_hangs(tmp_path, monkeypatch):
    """It uses no time of the processor for long."""
    monkeypatch.setattr(engine, "patience", lambda experiments: 1.0)
    monkeypatch.setattr(child_process, "BETWEEN", 0.2)
    made, notes = made_of(HangsOnce(str(tmp_path / "marker")), 4), []
    dones = processes([made], queue_of(made, 4), 1, note=lambda *each: notes.append(each))
    assert results_of(dones, 4) == serial_results(4)
    assert [end.message for _, end in notes] == ["the worker process has computed nothing for 1 s"]


@pytest.mark.kill
def test_a_stop_is_no_computing_time():
    """A run whose worker was stopped for a while has not timed out."""
    made = made_of(Slow(0.1), 2)
    dones = processes([made], queue_of(made, 1), 1, Limits(step=0.5))
    first = next(dones)
    [worker] = with_command(WORKER)
    os.kill(worker, signal.SIGSTOP)
    timer = threading.Timer(2.0, os.kill, (worker, signal.SIGCONT))
    timer.start()
    assert results_of([first, *dones], 2) == serial_results(2)
    timer.join()


def test_patience_is_longer_with_own_code():
    """A component may wait for a device; the bench never waits."""
    assert engine.patience([made_of(Halfway(), 1)]) == workers.HUNG_WITH_OWN_CODE


def ends(job, *given):
    """Apply ends one after the other to what is left of a job; return failures and the last job."""
    failures = []
    for end in given:
        failed, job = after(job, end)
        failures += [] if failed is None else [failed]
    return failures, job


def test_a_block_is_repeated_as_it_is_and_then_run_by_run():
    """Only the second end from outside makes a difference, but the first end by itself."""
    block = Job(Task("A", 0, 4))
    assert ends(block, OUTSIDE) == ([], block._replace(kills=1))
    assert ends(block, OUTSIDE, OUTSIDE) == ([], Job(Task("A", 0, 4), alone=True))
    assert ends(block, INSIDE) == ends(block, LATE) == ([], Job(Task("A", 0, 4), alone=True))
    assert ends(Job(Task("A", 3, 3)), OUTSIDE) == ([], None)


@pytest.mark.parametrize(("end", "attempts"), [(INSIDE, MAX_DEATHS), (OUTSIDE, MAX_KILLS), (LATE, 1)])
def test_a_run_alone_has_some_attempts(end, attempts):
    """Then it has failed, and the next run begins with none used."""
    job = Job(Task("A", 5, 8), alone=True)
    assert ends(job, *[end] * (attempts - 1))[0] == []
    [failed], rest = ends(job, *[end] * attempts)
    assert failed.task == Task("A", 5, 6) and failed.failure.run == 5
    assert rest == Job(Task("A", 6, 8), alone=True)
    assert ("attempts" in failed.failure.message) == end.outside


def test_attempts_of_both_kinds_are_counted_apart():
    """A pre-emption between two crashes gives a run no third one."""
    failures, _ = ends(Job(Task("A", 5, 6)), INSIDE, OUTSIDE, OUTSIDE, INSIDE)
    assert [failed.failure.message for failed in failures] == ["exit code 3"]


def test_numbers_of_the_toy():
    """The comparisons above would be worth nothing if the runs were equal."""
    assert len({values[0] for values in serial_results(60)}) == 60 and STEPS > 1
    assert np.isfinite([values[0] for values in serial_results(60)]).all() and issubclass(Misbehaving, Halfway)


def test_a_signal_without_a_name():
    """Real-time signals have only numbers."""
    assert child_process.signal_name(signal.SIGSEGV) == "SIGSEGV" and child_process.signal_name(36) == "signal 36"
