"""Blocks that a queue cuts off: whole ranges of runs, by time, each for one worker as long as there are others."""

import math

import pytest
from engines.misbehaving import do_nothing, experiment, raise_value_error

from rmpc_bench.config.load import load_config
from rmpc_bench.engines import blocks
from rmpc_bench.engines.blocks import BlockLengths, TaskQueue, megabytes_of_a_run
from rmpc_bench.engines.choice import here_first
from rmpc_bench.engines.tasks import Done, Task
from rmpc_bench.simulation.ensemble import SIZE

A, B = "do_nothing", "raise_value_error"
MADE = experiment([do_nothing, raise_value_error])


def queue_of(n_runs, fixed=None):
    """Return a queue of both methods."""
    return TaskQueue([Task(A, 0, n_runs), Task(B, 0, n_runs)], BlockLengths([MADE], fixed))


def done(task, seconds_of_a_run):
    """Return a finished task; a queue looks at nothing but its time."""
    return Done(task, None, [], seconds_of_a_run * len(task.runs))


def bounds(tasks):
    """Return the methods and the runs of tasks."""
    return [(task.method, task.first, task.stop) for task in tasks]


def test_a_worker_gets_all_methods_of_a_range():
    """A worker without a range takes what another one has not begun, the last first."""
    queue = queue_of(20, fixed=10)
    taken = [queue.take("x"), queue.take("y"), queue.take("x"), queue.take("x"), queue.take("x")]
    assert bounds(taken[:4]) == [(A, 0, 10), (A, 10, 20), (B, 0, 10), (B, 10, 20)]
    assert taken[4] is None and len(queue) == queue.n_trials == 0


def test_a_range_that_is_given_back():
    """Nothing is lost and nothing is counted twice."""
    queue = queue_of(20, fixed=10)
    queue.take()
    queue.give_back()
    assert queue.n_trials == 30
    assert bounds(queue.take_range()) == [(B, 0, 10)] and bounds(queue.take_range()) == [(A, 10, 20), (B, 10, 20)]
    assert queue.take_range() == [] and queue.n_trials == 0


@pytest.mark.parametrize("seconds_of_a_run", [1e-5, 1e-3, 0.1, 10.0])
def test_blocks_become_as_long_as_half_a_second(seconds_of_a_run):
    """Of the slowest method, with the memory and the growth as limits; every run is handed out once."""
    queue, runs, lengths = queue_of(1_000_000), {A: [], B: []}, []
    while (task := queue.take()) is not None:
        runs[task.method] += task.runs
        lengths.append(len(task.runs))
        queue.note(done(task, seconds_of_a_run if task.method == A else seconds_of_a_run / 5.0))
        if len(lengths) == 20:
            break
    n = len(runs[B])
    assert runs[A][:n] == runs[B] == [*range(n)]
    memory = blocks.MEGABYTES / megabytes_of_a_run(MADE)
    expected = min(blocks.SECONDS / seconds_of_a_run, memory)
    longest = max(lengths[4:])
    assert longest <= max(1.0, expected) and (longest >= expected - SIZE or longest == max(1, math.floor(expected)))


def test_blocks_become_shorter_towards_the_end():
    """So that all workers end at the same time."""
    queue = queue_of(4000)
    queue.workers = 4
    lengths = []
    while tasks := queue.take_range():
        lengths.append(len(tasks[0].runs))
        for task in tasks:
            queue.note(done(task, 2e-3))
    assert max(lengths) == 250 and max(lengths[-4:]) <= 100


def test_blocks_of_many_steps_stay_long():
    """A block of built-in components costs most of its time per step, whatever the number of runs is."""
    config = load_config("configs/quickstart.yaml", runs=1000)
    names = [method.name for method in config.experiment.methods]
    queue = TaskQueue([Task(name, 0, 1000) for name in names], BlockLengths([config.experiment]))
    lengths = []
    while tasks := queue.take_range():
        lengths.append(len(tasks[0].runs))
        for task in tasks:
            queue.note(Done(task, None, [], 2.0))
    assert min(lengths[1:-1]) >= SIZE


@pytest.mark.parametrize(("seconds_of_a_run", "grows", "expected"), [(1e-4, 0, 0), (1e-2, 0, 1), (1e-2, 9, 1)])
def test_workers_start_where_they_pay(seconds_of_a_run, grows, expected):
    """With a long rest, also where it is not known yet how long; the queue has then 200 trials at a time."""
    queue, calls = queue_of(100 if grows else 3000), []

    def workers(experiments, queue):
        calls.append(queue.n_trials)
        while (task := queue.take(1)) is not None:
            yield done(task, seconds_of_a_run)

    n = 0
    for each in here_first([MADE], queue, workers):
        n += len(each.task.runs)
        queue.note(done(each.task, seconds_of_a_run))
        if not queue.n_trials and grows:
            first = each.task.stop
            queue.add(Task(name, first, first + 100) for name in (A, B))
            grows -= 1
    assert len(calls) == expected
    assert n == (2000 if (expected and queue.has_grown) else 6000)
