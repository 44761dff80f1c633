"""The engine with worker processes of joblib."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Generator, Sequence
from multiprocessing import resource_tracker as multiprocessing_tracker

from rmpc_bench.components.transport import dumps, loads
from rmpc_bench.execution.engines.contained import contained
from rmpc_bench.execution.engines.tasks import Done, Task
from rmpc_bench.execution.interrupts import held
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.simulation.threads import single_thread


def processes(experiments: Sequence[Experiment], tasks: Sequence[Task], workers: int) -> Generator[Done]:
    """Do the tasks in worker processes; closing the generator ends them."""
    from joblib import Parallel, delayed
    from joblib.externals.loky import get_reusable_executor
    from joblib.externals.loky.backend import resource_tracker

    for tracker in (resource_tracker, multiprocessing_tracker):
        # A tracker unblocks signals when it starts, so it must not start while they are held back below.
        tracker.ensure_running()
    parallel = Parallel(
        n_jobs=workers,
        backend="loky",
        return_as="generator_unordered",
        batch_size=1,
        inner_max_num_threads=1,
        initializer=_start_worker,
        initargs=(dumps(experiments),),
    )
    results = None
    try:
        # A pool that is interrupted while it starts cannot be shut down.
        with held():
            results = parallel(delayed(_work_here)(task) for task in tasks)
        for done in results:
            yield from done
    finally:
        with held(), warnings.catch_warnings():
            # joblib warns of finished tasks that were not used, which is normal after an interruption.
            warnings.simplefilter("ignore")
            if results is not None:
                results.close()
            get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)


_here: list[Experiment] = []
"""The experiments of this worker process, sent once when it started."""


def _start_worker(experiments: bytes) -> None:
    # Ctrl-C in a terminal reaches every process of the group; only the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    threading.Thread(target=_follow, args=(os.getppid(),), daemon=True).start()
    # The returned context is not entered, so that the limit stays for the life of the worker.
    single_thread()
    _here[:] = loads(experiments)


def _follow(parent: int) -> None:
    """End this worker when its parent has been killed; loky alone would keep it waiting for minutes."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _work_here(task: Task) -> list[Done]:
    return list(contained(_here, task, lambda error: False))
