"""The engine on a dask cluster: a scheduler that runs already, or workers on this machine.

A future computes all methods of a range of runs, for a second or more.  A dask worker that is lost has been killed or
stopped from outside, since components run in processes of their own there; what it had is repeated, by dask or as new
futures run by run.
"""

from __future__ import annotations

import logging
import math
import os
import signal
import time
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import distributed
from dask import config

from rmpc_bench.child_process import held, is_stopped
from rmpc_bench.components.transport import dumps
from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.dask_worker import KeptPools, Report, Setup, versions
from rmpc_bench.engines.pool import Note, patience
from rmpc_bench.engines.tasks import Done, failed
from rmpc_bench.engines.watch import Limits
from rmpc_bench.engines.workers import MAX_STARTS, STOPPED, End, Failed, Job, after
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types.errors import WorkerError

dask: Any = distributed  # whose classes have no annotations
WINDOW = 4
"""Futures per thread of a dask worker, so that none waits for the client."""
SECONDS = 1.0
"""Least time of a future [s]: the scheduler, the client and the worker need some milliseconds for each."""
WITHOUT = 10.0
"""Time without a worker after which this is said [s]."""
BETWEEN = 1.0
"""Time between two looks at the workers of the cluster [s]."""
CONNECT = 30.0
"""Time for one connection to a scheduler [s]."""
AGAIN = 10.0
"""Time for one connection while the cluster computes [s]."""
PATIENCE = 15.0
"""Time for connecting to a lost scheduler again [s]."""
MAX_RENEWALS = 5
"""How often the connection may be lost before the next result."""


def dask_cluster(
    experiments: Sequence[Experiment],
    queue: TaskQueue,
    workers: int,
    scheduler: str | None = None,
    limits: Limits = Limits(),  # noqa: B008 - immutable
    logs: Path | None = None,
    note: Note = lambda text, end: None,
    say: Callable[[str], None] = lambda text: None,
) -> Generator[Done]:
    """Do the tasks on a dask cluster; closing the generator ends the processes that it has started.

    Without the address of a `scheduler` it starts `workers` on this machine.  The output of components goes to files in
    `logs`, and `note` gets a line and the end of every process that has ended early.  `say` gets a line where a
    scheduler stays without workers.  A WorkerError says that the scheduler cannot be reached, or the workers cannot
    load the experiment.
    """
    queue.at_least(SECONDS)
    where = None if logs is None else logs.absolute()
    setup = Setup(uuid.uuid4().hex, dumps(experiments), limits, where, patience(experiments), versions())
    cluster = _Cluster(setup, scheduler, workers)
    try:
        cluster.connect()
        for each in _Futures(cluster, queue, note, say).results():
            yield failed(experiments, *each) if isinstance(each, Failed) else each
    finally:
        with held():
            cluster.close()


class ExperimentPlugin(distributed.WorkerPlugin):
    """Keeps an experiment on a dask worker as long as the client computes; `local` if that has started the worker."""

    def __init__(self, described: Setup, *, local: bool) -> None:
        self.name = described.key
        self._described, self._local = described, local

    def setup(self, worker: distributed.Worker) -> None:
        """Make what keeps the worker processes of the experiment."""
        if self._local:
            # Ctrl-C in a terminal reaches every process of the group; only the client handles it.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        self.pools = KeptPools(self._described)

    def teardown(self, worker: distributed.Worker) -> None:
        """End the worker processes of the experiment, also those that have a job."""
        self.pools.cancel()


def compute(key: str, jobs: Sequence[Job]) -> Report:
    """Do jobs on a dask worker, which has the plugin of the experiment."""
    plugin = dask.get_worker().plugins.get(key)
    if plugin is None:
        raise WorkerError("the dask worker does not know the experiment")
    report: Report = plugin.pools.compute(jobs)
    return report


