"""Lengths of blocks: about half a second of work, known from the blocks that are finished.

Results do not depend on the lengths.  A block of n runs takes a time a + b n.  Short blocks spend most of it in a, and
a long one is lost as a whole when the experiment is interrupted.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter, defaultdict, deque
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
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
LONG = 4.0
"""Least number of runs of a block by a / b: a is then at most 20 % of its time."""
LOADING = 2.0
"""Time of the first block of a method in a process that may go into loading code [s]."""
MOST = 10.0
"""Time of a block that `LONG` asks for, at most [s]."""
MEASURED = 1.0
"""Computing time after which the time of what is left is known [s]."""
PAYS = 2.0
"""Time that a further worker must save [s], about twice that of its start."""
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
    """Lengths of the next blocks: a fixed number of runs, or chosen by time; one experiment per point of the sweep."""

    def __init__(self, experiments: Sequence[Experiment], fixed: int | None = None) -> None:
        self.seconds = SECONDS
        """Time of a block of the slowest method [s]."""
        self.seconds_done = defaultdict[str, float](float)
        """Computing time of what is finished of a method, without what may have gone into loading code."""
        self._experiments, self._fixed = experiments, fixed
        # Octave of lengths -> the block that took least per run, as number of runs and time.
        self._blocks: dict[Pair, dict[int, tuple[int, float]]] = {}
        # a and b of a block of n runs, which takes a + b n.
        self._costs: dict[Pair, tuple[float, float]] = {}
        self._longest: dict[Pair, int] = {}
        self._estimated: dict[Pair, float] = {}
        # Times of a run of a method, summed over the points where it is measured.
        self._measured, self._expected = defaultdict[str, float](float), defaultdict[str, float](float)

    def note(self, done: Done) -> None:
        """Note how long a task, or a part of one, has taken."""
        name, pair, n = done.task.method, (done.task.point, done.task.method), len(done.task.runs)
        # A run that has failed outside of the simulation has no time.
        if done.seconds > 0.0 and n:
            block, blocks = (n, done.seconds), self._blocks.setdefault(pair, {})
            self.seconds_done[name] += max(done.seconds - LOADING, 0.0) if done.loads else done.seconds
            if not done.loads:
                # Other programs only add time.
                octave = n.bit_length()
                blocks[octave] = min(block, blocks.get(octave, block), key=lambda each: each[1] / each[0])
            before = self._seconds_of_a_run(pair)
            self._costs[pair] = fitted(dict(blocks.values() or [block]))
            self._longest[pair] = max(n, self._longest.get(pair, 0))
            self._expected[name] += 0.0 if before else self.estimate(pair)
            self._measured[name] += self._seconds_of_a_run(pair) - before

    def ratio(self, method: str) -> float:
        """Return measured by estimated time of a method, or of all methods where it is not measured."""
        if self._expected[method]:
            return self._measured[method] / self._expected[method]
        return sum(self._measured.values()) / total if (total := sum(self._expected.values())) else 1.0

    def seconds_of(self, task: Task) -> float:
        """Return the time of a block [s]; infinite where none of its method has been finished."""
        fixed, each = self._costs.get((task.point, task.method), (math.inf, 0.0))
        return fixed + each * len(task.runs)

    def stop(self, first: int, end: int, pairs: Collection[Pair], seconds_left: float, workers: int) -> int:
        """Return the end of the block that begins a range of runs, from the time of all that is not handed out [s]."""
        if self._fixed is not None:
            return (first // self._fixed + 1) * self._fixed
        costs = [self._cost(pair) for pair in pairs]
        fixed, slowest = sum(a for a, _ in costs), max(b for _, b in costs)
        each, seconds = sum(b for _, b in costs), self.seconds
        if workers > 1:
            # Towards the end the blocks become shorter, so that all workers end at the same time.
            seconds = min(seconds, max(seconds_left / (2 * workers) * slowest / each, LEAST))
        most = max(1.0, min(map(self._most, pairs)))
        least = max(1.0, min(LONG * fixed, MOST - fixed) / each, *map(self._tried, pairs))
        wanted = min((seconds - a) / b for a, b in costs)
        # The fit rounds.
        stop = first + math.floor(min(max(wanted, least), most) + 1e-6)
        if stop - first >= SIZE:
            # Groups of runs whose moments are kept are whole in long blocks.
            whole = stop - stop % SIZE
            stop = next((at for at in (whole, whole + SIZE) if least <= at - first <= most), stop)
        # The rest of the range, if it would spend most of its time in a.
        return end if end - stop < fixed / each and end - first <= most else stop

    def _cost(self, pair: Pair) -> tuple[float, float]:
        """Return a and b of a method [s]: measured, or estimated and corrected by what is measured of others."""
        if pair in self._costs:
            return self._costs[pair]
        ratio = self.ratio(pair[1])
        return ratio * STEP_OF_A_BLOCK * self._experiments[pair[0]].n_steps, ratio * self.estimate(pair)

    def _seconds_of_a_run(self, pair: Pair) -> float:
        """Return the time of a run in the blocks that are to come [s]; 0 where it is not measured."""
        fixed, each = self._costs.get(pair, (0.0, 0.0))
        return each + min(fixed / self._longest.get(pair, 1), each / LONG)

    def _tried(self, pair: Pair) -> int:
        """Return the least number of runs with which a second length becomes known, without which no fit shows a."""
        known = len(self._blocks.get(pair, ()))
        is_slow = self._seconds_of_a_run(pair) > self.seconds
        return (1 + known) * self._longest[pair] if pair in self._longest and known < 2 and not is_slow else 0

    def _most(self, pair: Pair) -> float:
        """Return the largest number of runs that memory and experience allow."""
        memory = MEGABYTES / max(megabytes_of_a_run(self._experiments[pair[0]]), 1e-9)
        if pair in self._longest:
            return min(memory, GROWTH * self._longest[pair])
        # While the first block is computed the next one may begin, which is not shorter.
        fixed, each = self._cost(pair)
        return min(memory, max(FIRST * self.ratio(pair[1]), LONG * fixed) / each)

    def estimate(self, pair: Pair) -> float:
        """Return the time of a run in a long block [s] before anything is measured."""
        if pair not in self._estimated:
            self._estimated[pair] = estimated_seconds(self._experiments[pair[0]], pair[1])
        return self._estimated[pair]


def fitted(times: Mapping[int, float]) -> tuple[float, float]:
    """Return a and b [s] of the times of some lengths: a >= 0, b > 0, least squares of the relative errors."""
    zero, one, two = (sum(n**power / t**2 for n, t in times.items()) for power in range(3))
    sums = [sum(n**power / t for n, t in times.items()) for power in range(2)]
    alone, determinant = sums[1] / two, zero * two - one**2
    # Rounding may leave nothing of the determinant.
    each = (zero * sums[1] - one * sums[0]) / determinant if len(times) > 1 and determinant > 0.0 else alone
    # A longer block that took less time shows no slope: almost all of it is a.
    each = min(max(each, 1e-9), alone)
    return max(sums[1] - each * two, 0.0) / one, each


class TaskQueue:
    """Ranges of runs in the order in which they are to be computed, cut into blocks when they are taken.

    All methods of a range follow each other, so that the trials of an interrupted experiment can be compared.  One
    worker gets them as long as there are other ranges, since it draws the random inputs of the range once.  Without
    `lengths` the tasks are handed out as they are.
    """

    def __init__(self, tasks: Iterable[Task] = (), lengths: BlockLengths | None = None) -> None:
        self.workers = 1
        """How many workers share the tasks; an engine sets it."""
        self.has_grown = False
        """Whether tasks were added after the first one was handed out; more may follow."""
        self._lengths = lengths
        self._numbers = count()
        # Point -> its tasks, sorted by first run, then by the order in which they were added; and the places
        # of all tasks in this order, also of some that are gone.
        self._ranges = defaultdict[int, list[tuple[int, int, Task]]](list)
        self._places: list[tuple[int, int, int]] = []
        self._n_ranges = 0
        # Worker -> what is left of the range of runs that it has begun.
        self._begun: dict[Hashable, deque[Task]] = {}
        # Runs by point and method, and estimated time by method.
        self._left = defaultdict[int, Counter[str]](Counter)
        self._estimated = defaultdict[str, float](float)
        self.add(tasks)

    def __len__(self) -> int:
        """How many ranges and tasks are not handed out; 0 only if nothing is left."""
        return self._n_ranges + sum(map(len, self._begun.values()))

    @property
    def is_shared(self) -> bool:
        """Whether every range is begun, so that workers share the methods that are left."""
        return not self._n_ranges and len(self) > 0

    @property
    def seconds_left(self) -> float:
        """Estimated computing time of what is not handed out [s]; 0 where the tasks have no lengths."""
        if self._lengths is None:
            return 0.0
        return sum(seconds * self._lengths.ratio(method) for method, seconds in self._estimated.items())

    def pays(self, workers: int) -> bool:
        """Whether a further worker beside so many saves more time than its start takes."""
        done = sum(self._lengths.seconds_done[name] for name in self._estimated) if self._lengths else 0.0
        # With a stopping rule the queue has the tasks up to the next decision only; as many as are done may follow.
        left = self.seconds_left + (done if self.has_grown else 0.0)
        return done > MEASURED and left > PAYS * workers * (workers + 1)

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
        self._count(task, -len(task.runs))
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
        tasks = [task for *_, task in sorted(entry for ranges in self._ranges.values() for entry in ranges)]
        self._ranges.clear()
        self._places.clear()
        self._n_ranges, chosen = 0, []
        for task in tasks:
            if (task.point, task.method) in pairs:
                self._count(task, -len(task.runs))
                chosen.append(task)
            else:
                self._put(task)
        return TaskQueue(chosen, self._lengths)

    def seconds_of(self, tasks: Iterable[Task]) -> float:
        """Return the computing time of tasks [s]; infinite where a block of their method has not been finished."""
        return math.inf if self._lengths is None else sum(map(self._lengths.seconds_of, tasks))

    def give_back(self) -> None:
        """Take back what is left of the range that this process has begun and will not finish."""
        for task in self._begun.pop(None, ()):
            self._put(task)

    def add(self, tasks: Iterable[Task]) -> None:
        """Add tasks, also while an engine works; tasks of smaller runs are handed out first."""
        self.has_grown = bool(self._begun)
        for task in tasks:
            if task.runs:
                self._put(task)
                self._count(task, len(task.runs))

    def _put(self, task: Task) -> None:
        number = next(self._numbers)
        first = task.first if self._lengths else number
        heapq.heappush(self._ranges[task.point], (first, number, task))
        heapq.heappush(self._places, (first, number, task.point))
        self._n_ranges += 1

    def _count(self, task: Task, n: int) -> None:
        self._left[task.point][task.method] += n
        if self._lengths is not None:
            self._estimated[task.method] += n * self._lengths.estimate((task.point, task.method))

    def note(self, done: Done) -> None:
        """Note that a task, or a part of one, is finished and how long it has taken."""
        if self._lengths is not None:
            self._lengths.note(done)

    def at_least(self, seconds: float) -> None:
        """Make blocks of the slowest method that take a time [s], unless their length is fixed."""
        if self._lengths is not None:
            self._lengths.seconds = max(self._lengths.seconds, seconds)

    def _next_group(self) -> deque[Task]:
        """Cut the next range of runs off, for all methods at its point."""
        while self._places:
            first, number, point = heapq.heappop(self._places)
            ranges = self._ranges[point]
            if ranges and ranges[0][:2] == (first, number):
                break
        else:
            return deque()
        if self._lengths is None:
            self._n_ranges -= 1
            return deque([heapq.heappop(ranges)[2]])
        pairs = [(point, name) for name, n in self._left[point].items() if n]
        stop = self._lengths.stop(first, ranges[0][2].stop, pairs, self.seconds_left, self.workers)
        found = []
        while ranges and ranges[0][0] < stop:
            _, number, task = heapq.heappop(ranges)
            self._n_ranges -= 1
            found.append((number, task._replace(stop=min(stop, task.stop))))
            if task.stop > stop:
                self._put(task._replace(first=stop))
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
