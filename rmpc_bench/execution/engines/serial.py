"""The engine without worker processes: a component that ends its process ends the experiment."""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator, Sequence

from rmpc_bench.components.signals import noted_signals
from rmpc_bench.execution.engines.contained import contained
from rmpc_bench.execution.engines.tasks import Done, forget_draws, warm_up_own
from rmpc_bench.execution.task_queue import TaskQueue
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.simulation.threads import single_thread


def serial(
    experiments: Sequence[Experiment], queue: TaskQueue, ends: Callable[[], bool] = lambda: False
) -> Generator[Done]:
    """Do the tasks in this process, one after the other."""
    try:
        with single_thread(), noted_signals() as signals:
            warm_up_own(experiments)
            while not ends() and (task := queue.take()) is not None:
                for done in contained(experiments, task, lambda error: bool(signals)):
                    if signals:
                        # A component has caught the interruption.
                        signal.raise_signal(signals[0])
                    yield done
    finally:
        forget_draws()