class _Cluster:
    """Connection to a scheduler, or to workers on this machine, to which an experiment is described."""

    def __init__(self, setup: Setup, scheduler: str | None, workers: int) -> None:
        self._setup, self._scheduler, self._workers = setup, scheduler, workers
        self._client: Any = None
        self._local: Any = None
        self._stopped: dict[int, float] = {}
        self._settings = ExitStack()
        self.where = scheduler or "this machine"

    def connect(self, seconds: float | None = None) -> None:
        """Connect within a time [s], and describe the experiment to all workers."""
        # A lost scheduler is to be noticed soon, and said here instead of in the log of dask.
        self._settings.close()
        self._settings.enter_context(config.set({"distributed.comm.timeouts.connect": f"{AGAIN} s"}))
        for name in ("distributed", "distributed.client"):
            self._settings.enter_context(dask.utils.silence_logging_cmgr(logging.CRITICAL, name))
        try:
            if self._scheduler is None and self._local is None:
                # An interruption before the assignment would leave processes that nobody ends.
                with held():
                    self._local = dask.LocalCluster(
                        n_workers=self._workers,
                        threads_per_worker=1,
                        host="127.0.0.1",
                        dashboard_address="127.0.0.1:0",
                        memory_limit=0,
                        silence_logs=logging.CRITICAL,
                    )
            self._client = dask.Client(self._scheduler or self._local, set_as_default=False, timeout=seconds or CONNECT)
            plugin = ExperimentPlugin(self._setup, local=self._local is not None)
            self._client.register_plugin(plugin, name=self._setup.key)
        except (OSError, TimeoutError, ValueError) as error:
            raise WorkerError(f"engine dask: no connection to the scheduler at {self.where}: {error}") from None

    @property
    def is_lost(self) -> bool:
        """Whether the client of dask is without its scheduler."""
        return bool(self._client.status != "running")

    def reconnect(self) -> None:
        """Connect to the same scheduler again, which may be starting; WorkerError if it does not answer."""
        until = time.monotonic() + PATIENCE
        while (left := until - time.monotonic()) > 0:
            self._disconnect()
            with suppress(WorkerError):
                return self.connect(left)
            time.sleep(min(1.0, PATIENCE / 10))
        raise WorkerError(
            f"engine dask: the scheduler at {self.where} was lost, and has not answered again for {PATIENCE:g} s; "
            "finished blocks are stored: start a scheduler and give the same command with its address"
        )

    def submit(self, jobs: Sequence[Job]) -> Any:
        """Return a future with the report on jobs."""
        # A worker that is lost is replaced without a limit of retries here: `after` counts them.
        return self._client.submit(compute, self._setup.key, jobs, pure=False)

    def n_threads(self) -> int:
        """Return how many futures the workers can compute at the same time."""
        try:
            return sum(self._client.nthreads().values())
        except (OSError, TimeoutError, ValueError):
            return 0

    def replace_stopped(self) -> Iterator[End]:
        """Kill workers of this machine that are stopped; dask starts others and gives them the jobs."""
        for nanny in self._local.workers.values() if self._local is not None else ():
            process, now = nanny.pid, time.monotonic()
            if process is None or not is_stopped(process):
                self._stopped.pop(process, None)
            elif now - self._stopped.setdefault(process, now) > STOPPED:
                with suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
                yield End("a dask worker was stopped", outside=True)

    def _disconnect(self) -> None:
        if self._client is not None:
            with suppress(Exception):
                self._client.close(timeout=5)
            self._client = None

    def close(self) -> None:
        """End the computation and the workers of this machine."""
        if self._client is not None and self._local is None:
            with suppress(Exception):
                self._client.unregister_worker_plugin(self._setup.key)
        self._disconnect()
        if self._local is not None:
            with suppress(Exception):
                self._local.close(timeout=5)
        self._settings.close()


