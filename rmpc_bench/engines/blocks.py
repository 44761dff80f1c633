"""Lengths of blocks: about half a second of work, known from the blocks that are finished.

Results do not depend on the lengths.  A short block costs time between blocks, and a long one is lost as a whole when
the experiment is interrupted.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Collection, Hashable, Iterable, Sequence
from itertools import count

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.engines.tasks import Done, Task, has_own_code
from rmpc_bench.simulation.ensemble import SIZE
from rmpc_bench.simulation.scenario import Experiment

SECONDS = 0.5
"""Time of a block of the slowest method [s]."""
FIRST = 0.1
"""The same before anything is measured [s]; the time is then estimated."""
LEAST = 0.1
"""Shorter blocks are not made to keep all workers busy until the end [s]."""
GROWTH = 8
"""Factor by which a block may be longer than the longest one of its method that is finished."""
MEGABYTES = 32.0
"""Largest memory of the trajectories of a block [MB]."""
STEP_OF_A_BLOCK, STEP_OF_A_RUN = 5e-5, 2.5e-6
"""Time of a step, per block and per run [s], to the second of which slow designs add their `cost_per_step`."""
STEP_OF_OWN_CODE = 1e-4
"""Time of a step of a run [s] with a component of the user that states no `cost_per_step`."""
OVERHEAD = 5e-4
"""Time of a step of a block of built-in components besides that of its runs [s], at most."""
REMEMBERED = 3
"""Blocks of a method whose shortest time of a run counts."""
_MEGABYTES_PER_NUMBER = 8e-6

Pair = tuple[int, str]
"""Index of a point of the sweep, and name of a method."""


def estimated_seconds(experiment: Experiment, method: str) -> float:
    """Estimate the time of a run in a long block [s]."""
    pair = experiment.method(method)
    cost = sum(design.cost_per_step for design in (experiment.plant, pair.estimator, pair.controller))
    if not cost and has_own_code(experiment, pair):
        cost = STEP_OF_OWN_CODE
    return experiment.n_steps * (STEP_OF_A_RUN + cost)


def megabytes_of_a_run(experiment: Experiment) -> float:
    """Return the memory of a run in a block [MB]: twice the trajectories x, x_hat, w, v, y and u."""
    plant = experiment.plant
    width = 2 * plant.nx + plant.nw + plant.nv + plant.ny + plant.nu
    return 2 * _MEGABYTES_PER_NUMBER * experiment.n_steps * width


def usual_length(experiment: Experiment, method: str, fixed: int | None = None) -> int:
    """Return the number of runs of a long block of a method, before anything is measured."""
    if fixed is not None:
        return fixed
    longest = min(SECONDS / estimated_seconds(experiment, method), MEGABYTES / megabytes_of_a_run(experiment))
    return min(max(1, math.floor(longest)), experiment.n_runs)


class BlockLengths:
    """Lengths of the next blocks.

    Parameters
    ----------
    experiments : one per point of the sweep
    fixed : number of runs of every block; None to choose it by time
    """

    def __init__(self, experiments: Sequence[Experiment], fixed: int | None = None) -> None:
        self.seconds = SECONDS
        """Time of a block of the slowest method [s]."""
        self._experiments, self._fixed = experiments, fixed
        self._times: dict[Pair, deque[float]] = {}
        self._measured: dict[Pair, float] = {}
        self._longest: dict[Pair, int] = {}
        self._estimated: dict[Pair, float] = {}
        # Measured by estimated time of what is measured.
        self._correction: float | None = 1.0

    def note(self, done: Done) -> None:
        """Note how long a task, or a part of one, has taken."""
        pair, n = (done.task.point, done.task.method), len(done.task.runs)
        # A run that has failed outside of the simulation has no time.
        if done.seconds > 0.0 and n:
            times = self._times.setdefault(pair, deque(maxlen=REMEMBERED))
            times.append(done.seconds / n)
            # The first block of a process loads compiled code, and other programs delay a block: both only add time.
            self._measured[pair] = min(times)
            self._longest[pair] = max(n, self._longest.get(pair, 0))
            self._correction = None

    def is_measured(self, pair: Pair) -> bool:
        """Whether a block of a method is finished."""
        return pair in self._measured

    def seconds_of_a_run(self, pair: Pair) -> float:
        """Return the time of a run [s]: measured, or estimated and corrected by what is measured of others."""
        if pair in self._measured:
            return self._measured[pair]
        if self._correction is None:
            self._correction = sum(self._measured.values()) / sum(map(self._estimate, self._measured))
        return self._estimate(pair) * self._correction

    def stop(self, first: int, pairs: Collection[Pair], seconds_left: float, workers: int) -> int:
        """Return the end of the block that begins with a run, from the time of all runs that are not handed out [s]."""
        if self._fixed is not None:
            return (first // self._fixed + 1) * self._fixed
        times = [max(self.seconds_of_a_run(pair), 1e-9) for pair in pairs]
        seconds = self.seconds
        if workers > 1:
            # Towards the end the blocks become shorter, so that all workers end at the same time.
            seconds = min(seconds, max(seconds_left / (2 * workers) * max(times) / sum(times), LEAST))
        lengths = [seconds / max(times), *(self._bound(pair) for pair in pairs)]
        stop = first + max(1, math.floor(min(lengths)), min(map(self._least, pairs)))
        # Groups of runs whose moments are kept are whole in long blocks.
        return stop - stop % SIZE if stop - first >= SIZE else stop

    def _least(self, pair: Pair) -> int:
        """Return the number of runs below which a block is hardly faster, because its steps cost most of the time.

        Without it, blocks that take too long only because of their number of steps would shrink to single runs.
        """
        experiment = self._experiments[pair[0]]
        if has_own_code(experiment, experiment.method(pair[1])):
            return 1
        runs = OVERHEAD * experiment.n_steps / max(self._estimate(pair), 1e-9)
        return math.floor(min(runs, SIZE, MEGABYTES / max(megabytes_of_a_run(experiment), 1e-9)))

    def _bound(self, pair: Pair) -> float:
        """Return the largest number of runs that memory and experience allow."""
        memory = MEGABYTES / max(megabytes_of_a_run(self._experiments[pair[0]]), 1e-9)
        if pair in self._longest:
            return min(memory, GROWTH * self._longest[pair])
        return min(memory, FIRST / max(self.seconds_of_a_run(pair), 1e-9))

    def _estimate(self, pair: Pair) -> float:
        if pair not in self._estimated:
            self._estimated[pair] = estimated_seconds(self._experiments[pair[0]], pair[1])
        return self._estimated[pair]


class TaskQueue:
    """Ranges of runs in the order in which they are to be computed, cut into blocks when they are taken.

    All methods of a range follow each other, so that the trials of an interrupted experiment can be compared.  One
    worker gets them as long as there are other ranges, since it draws the random inputs of the range once.

    Parameters
    ----------
    tasks : what is to be computed; ranges of any length where there are lengths
    lengths : lengths of the blocks; None to hand out the tasks as they are
    """

    def __init__(self, tasks: Iterable[Task] = (), lengths: BlockLengths | None = None) -> None:
        self.workers = 1
        """How many workers share the tasks; an engine sets it."""
        self.seconds_done = 0.0
        """Computing time of what is finished [s]."""
        self.has_grown = False
        """Whether tasks were added after the first one was handed out; more may follow."""
        self._lengths = lengths
        self._numbers = count()
        # Sorted by first run, then by the order in which the tasks were added.
        self._ranges: list[tuple[int, int, Task]] = []
        # Worker -> what is left of the range of runs that it has begun.
        self._begun: dict[Hashable, deque[Task]] = {}
        self._left = Counter[Pair]()
        self.add(tasks)

    def __len__(self) -> int:
        """How many ranges and tasks are not handed out; 0 only if nothing is left."""
        return len(self._ranges) + sum(map(len, self._begun.values()))

    @property
    def n_trials(self) -> int:
        """How many trials are not handed out."""
        return self._left.total()

    @property
    def seconds_left(self) -> float:
        """Estimated computing time of what is not handed out [s]; 0 where the tasks have no lengths."""
        if self._lengths is None:
            return 0.0
        return sum(n * self._lengths.seconds_of_a_run(pair) for pair, n in self._left.items() if n)

    def take(self, worker: Hashable = None) -> Task | None:
        """Hand out the next task, all methods of a range to one worker; None if there is none now."""
        group = self._begun.get(worker)
        if not group:
            group = self._begun[worker] = self._next_group()
        if group:
            task = group.popleft()
        else:
            # Nothing else is left: the last task of the worker that has most of them.
            longest = max(self._begun.values(), key=len)
            if not longest:
                return None
            task = longest.pop()
        self._left[task.point, task.method] -= len(task.runs)
        return task

    def take_range(self) -> list[Task]:
        """Hand out the tasks of all methods of the next range of runs; empty if there is none now."""
        tasks: list[Task] = []
        worker = object()
        self._begun[worker] = self._next_group()
        while self._begun[worker] and (task := self.take(worker)) is not None:
            tasks.append(task)
        del self._begun[worker]
        return tasks

    def part(self, pairs: Collection[Pair]) -> TaskQueue:
        """Hand out all tasks of some methods, given with the numbers of their points, as a queue of their own."""
        chosen = [entry for entry in self._ranges if (entry[2].point, entry[2].method) in pairs]
        self._ranges = [entry for entry in self._ranges if (entry[2].point, entry[2].method) not in pairs]
        heapq.heapify(self._ranges)
        for *_, task in chosen:
            self._left[task.point, task.method] -= len(task.runs)
        return TaskQueue((task for *_, task in sorted(chosen)), self._lengths)

    @property
    def is_measured(self) -> bool:
        """Whether a block of every method that is left has been finished."""
        left = [pair for pair, n in self._left.items() if n]
        return self._lengths is not None and all(map(self._lengths.is_measured, left))

    def seconds_of(self, tasks: Iterable[Task]) -> float:
        """Return the computing time of tasks [s]; infinite where a block of their method has not been finished."""
        lengths, total = self._lengths, 0.0
        for task in tasks:
            pair = (task.point, task.method)
            if lengths is None or not lengths.is_measured(pair):
                return math.inf
            total += len(task.runs) * lengths.seconds_of_a_run(pair)
        return total

    def give_back(self, worker: Hashable = None) -> None:
        """Take back what is left of the range that a worker has begun and will not finish."""
        for task in self._begun.pop(worker, ()):
            self._put(task)

    def add(self, tasks: Iterable[Task]) -> None:
        """Add tasks, also while an engine works; tasks of smaller runs are handed out first."""
        self.has_grown = bool(self._begun)
        for task in tasks:
            if task.runs:
                self._put(task)
                self._left[task.point, task.method] += len(task.runs)

    def _put(self, task: Task) -> None:
        number = next(self._numbers)
        heapq.heappush(self._ranges, (task.first if self._lengths else number, number, task))

    def note(self, done: Done) -> None:
        """Note that a task, or a part of one, is finished and how long it has taken."""
        self.seconds_done += done.seconds
        if self._lengths is not None:
            self._lengths.note(done)

    def at_least(self, seconds: float) -> None:
        """Make blocks of the slowest method that take a time [s], unless their length is fixed."""
        if self._lengths is not None:
            self._lengths.seconds = max(self._lengths.seconds, seconds)

    def _next_group(self) -> deque[Task]:
        """Cut the next range of runs off, for all methods at its point."""
        if not self._ranges:
            return deque()
        if self._lengths is None:
            return deque([heapq.heappop(self._ranges)[2]])
        first, _, head = self._ranges[0]
        pairs = [pair for pair, n in self._left.items() if n and pair[0] == head.point]
        stop = self._lengths.stop(first, pairs, self.seconds_left, self.workers)
        found, others = [], []
        while self._ranges and self._ranges[0][0] < stop:
            _, number, task = heapq.heappop(self._ranges)
            if task.point != head.point:
                others.append((task.first, number, task))
                continue
            found.append((number, task._replace(stop=min(stop, task.stop))))
            if task.stop > stop:
                others.append((stop, number, task._replace(first=stop)))
        for entry in others:
            heapq.heappush(self._ranges, entry)
        return deque(task for _, task in sorted(found))


START = 2.0
"""Starting and reporting [s]."""


def seconds_of(config: ExperimentConfig) -> float:
    """Estimate the computing time [s]; trials that points of a sweep share count once."""
    seen, total = set[str](), 0.0
    for point in config.points if "runs" in config.evaluate else ():
        experiment = point.experiment
        for name, key in point.method_keys.items():
            if key not in seen:
                n_blocks = math.ceil(experiment.n_runs / usual_length(experiment, name, config.execution.fixed_block))
                total += STEP_OF_A_BLOCK * experiment.n_steps * n_blocks
                total += estimated_seconds(experiment, name) * experiment.n_runs
            seen.add(key)
    return math.ceil(START + (total + tuning_seconds(config)) / config.execution.workers)


def tuning_seconds(config: ExperimentConfig) -> float:
    """Estimate the computing time of what is to be tuned on one process [s]."""
    if config.tuning is None:
        return 0.0
    total, seen, protocol = 0.0, set[str](), config.tuning.protocol
    n_tested = (protocol.budget + 1) * config.tuning.test_runs if config.tuning.regret else 0
    for search in config.tuning.missing:
        if search.key not in seen:
            experiment = config.points[search.number].experiment
            n_runs = protocol.budget * protocol.runs + n_tested
            n_blocks = n_runs / usual_length(experiment, search.method, config.execution.fixed_block) + protocol.budget
            total += STEP_OF_A_BLOCK * experiment.n_steps * n_blocks
            total += estimated_seconds(experiment, search.method) * n_runs
        seen.add(search.key)
    return total


def megabytes_of(config: ExperimentConfig) -> float:
    """Estimate the memory of a process [MB]: twice the trajectories x, x_hat, w, v, y and u of a block."""
    experiment, fixed = config.experiment, config.execution.fixed_block
    longest = max(usual_length(experiment, method.name, fixed) for method in experiment.methods)
    return math.ceil(longest * megabytes_of_a_run(experiment))
