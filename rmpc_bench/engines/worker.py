"""A worker process: it loads the experiments once, then does tasks until its parent closes the connection."""

from __future__ import annotations

import faulthandler
import os
import pickle
import resource
import signal
import stat
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any

from rmpc_bench.child_process import end_with
from rmpc_bench.components.loading import described, place_of
from rmpc_bench.components.transport import loads
from rmpc_bench.engines.messages import send
from rmpc_bench.engines.tasks import Done, Task, contained, warm_up_own
from rmpc_bench.engines.watch import Limits, SharedWatch
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.types import TimeLimit

STOP_STEP, DUMP_TRACE = signal.SIGUSR1, signal.SIGUSR2
"""Signals of the parent: end what takes too long; write the frames of the Python code, also inside compiled code."""
OUT_OF_MEMORY = 86
"""Exit code after a MemoryError that a fresh process might not have."""
LOG_PER_RUN = 100_000
"""Output of components that is kept, on average of the runs of a task [bytes]."""
LEAST_FREE = 50_000_000
"""Memory that a limit must leave beyond what a worker has before its first run [bytes]."""


def main(connection: int, experiments: int, watch: int, trace: int, parent: int) -> None:
    """Work until the parent closes the connection; nothing after this returns to the caller's clean-up."""
    # Ctrl-C in a terminal reaches every process of the group; only the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    end_with(parent)
    with os.fdopen(watch, "r+b", buffering=0) as file:
        shared = SharedWatch(file)
        # A component may call os.fork.
        os.register_at_fork(after_in_child=shared.detach)
    faulthandler.enable(trace, all_threads=False)
    faulthandler.register(DUMP_TRACE, trace, all_threads=False)
    with os.fdopen(experiments, "rb") as file:
        data, limits = pickle.load(file)
    _work(Connection(connection), data, limits, shared)
    # Threads and exit handlers of components must not keep the process.
    os._exit(0)


def _work(connection: Connection, data: bytes, limits: Limits, watch: SharedWatch) -> None:
    """Load the experiments and do tasks until the connection is closed."""
    try:
        watch.has_limits = limits.timed
        # The returned context is not entered, so that the limit stays for the life of the worker.
        single_thread()
        experiments = _loaded(connection, data)
        too_small = _limit_memory(limits)
        if too_small:
            send(connection, too_small)
        elif experiments is not None:
            signal.signal(STOP_STEP, _stopper(watch, limits))
            send(connection, None)
            _serve(connection, experiments, watch, limits)
    except (EOFError, ConnectionError):
        pass


def _loaded(connection: Connection, data: bytes) -> Sequence[Experiment] | None:
    """Make and prepare the experiments; report an exception of the user's code and return None."""
    try:
        experiments: Sequence[Experiment] = loads(data)
        # A file may have asked for more threads.
        single_thread()
        warm_up_own(experiments)
    except BaseException as error:
        place = place_of(error)
        send(connection, described(error) if place is None else f"{place.file}:{place.line}: {described(error)}")
        return None
    return experiments


def _limit_memory(limits: Limits) -> str:
    """Let an allocation beyond the limit raise a MemoryError; say if the limit leaves nothing for the runs."""
    if limits.memory is None:
        return ""
    if sys.platform == "linux":
        used = _data_size()
        if used + LEAST_FREE > limits.memory:
            least = (used + LEAST_FREE) / 1e6
            return f"execution.memory is {limits.memory_text}; a worker process needs {least:.0f} MB at least"
        # Not RLIMIT_AS: libraries reserve address space that they never use.
        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        least = limits.memory if hard == resource.RLIM_INFINITY else min(limits.memory, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (least, hard))
    else:
        threading.Thread(target=_follow_memory, args=(limits.memory,), daemon=True).start()
    return ""


def _data_size() -> int:
    """Return the size of the memory of this process that its limit counts [bytes]."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmData:"))


def _follow_memory(limit: int) -> None:
    """End this process when it has used too much memory, on systems that do not limit allocations."""
    while resource.getrusage(resource.RUSAGE_SELF).ru_maxrss <= limit:
        time.sleep(0.1)
    os._exit(OUT_OF_MEMORY)


def _stopper(watch: SharedWatch, limits: Limits) -> Any:
    def stop(number: int, frame: FrameType | None) -> None:
        # The call may have ended since the parent has sent the signal.
        text = watch.overdue(limits)
        # A component may catch the first exception and go on; the parent then kills this process.
        if text and not watch.stopped:
            watch.begin_again(text)
            raise TimeLimit(text)

    return stop


def _serve(connection: Connection, experiments: Sequence[Experiment], watch: SharedWatch, limits: Limits) -> None:
    is_fresh, process, begun = True, os.getpid(), set[str]()
    while True:
        task, alone = connection.recv()
        before = _log_size()
        parts = [task._replace(first=run, stop=run + 1) for run in task.runs] if alone else [task]
        for part in parts:
            may_be_full = limits.memory is not None and not (is_fresh and len(part.runs) == 1)
            for done in _done(experiments, part, watch, may_be_full=may_be_full):
                if os.getpid() != process:
                    # A component has called os.fork and returned: the copy must not answer in place of this process.
                    os._exit(0)
                send(connection, done._replace(loads=task.method not in begun))
                begun.add(task.method)
            is_fresh = False
        _cut_log(before, LOG_PER_RUN * len(task.runs))
        send(connection, None)


def _done(experiments: Sequence[Experiment], task: Task, watch: SharedWatch, *, may_be_full: bool) -> Iterator[Done]:
    """Do a task; memory that runs out because of earlier runs ends the process."""
    try:
        yield from contained(experiments, task, lambda error: may_be_full and isinstance(error, MemoryError), watch)
    except MemoryError:
        os._exit(OUT_OF_MEMORY)


def _log_size() -> int | None:
    """Return the size of the file that gets the output of components; None where it goes to the screen."""
    found = os.fstat(1)
    return found.st_size if stat.S_ISREG(found.st_mode) else None


def _cut_log(before: int | None, largest: int) -> None:
    size = _log_size()
    if before is not None and size is not None and size > before + largest:
        os.ftruncate(1, before + largest)
