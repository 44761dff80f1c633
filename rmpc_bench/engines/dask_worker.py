"""What a dask worker does: it gives the jobs to a worker process of the bench, as the engine on one machine does.

Crashes, limits of time and memory, and the output of components therefore follow the same code.  A dask worker runs no
component itself, so that its own end always comes from outside.
"""

from __future__ import annotations

import os
import platform
import threading
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from rmpc_bench.config.identity import code_version
from rmpc_bench.engines.blocks import TaskQueue
from rmpc_bench.engines.pool import Pool
from rmpc_bench.engines.tasks import Done
from rmpc_bench.engines.watch import Limits
from rmpc_bench.engines.workers import End, Failed, Job
from rmpc_bench.types.errors import WorkerError

IDLE = 60.0
"""Time without a job after which worker processes are ended [s], as when the client has been killed."""
LIBRARIES = ("numpy", "scipy", "numba")
"""Libraries whose other version may compute other numbers."""


class Setup(NamedTuple):
    """What a dask worker needs to know of an experiment."""

    key: str  # its name there
    data: bytes  # the experiments
    limits: Limits
    logs: Path | None  # directory for the output of components; it is used where it exists on the machine of the worker
    patience: float
    versions: Mapping[str, str]  # versions of the client, see `versions`


class Report(NamedTuple):
    """What a dask worker returns."""

    results: list[Done | Failed]
    ends: list[tuple[str, End]]  # worker processes that have ended early, in words


def versions() -> dict[str, str]:
    """Return the versions that decide about numbers."""
    found = {name: version(name) for name in LIBRARIES} | {name: str(text) for name, text in code_version().items()}
    return found | {"python": ".".join(platform.python_version_tuple()[:2])}


class KeptPools:
    """Worker processes of one experiment, kept for the next jobs; each thread of a dask worker uses one."""

    def __init__(self, setup: Setup) -> None:
        self._setup, self._lock = setup, threading.Lock()
        self._idle, self._busy = list[_OwnPool](), list[_OwnPool]()
        self._n_started, self._cancelled = 0, False
        self._timer: threading.Timer | None = None

    def compute(self, jobs: Sequence[Job]) -> Report:
        """Do jobs one after the other; a WorkerError where versions differ or the experiment cannot be loaded."""
        self._check_versions()
        own = self._taken()
        try:
            results = list(own.pool.results(TaskQueue(), jobs))
        except BaseException:
            with self._lock:
                self._busy.remove(own)
            own.pool.close()
            raise
        report = Report(results, [*own.ends])
        own.ends.clear()
        with self._lock:
            self._busy.remove(own)
            self._idle.append(own)
            self._end_when_idle()
        return report

    def cancel(self) -> None:
        """End all worker processes, and start no further ones: a thread may have the experiment already."""
        with self._lock:
            self._cancelled = True
            if self._timer is not None:
                self._timer.cancel()
            for own in self._busy:
                # The thread that uses the pool closes it.
                own.pool.cancel()
        self._close_idle()

    def _check_versions(self) -> None:
        here, there = versions(), self._setup.versions
        different = [
            f"{name} {here.get(name)} instead of {text}" for name, text in there.items() if here.get(name) != text
        ]
        if different:
            raise WorkerError(f"the dask worker on {platform.node()} has {', '.join(different)}")

    def _taken(self) -> _OwnPool:
        """Return a pool that no other thread uses; a WorkerError after `cancel`."""
        with self._lock:
            if self._cancelled:
                raise WorkerError("the computation was cancelled")
            if self._timer is not None:
                self._timer.cancel()
            if self._idle:
                own = self._idle.pop()
            else:
                own = _OwnPool(self._setup, self._n_started)
                self._n_started += 1
            self._busy.append(own)
        return own

    def _end_when_idle(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = threading.Timer(IDLE, self._close_idle)
        self._timer.daemon = True
        self._timer.start()

    def _close_idle(self) -> None:
        with self._lock:
            idle, self._idle = self._idle, []
        for own in idle:
            own.pool.close()


class _OwnPool:
    """A pool of one worker process, and the ends of its processes that are not reported yet."""

    def __init__(self, setup: Setup, number: int) -> None:
        self.ends: list[tuple[str, End]] = []
        logs = None
        if setup.logs is not None:
            # The output of components must not fill the log of the cluster.
            there = setup.logs.parent.is_dir()
            logs = setup.logs / f"{platform.node()}-{os.getpid()}" if there else Path(os.devnull)
        self.pool = Pool(setup.data, setup.limits, logs, setup.patience, lambda *each: self.ends.append(each))
        self.pool.start([number])
