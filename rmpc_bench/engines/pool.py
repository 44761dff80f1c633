"""Worker processes that do tasks; a process that ends is replaced, and what it had not finished is repeated."""

from __future__ import annotations

import errno
import math
import os
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from multiprocessing.connection import wait
from pathlib import Path
from typing import TypeAlias

from rmpc_bench.child_process import held
from rmpc_bench.components.transport import dumps
from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.tasks import Done, Task, failed, has_own_code
from rmpc_bench.engines.watch import Limits
from rmpc_bench.engines.workers import (
    HUNG,
    HUNG_WITH_OWN_CODE,
    LONGEST_PAUSE,
    MAX_KILLED_STARTS,
    MAX_STARTS,
    End,
    Failed,
    Job,
    WorkerProcess,
    after,
)
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types.errors import WorkerError

WAITING, MOST_WAITING = 2, 16
"""Tasks in a worker: one that it does, and one that it finds when it has done that; more where they are short."""
AHEAD = 0.2
"""Time of the tasks in a worker, which does not wait while this process commits results [s]."""
SILENT = 4.0
"""Time without a result after which a further worker starts [s]."""

_NO_MORE = frozenset({errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ENOMEM})
"""Errors of the system where too many files are open or too many processes run."""
Note: TypeAlias = Callable[[str, End], None]
"""Takes a line about the end of a worker, and the end."""


class Pool:
    """Worker processes and the jobs that are left; `data` are the experiments as bytes.

    The output of components goes to files in `logs`, without them to the screen.  A worker is replaced after the time
    `patience` [s] without any computing, and `note` gets a line and its end.
    """

    def __init__(
        self,
        data: bytes,
        limits: Limits,
        logs: Path | None,
        patience: float = HUNG,
        note: Note = lambda text, end: None,  # noqa: E731
    ) -> None:
        self._data, self._limits, self._logs, self._patience, self._note = data, limits, logs, patience, note
        self._left = deque[Job]()
        self._workers: dict[int, WorkerProcess] = {}
        self._failed_starts = self._killed_starts = 0
        self._cancelled, self._seconds = False, AHEAD
        # When the last message has arrived.
        self._heard = math.inf

    def start(self, numbers: Sequence[int]) -> None:
        """Start workers, each in place of an earlier one with its number."""
        for number in numbers:
            log = self._log(number)
            try:
                self._workers[number] = WorkerProcess(self._data, self._limits, log, self._patience)
            except OSError as error:
                if error.errno not in _NO_MORE:
                    raise
                text = f"cannot start worker {number + 1}: {error.strerror}; give fewer workers (--jobs)"
                raise WorkerError(text) from None
            # `cancel` of another thread may have seen those before them only.
            if self._cancelled:
                self._workers[number].kill()

    def _log(self, number: int) -> Path | None:
        """Return the file that gets the output of components."""
        if self._logs is None or self._logs == Path(os.devnull):
            return self._logs
        return self._logs / f"worker-{number + 1}.txt"

    def cancel(self) -> None:
        """End all workers, from another thread than that which takes the results; it gets a WorkerError."""
        self._cancelled = True
        for worker in [*self._workers.values()]:
            worker.kill()

    def close(self) -> None:
        """End all workers."""
        for worker in self._workers.values():
            worker.close()

    def results(self, queue: TaskQueue, jobs: Sequence[Job] = (), workers: int = 1) -> Iterator[Done | Failed]:
        """Yield finished parts of tasks until nothing is left; start up to so many workers where they save time."""
        self._left.extend(jobs)
        while True:
            self._grow(queue, workers)
            self._feed(queue)
            if not any(worker.jobs for worker in self._workers.values()):
                return
            ready = wait([worker.connection for worker in self._workers.values()], self._pause())
            for number, worker in [*self._workers.items()]:
                if worker.connection in ready:
                    try:
                        messages = worker.receive()
                    except EOFError:
                        if self._cancelled:
                            raise WorkerError("the computation was cancelled") from None
                        yield from self._replace(number)
                    else:
                        for message in messages:
                            yield from self._handle(worker, message)
                else:
                    worker.check()

    def _pause(self) -> float:
        """Return how long to wait for a message before the workers are checked [s]."""
        if not self._limits.timed:
            return LONGEST_PAUSE
        shortest = min(limit for limit in (self._limits.step, self._limits.run) if limit is not None)
        return min(max(shortest / 4.0, 0.01), 0.25)

    def _grow(self, queue: TaskQueue, most: int) -> None:
        while len(self._workers) < most and len(queue):
            # The time of a method is not known while its first block takes very long.
            if not (queue.pays(len(self._workers)) or time.monotonic() - self._heard > SILENT):
                break
            self.start([len(self._workers)])
            self._heard = time.monotonic()
        queue.workers = len(self._workers)

    def _feed(self, queue: TaskQueue) -> None:
        most = min(max(WAITING, math.ceil(AHEAD / max(self._seconds, 1e-3))), MOST_WAITING)
        if len(queue) < 2 * most * len(self._workers):
            # All workers are to end at the same time.
            most = WAITING
        for n_waiting in range(1, most + 1):
            for number, worker in self._workers.items():
                if n_waiting > 1 and queue.is_shared:
                    return
                if len(worker.jobs) < n_waiting and (job := self._next(queue, number)) is not None:
                    worker.give(job)

    def _next(self, queue: TaskQueue, number: int) -> Job | None:
        """Return a job of a worker that has ended, else the next task."""
        if self._left:
            return self._left.popleft()
        task = queue.take(number)
        return None if task is None else Job(task)

    def _handle(self, worker: WorkerProcess, message: Done | str | None) -> Iterator[Done]:
        """Take a result, or the end of a task, or the report of a worker that it has loaded the experiment or not."""
        self._heard = time.monotonic()
        if isinstance(message, str):
            raise WorkerError(f"worker processes cannot load the experiment: {message}")
        if isinstance(message, Done):
            # A mean in which the last ten count most.
            self._seconds += 0.1 * (message.seconds - self._seconds)
            job = worker.jobs[0]
            worker.jobs[0] = Job(job.task._replace(first=message.task.stop), job.alone)
            yield message
        elif worker.loaded:
            worker.jobs.popleft()
        else:
            worker.loaded, self._failed_starts, self._killed_starts = True, 0, 0

    def _replace(self, number: int) -> Iterator[Failed]:
        """Start a new worker in place of one that has ended, and repeat what that one was doing."""
        ended = self._workers[number]
        end, jobs = ended.end(), ended.jobs
        self._say(number, ended.pid, jobs[0] if jobs and ended.loaded else None, end)
        if not ended.loaded:
            self._count_start(end)
            self._left.extendleft(reversed(jobs))
            jobs.clear()
        self.start([number])
        if jobs:
            job = jobs.popleft()
            self._left.extendleft(reversed(jobs))
            failed, rest = after(job, end)
            if failed is not None:
                yield failed
            if rest is not None:
                self._workers[number].give(rest)

    def _count_start(self, end: End) -> None:
        """Note that a worker has ended before it has loaded the experiment."""
        self._failed_starts += not end.outside
        self._killed_starts += end.outside
        if self._failed_starts == MAX_STARTS or self._killed_starts == MAX_KILLED_STARTS:
            raise WorkerError(f"worker processes cannot load the experiment: {end.message}")

    def _say(self, number: int, process: int, job: Job | None, end: End) -> None:
        """Describe the end of a worker, and the attempt at its job that it ends."""
        text = f"worker {number + 1} (process {process} of {os.uname().nodename}): {end.message}"
        self._note(f"{text}; {described(job)}" if job is not None and job.task.runs else text, end)


