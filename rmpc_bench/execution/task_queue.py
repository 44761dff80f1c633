"""The tasks of an experiment that are not handed out yet; an engine takes them one by one."""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Collection, Hashable, Iterable
from itertools import count

from rmpc_bench.execution.block_lengths import BlockLengths, Pair
from rmpc_bench.execution.engines.tasks import Done, Task


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
        self._ranges = [entry for entry in self._ranges if entry not in chosen]
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
