"""Trials that the store of an experiment lacks: which these are, and every finished block into the store."""

from __future__ import annotations

import gc
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from types import MappingProxyType

import numpy as np
from jaxtyping import Int

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.identity import SweepPoint
from rmpc_bench.engines.blocks import BlockLengths, TaskQueue
from rmpc_bench.engines.choice import Engine
from rmpc_bench.engines.tasks import Done, Task
from rmpc_bench.simulation.recording import kept
from rmpc_bench.store.columns import ranges
from rmpc_bench.store.store import Store
from rmpc_bench.types import Array


def pending(
    config: ExperimentConfig,
    store: Store,
    methods: Collection[str],
    runs: range | None = None,
    also: Mapping[str, Int[Array, " stored"]] = MappingProxyType({}),
) -> list[Task]:
    """Return the ranges of runs that are not stored yet; a `TaskQueue` cuts them into blocks.

    Trials that points of a sweep share are computed once, at the first of them.  `also` has the runs that another store
    has, by the key of a method.
    """
    if "runs" not in config.evaluate:
        return []
    tasks, seen = list[Task](), set()
    for number, point in enumerate(config.points):
        n_runs = point.experiment.n_runs
        for name, key in point.method_keys.items():
            if name in methods and key not in seen:
                seen.add(key)
                done = store.finished(key, point.metric_keys.values(), kept(point.experiment, name), n_runs)
                wanted = np.arange(n_runs) if runs is None else np.array(runs, dtype=int)
                missing = np.setdiff1d(wanted, np.union1d(done, also.get(key, done)), assume_unique=True)
                tasks += [Task(name, *bounds, number) for bounds in ranges(missing)]
    return tasks


def stored_blocks(
    config: ExperimentConfig, store: Store, tasks: Sequence[Task], engine: Engine
) -> Generator[tuple[TaskQueue, Done]]:
    """Compute tasks; yield every block when it is stored, with the queue that further tasks may be added to."""
    experiments = tuple(point.experiment for point in config.points)
    queue = TaskQueue(tasks, BlockLengths(experiments, config.execution.fixed_block))
    with closing(engine(experiments, queue)) as results, garbage_collected():
        for done in results:
            store_block(store, config.points[done.task.point], done)
            queue.note(done)
            yield queue, done


@contextmanager
def garbage_collected() -> Iterator[None]:
    """Collect garbage where the command has switched that off: cycles of components may hold large arrays."""
    if gc.isenabled():
        yield
        return
    gc.freeze()  # what is loaded stays, and is not visited
    gc.enable()
    try:
        yield
    finally:
        gc.disable()


def store_block(store: Store, point: SweepPoint, done: Done) -> None:
    """Store a finished block of a method at a point of the sweep."""
    block, task = done.block, done.task
    names = [metric.name for metric in point.experiment.metrics]
    columns = {point.metric_keys[name]: column for name, column in zip(names, block.metrics, strict=True)}
    key, draw = point.method_keys[task.method], point.uncertainty_key
    store.add_block(key, task.runs, block, columns, draw, done.uncertainty)