def described(job: Job) -> str:
    """Describe a job and the attempt that has ended."""
    task: Task = job.task
    runs = f"run {task.first}" if job.alone or len(task.runs) == 1 else f"runs {task.first} to {task.stop - 1}"
    return f"method {task.method}, {runs}, attempt {job.deaths + job.kills + 1}"


LOG = "workers.txt"
"""File in the directory `logs` with a line for every worker that has ended."""


class EndedWorkers:
    """Writes a line for every worker that has ended, and a message for the first one that was disturbed."""

    def __init__(self, logs: Path, say: Callable[[str], None]) -> None:
        self._file, self._say, self._said = logs / LOG, say, False

    def note(self, text: str, end: End) -> None:
        """Note a worker with the attempt that has ended with it, and how it has ended."""
        # A full disk is reported by the trial store, which matters more.
        with suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            with self._file.open("a", encoding="utf-8") as file:
                file.write(f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ} {text}\n")
        if end.outside and not self._said:
            self._said = True
            text = f"{end.message}, probably by another program or the system"
            self._say(f"{text}; its runs are repeated (further cases are listed in {self._file})")


def processes(
    experiments: Sequence[Experiment],
    queue: TaskQueue,
    workers: int,
    limits: Limits = Limits(),  # noqa: B008 - immutable
    logs: Path | None = None,
    note: Note = lambda text, end: None,
    *,
    gradually: bool = False,
) -> Generator[Done]:
    """Do the tasks in worker processes, which start at once or as they save time; closing the generator ends them."""
    pool = Pool(dumps(experiments), limits, logs, patience(experiments), note)
    try:
        pool.start(range(1 if gradually else workers))
        for each in pool.results(queue, workers=workers):
            yield failed(experiments, *each) if isinstance(each, Failed) else each
    finally:
        with held():
            pool.close()


def patience(experiments: Sequence[Experiment]) -> float:
    """Return the time without any computing after which a worker is replaced [s]."""
    own = any(has_own_code(experiment, method) for experiment in experiments for method in experiment.methods)
    return HUNG_WITH_OWN_CODE if own else HUNG