class _Futures:
    """The futures that are not finished, and the jobs that are left; see `dask_cluster` for `note` and `say`."""

    def __init__(
        self, cluster: _Cluster, queue: TaskQueue, note: Note, say: Callable[[str], None] = lambda text: None
    ) -> None:
        self._cluster, self._queue, self._note, self._say = cluster, queue, note, say
        self._left = deque[list[Job]]()
        self._jobs: dict[str, tuple[Any, list[Job]]] = {}
        self._ready = SimpleQueue[Any]()
        self._n_threads, self._looked, self._seen = 0, -BETWEEN, time.monotonic()
        self._errors = self._renewals = 0

    def results(self) -> Iterator[Done | Failed]:
        """Yield finished parts of tasks until nothing is left."""
        while True:
            self._look()
            self._submit()
            if not self._jobs:
                return
            with suppress(Empty):
                future = self._ready.get(timeout=BETWEEN)
                if future.key in self._jobs:
                    yield from self._handle(*self._jobs.pop(future.key))

    def _look(self) -> None:
        now = time.monotonic()
        if now - self._looked < BETWEEN:
            return
        self._looked = now
        if self._cluster.is_lost:
            self._renew([])
        self._n_threads = self._cluster.n_threads()
        self._queue.workers = max(self._n_threads, 1)
        if self._n_threads:
            self._seen = now
        elif now - self._seen > WITHOUT:
            self._seen = math.inf  # said once
            self._say(f"engine dask: the scheduler at {self._cluster.where} has no workers; waiting for one")
        for end in self._cluster.replace_stopped():
            self._note(end.message, end)

    def _submit(self) -> None:
        while len(self._jobs) < WINDOW * max(self._n_threads, 1):
            jobs = self._left.popleft() if self._left else self._next()
            if not jobs:
                return
            future = self._cluster.submit(jobs)
            self._jobs[future.key] = future, jobs
            future.add_done_callback(self._ready.put)

    def _next(self) -> list[Job]:
        """Take all methods of a range of runs, and further ranges where they take less than a second together."""
        tasks = self._queue.take_range()
        shared = self._queue.seconds_left / (2 * self._queue.workers)
        while tasks and self._queue.seconds_of(tasks) < min(SECONDS, shared):
            more = self._queue.take_range()
            if not more:
                break
            tasks += more
        return [Job(task) for task in tasks]

    def _handle(self, future: Any, jobs: list[Job]) -> Iterator[Done | Failed]:
        """Take the report of a future, or repeat its jobs."""
        if future.status == "cancelled":
            self._renew(jobs)
            return
        try:
            report: Report = future.result(timeout=60)
        except distributed.KilledWorker:
            yield from self._repeat(jobs, End("the dask workers that had the run were lost", outside=True))
        except (distributed.CancelledError, TimeoutError):
            self._renew(jobs)
        except WorkerError:
            raise
        except Exception as error:
            if self._cluster.is_lost:
                self._renew(jobs)
                return
            self._errors += 1
            if self._errors == MAX_STARTS:
                raise WorkerError(f"engine dask: {type(error).__name__}: {error}") from None
            yield from self._repeat(jobs, End(f"a dask worker failed: {type(error).__name__}: {error}", outside=True))
        else:
            self._errors = self._renewals = 0
            for text, end in report.ends:
                self._note(text, end)
            yield from report.results

    def _repeat(self, jobs: list[Job], end: End) -> Iterator[Failed]:
        """Repeat jobs in futures of their own; blocks run by run."""
        self._note(end.message, end)
        for job in jobs:
            if len(job.task.runs) > 1:
                parts = [job.task._replace(first=run, stop=run + 1) for run in job.task.runs]
                self._left.extend([Job(part, True)] for part in parts)
                continue
            lost, rest = after(job, end)
            if lost is not None:
                yield lost
            if rest is not None:
                self._left.append([rest])

    def _renew(self, jobs: list[Job]) -> None:
        """Connect again, and give everything that was not finished to the cluster once more."""
        self._renewals += 1
        if self._renewals > MAX_RENEWALS:
            raise WorkerError("engine dask: the connection to the scheduler was lost several times")
        end = End("the connection to the dask scheduler was lost", outside=True)
        self._note(end.message, end)
        self._left.extendleft(each for each in [jobs, *(each for _, each in self._jobs.values())] if each)
        self._jobs.clear()
        self._cluster.reconnect()
