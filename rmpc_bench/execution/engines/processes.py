"""The engine with worker processes: a component that ends its process or never returns costs its own runs only.

The parent knows which tasks each worker has.  When a worker dies, or is killed because it takes too long, the rest of
its task is repeated run by run in a new worker.  A run with which a worker dies twice alone is `crashed`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator, Sequence
from multiprocessing.connection import wait
from pathlib import Path

from rmpc_bench.components.transport import dumps
from rmpc_bench.execution.engines.failures import failed
from rmpc_bench.execution.engines.tasks import Done
from rmpc_bench.execution.engines.watch import Limits
from rmpc_bench.execution.engines.worker_process import End, Job, WorkerProcess
from rmpc_bench.execution.interrupts import held
from rmpc_bench.execution.task_queue import TaskQueue
from rmpc_bench.execution.worker_error import WorkerError
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import RunFailure, Status

MAX_DEATHS = 2
"""How often a worker dies with a run alone before the run has crashed."""
MAX_STARTS = 3
"""How many workers may die one after the other before they have loaded the experiment."""
WAITING = 2
"""Tasks in a worker: one that it does, and one that it finds when it has done that."""


def processes(
    experiments: Sequence[Experiment],
    queue: TaskQueue,
    workers: int,
    limits: Limits = Limits(),  # noqa: B008 - immutable
    logs: Path | None = None,
) -> Generator[Done]:
    """Do the tasks in worker processes; closing the generator ends them.

    Parameters
    ----------
    experiments : one per point of the sweep
    queue : what to do
    workers : how many processes
    limits : of time and memory
    logs : directory that gets the output of components; None to let it pass to the screen

    Raises
    ------
    WorkerError
        If the workers cannot load the experiment.
    """
    pool = _Pool(experiments, queue, limits, logs)
    try:
        pool.start(range(workers))
        yield from pool.results()
    finally:
        with held():
            pool.close()


class _Pool:
    """Worker processes and the jobs that are left."""

    def __init__(self, experiments: Sequence[Experiment], queue: TaskQueue, limits: Limits, logs: Path | None) -> None:
        self._experiments, self._limits, self._logs = experiments, limits, logs
        self._data = dumps(experiments)
        self._queue, self._left = queue, deque[Job]()
        self._workers: dict[int, WorkerProcess] = {}
        self._failed_starts = 0

    def start(self, numbers: Sequence[int]) -> None:
        """Start workers, each in place of an earlier one with its number."""
        for number in numbers:
            log = None if self._logs is None else self._logs / f"worker-{number + 1}.txt"
            self._workers[number] = WorkerProcess(self._limits, log)
        # A worker reads its experiments after its imports, which all of them do at the same time.
        for number in numbers:
            self._workers[number].load(self._data)

    def close(self) -> None:
        """End all workers."""
        for worker in self._workers.values():
            worker.close()

    def results(self) -> Iterator[Done]:
        """Yield finished parts of tasks until nothing is left."""
        while True:
            self._feed()
            if not any(worker.jobs for worker in self._workers.values()):
                return
            ready = wait([worker.connection for worker in self._workers.values()], self._pause())
            for number, worker in [*self._workers.items()]:
                if worker.connection in ready:
                    try:
                        message = worker.receive()
                    except EOFError:
                        yield from self._replace(number)
                    else:
                        yield from self._handle(worker, message)
                elif self._limits.timed:
                    worker.check_time()

    def _pause(self) -> float | None:
        """Return how long to wait for a message before the times are checked [s]."""
        if not self._limits.timed:
            return None
        shortest = min(limit for limit in (self._limits.step, self._limits.run) if limit is not None)
        return min(max(shortest / 4.0, 0.01), 0.25)

    def _feed(self) -> None:
        for n_waiting in range(1, WAITING + 1):
            for worker in self._workers.values():
                if len(worker.jobs) < n_waiting and (job := self._next()) is not None:
                    worker.give(job)

    def _next(self) -> Job | None:
        """Return a job of a worker that has died, else the next task."""
        if self._left:
            return self._left.popleft()
        task = self._queue.take()
        return None if task is None else Job(task)

    def _handle(self, worker: WorkerProcess, message: Done | str | None) -> Iterator[Done]:
        """Take a result, or the end of a task, or the report of a worker that it has loaded the experiment or not."""
        if isinstance(message, str):
            raise WorkerError(f"worker processes cannot load the experiment: {message}")
        if isinstance(message, Done):
            job = worker.jobs[0]
            worker.jobs[0] = Job(job.task._replace(first=message.task.stop), job.alone)
            yield message
        elif worker.loaded:
            worker.jobs.popleft()
        else:
            worker.loaded, self._failed_starts = True, 0

    def _replace(self, number: int) -> Iterator[Done]:
        """Start a new worker in place of a dead one, and repeat what that one was doing."""
        dead = self._workers[number]
        end, jobs = dead.end(), dead.jobs
        if not dead.loaded:
            self._failed_starts += 1
            if self._failed_starts == MAX_STARTS:
                raise WorkerError(f"worker processes cannot load the experiment: {end.message}")
            self._left.extendleft(reversed(jobs))
            jobs.clear()
        self.start([number])
        if jobs:
            job = jobs.popleft()
            self._left.extendleft(reversed(jobs))
            yield from self._repeat(self._workers[number], job, end)

    def _repeat(self, worker: WorkerProcess, job: Job, end: End) -> Iterator[Done]:
        """Give the rest of a task to a fresh worker, run by run, without a run that has failed."""
        task, deaths = job.task, job.deaths
        if not task.runs:
            return
        if job.alone or len(task.runs) == 1:
            deaths += 1
            if end.timed_out or deaths == MAX_DEATHS:
                status = Status.TIMEOUT if end.timed_out else Status.CRASHED
                failure = RunFailure(task.first, int(status), "", end.k, end.message, end.trace)
                yield failed(self._experiments, task._replace(stop=task.first + 1), failure)
                task, deaths = task._replace(first=task.first + 1), 0
        if task.runs:
            worker.give(Job(task, True, deaths))
