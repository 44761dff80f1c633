"""The engine that starts worker processes only where they save time.

A worker process needs about a second to start.  This process computes until the time of what is left is known from what
is finished; if it is long, worker processes do the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import TypeAlias

from rmpc_bench.execution.engines.serial import serial
from rmpc_bench.execution.engines.tasks import Done
from rmpc_bench.execution.task_queue import TaskQueue
from rmpc_bench.simulation.scenario import Experiment

MEASURED = 2.0
"""Computing time after which the time of the rest is estimated, if not all methods are measured before [s]."""
PAYS = 4.0
"""Computing time from which on starting workers saves time [s]."""

Engine: TypeAlias = Callable[[Sequence[Experiment], TaskQueue], Generator[Done]]


def here_first(experiments: Sequence[Experiment], queue: TaskQueue, workers: Engine) -> Generator[Done]:
    """Do the tasks in this process, or in worker processes as soon as that takes less time."""

    def pay() -> bool:
        known = queue.is_measured or queue.seconds_done > MEASURED
        # With a stopping rule the queue has the tasks up to the next decision only.
        more = queue.has_grown and queue.seconds_done > PAYS
        return known and (more or queue.seconds_left > PAYS)

    yield from serial(experiments, queue, pay)
    queue.give_back()
    if len(queue):
        yield from workers(experiments, queue)
