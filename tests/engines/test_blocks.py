"""Blocks that a queue cuts off: whole ranges of runs, by time, each for one worker as long as there are others."""

import itertools
import math

import pytest
from engines.misbehaving import do_nothing, experiment, raise_value_error

from rmpc_bench.config.load import load_config
from rmpc_bench.engines import blocks
from rmpc_bench.engines.blocks import MOST, BlockLengths, TaskQueue, fitted, megabytes_of_a_run
from rmpc_bench.engines.choice import here_first
from rmpc_bench.engines.tasks import Done, Task
from rmpc_bench.simulation.ensemble import SIZE

A, B = "do_nothing", "raise_value_error"
MADE = experiment([do_nothing, raise_value_error])


def queue_of(n_runs, fixed=None):
    """Return a queue of both methods."""
    return TaskQueue([Task(A, 0, n_runs), Task(B, 0, n_runs)], BlockLengths([MADE], fixed))


def done(task, seconds_of_a_run, fixed=0.0, loads=False):
    """Return a finished task; a queue looks at nothing but its time."""
    return Done(task, None, [], fixed + seconds_of_a_run * len(task.runs), loads)


def bounds(tasks):
    """Return the methods and the runs of tasks."""
    return [(task.method, task.first, task.stop) for task in tasks]


def test_a_worker_gets_all_methods_of_a_range():
    """A worker without a range takes what another one has not begun, the last first."""
    queue = queue_of(20, fixed=10)
    taken = [queue.take("x"), queue.take("y"), queue.take("x"), queue.take("x"), queue.take("x")]
    assert bounds(taken[:4]) == [(A, 0, 10), (A, 10, 20), (B, 0, 10), (B, 10, 20)]
    assert taken[4] is None and len(queue) == 0


def test_a_range_that_is_given_back():
    """Nothing is lost and nothing is counted twice."""
    queue = queue_of(20, fixed=10)
    queue.take()
    queue.give_back()
    assert bounds(queue.take_range()) == [(B, 0, 10)] and bounds(queue.take_range()) == [(A, 10, 20), (B, 10, 20)]
    assert queue.take_range() == [] and len(queue) == 0


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
    expected = min(round(blocks.SECONDS / seconds_of_a_run, 6), memory)
    longest = max(lengths[4:])
    assert longest <= max(1.0, expected) and (longest >= expected - SIZE or longest == max(1, math.floor(expected)))


def test_blocks_become_shorter_towards_the_end():
    """So that all workers end at the same time.  The second one is twice as long as the first, which shows a."""
    queue = queue_of(4000)
    queue.workers = 4
    lengths = []
    while tasks := queue.take_range():
        lengths.append(len(tasks[0].runs))
        for task in tasks:
            queue.note(done(task, 2e-3))
    assert max(lengths[2:]) == 250 and max(lengths[-4:]) <= 100


def computed(queue, workers, a, b):
    """Let workers compute a queue, whose blocks take a + b n; return each block with the number of those before it."""
    queue.workers, found, busy = workers, [], []
    while len(queue) or busy:
        idle = {*range(workers)} - {worker for _, worker, _ in busy}
        for worker in sorted(idle):
            if (task := queue.take(worker)) is not None:
                now = busy[0][0] if busy else 0.0
                found.append(task)
                busy.append((now + a[task.method] + b * len(task.runs), worker, task))
        busy.sort()
        _, _, task = busy.pop(0)
        queue.note(done(task, b, a[task.method]))
    return found


@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize(("a", "b"), [(0.1, 1e-3), (0.5, 2e-2), (2.0, 0.5), (0.2, 1e-6), (0.0, 1e-2)])
def test_the_time_besides_that_of_the_runs_is_a_small_share(workers, a, b):
    """Of a range of both methods at most 20 %, hence at least 4 a / b runs with the sums of a and b.

    Not in the first blocks, from which a is known, and in the last one.  Every run is computed once.
    """
    queue, each = queue_of(3000), {A: a, B: 3.0 * a}
    found = computed(queue, workers, each, b)
    assert sorted(run for task in found if task.method == A for run in task.runs) == [*range(3000)]
    assert sorted(run for task in found if task.method == B for run in task.runs) == [*range(3000)]
    lengths = [len(task.runs) for task in sorted(found, key=lambda task: task.first) if task.method == A]
    least, known = 4.0 * sum(each.values()) / (2.0 * b), 2 + 3 * workers
    for n, longest in zip(lengths[known:-1], itertools.accumulate(lengths[known - 1 :], max), strict=False):
        assert n >= min(math.floor(least), longest)
    if least > 3000:
        assert len(lengths) <= known + 3


