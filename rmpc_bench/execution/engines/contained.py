"""Bisection of a block whose component raises an exception: only the runs in which it raises fail."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from rmpc_bench.execution.engines.failures import failed, failure_of
from rmpc_bench.execution.engines.tasks import Done, Task, work
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import NO_WATCH, Watch


def contained(
    experiments: Sequence[Experiment],
    task: Task,
    is_fatal: Callable[[BaseException], bool],
    watch: Watch = NO_WATCH,
) -> Iterator[Done]:
    """Do one task; if a component raises, repeat its halves until each run that raises is alone (bisection).

    The runs of a block do not depend on each other, so a repeated run has the same numbers.
    """
    try:
        done = work(experiments, task, watch)
    except BaseException as error:
        watch.end()
        if is_fatal(error):
            raise
        parts = _halves(task)
        failure = failure_of(error, experiments[task.point], task.first) if not parts else None
    else:
        yield done
        return
    # Outside of the handler: the exception keeps the arrays of the block alive.
    if failure is not None:
        yield failed(experiments, task, failure)
    for part in parts:
        yield from contained(experiments, part, is_fatal, watch)


def _halves(task: Task) -> list[Task]:
    middle = (task.first + task.stop) // 2
    if middle == task.first:
        return []
    return [task._replace(stop=middle), task._replace(first=middle)]
