"""The engine with worker processes: a component that ends its process or never returns costs its own runs only.

The parent knows which tasks each worker has.  When a worker ends by itself, or is killed because it takes too long, the
rest of its task is repeated run by run in a new worker.  A run with which a worker ends twice alone is `crashed`.
When a worker is killed or stopped from outside, its task is repeated; see `attempts`.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path

from rmpc_bench.child_process import held
from rmpc_bench.components.transport import dumps
from rmpc_bench.execution.engines.attempts import Failed
from rmpc_bench.execution.engines.failures import failed
from rmpc_bench.execution.engines.pool import Note, Pool
from rmpc_bench.execution.engines.tasks import Done, has_own_code
from rmpc_bench.execution.engines.watch import Limits
from rmpc_bench.execution.engines.worker_process import HUNG, HUNG_WITH_OWN_CODE
from rmpc_bench.execution.task_queue import TaskQueue
from rmpc_bench.simulation.scenario import Experiment


def processes(
    experiments: Sequence[Experiment],
    queue: TaskQueue,
    workers: int,
    limits: Limits = Limits(),  # noqa: B008 - immutable
    logs: Path | None = None,
    note: Note = lambda text, end: None,
) -> Generator[Done]:
    """Do the tasks in worker processes; closing the generator ends them."""
    queue.workers = workers
    pool = Pool(dumps(experiments), limits, logs, patience(experiments), note)
    try:
        pool.start(range(workers))
        for each in pool.results(queue):
            yield failed(experiments, *each) if isinstance(each, Failed) else each
    finally:
        with held():
            pool.close()


def patience(experiments: Sequence[Experiment]) -> float:
    """Return the time without any computing after which a worker is replaced [s]."""
    own = any(has_own_code(experiment, method) for experiment in experiments for method in experiment.methods)
    return HUNG_WITH_OWN_CODE if own else HUNG