def test_a_rest_is_no_block():
    """It would take longer than as a part of the block before it."""
    queue = queue_of(1210)
    for n in (100, 200, 400):
        for name in (A, B):
            queue.note(done(Task(name, 0, n), 1e-3, 0.1))
    lengths = []
    while tasks := queue.take_range():
        lengths.append(len(tasks[0].runs))
    assert lengths == [400, 400, 410]


def test_the_first_block_of_a_worker_tells_nothing_of_the_time():
    """It also loads code.  Oracle: the blocks without it."""
    ends = []
    for loads in (True, False):
        queue = queue_of(100_000)
        for n in (10, 100, 300):
            for name in (A, B):
                queue.note(done(Task(name, 0, n), 1e-3, 0.01))
                if loads:
                    queue.note(done(Task(name, 0, 10), 1.0, 5.0, loads=True))
        ends.append(queue.take().stop)
    assert ends[0] == ends[1]


def test_first_blocks_of_many_seconds_count_as_computing():
    """Where every method has one block only, nothing else says that further workers pay."""
    queue = queue_of(100)
    for name in (A, B):
        queue.note(done(Task(name, 0, 2), 2.0, loads=True))
    assert queue.pays(1)


def test_runs_that_take_longer_than_a_block_are_not_doubled():
    """A second length would cost minutes, and tell nothing of use."""
    queue = queue_of(100_000)
    for _ in range(2):
        for task in queue.take_range():
            queue.note(done(task, 20.0))
    assert {len(task.runs) for task in queue.take_range()} == {1}


def test_a_fixed_time_asks_for_ten_seconds_at_most():
    """A block of twice the length in less time shows no slope at all."""
    queue = queue_of(100_000)
    for n, seconds in ((4, 3.0), (8, 2.9), (2000, 6.0)):
        for name in (A, B):
            queue.note(Done(Task(name, 0, n), None, [], seconds))
    (first, *_), costs = queue.take_range(), fitted({4: 3.0, 8: 2.9, 2000: 6.0})
    assert 2 * (costs[0] + costs[1] * len(first.runs)) <= MOST + 0.1


@pytest.mark.parametrize(("a", "b"), [(0.3, 2e-3), (0.0, 1e-2), (1e-4, 3.0)])
def test_times_on_a_line(a, b):
    """The fit finds the line, also from the least of several times."""
    assert fitted({n: a + b * n for n in (7, 20, 90)}) == pytest.approx((a, b), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    "times", [{10: 0.4, 20: 0.3}, {10: 0.1, 20: 0.5}, {10: 0.1, 11: 0.4, 80: 0.2}, {3: 0.2}, {8: 7.2e-5, 3: 3937.0}]
)
def test_times_on_no_line(times):
    """Neither is below 0; no other line of this kind has smaller relative errors.  Oracle: a grid around it."""

    def errors(a, b):
        return sum((1.0 - (a + b * n) / t) ** 2 for n, t in times.items())

    a, b = fitted(times)
    assert a >= 0.0 and b > 0.0
    steps = (0.9, 1.0, 1.1)
    assert errors(a, b) <= min(errors(x * a, y * b) for x in steps for y in steps) + 1e-9


def test_a_sweep_costs_as_much_per_point_as_a_point(monkeypatch):
    """Oracle: the order of a list that is sorted; and the number of operations of the queue."""
    pushed, push = [], blocks.heapq.heappush
    monkeypatch.setattr(blocks.heapq, "heappush", lambda *entry: pushed.append(entry) or push(*entry))
    n_points = 300
    tasks = [Task(name, 0, 20, point) for point in range(n_points) for name in (A, B)]
    queue = TaskQueue(tasks, BlockLengths([MADE] * n_points, 10))
    expected = sorted((first, point, name) for point in range(n_points) for name in (A, B) for first in (0, 10))
    assert [(task.first, task.point, task.method) for task in iter(queue.take, None)] == expected
    assert len(pushed) == 2 * len(expected)


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
@pytest.mark.long
def test_workers_start_where_they_pay(seconds_of_a_run, grows, expected):
    """With a long rest, also where it is not known yet how long; the queue has then 200 trials at a time."""
    queue, calls = queue_of(100 if grows else 3000), []

    def workers(experiments, queue):
        calls.append(len(queue))
        while (task := queue.take(1)) is not None:
            yield done(task, seconds_of_a_run)

    n = 0
    for each in here_first([MADE], queue, workers):
        n += len(each.task.runs)
        queue.note(done(each.task, seconds_of_a_run))
        if not len(queue) and grows:
            first = each.task.stop
            queue.add(Task(name, first, first + 100) for name in (A, B))
            grows -= 1
    assert len(calls) == expected
    assert n == (2000 if (expected and queue.has_grown) else 6000)
