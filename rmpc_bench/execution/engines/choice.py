"""Choice of the engine of an experiment."""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from rmpc_bench.components.installed import distribution_of
from rmpc_bench.components.private_modules import is_private
from rmpc_bench.components.recipes import inside, recipe_of
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.sections import Execution
from rmpc_bench.execution.engines.ended_workers import EndedWorkers
from rmpc_bench.execution.engines.here_first import here_first
from rmpc_bench.execution.engines.processes import processes
from rmpc_bench.execution.engines.serial import serial
from rmpc_bench.execution.engines.tasks import Done, Task, components_of, has_own_code
from rmpc_bench.execution.engines.watch import Limits
from rmpc_bench.execution.separation import apart, groups_of
from rmpc_bench.execution.task_queue import TaskQueue
from rmpc_bench.execution.worker_error import WorkerError
from rmpc_bench.simulation.scenario import Experiment

_ADDRESS = re.compile(r"([a-z]+://)?(\[[0-9a-fA-F:.]+\]|[^\s:/\[\]]+):[0-9]{1,5}")
LAST_PORT = 65_535
"""The largest number of a port."""
Engine: TypeAlias = Callable[[Sequence[Experiment], TaskQueue], Generator[Done]]
"""Takes tasks from a queue until it is empty and all of them are finished.

Tasks that are added to the queue between two results are computed too.
"""


def choose_engine(
    config: ExperimentConfig,
    tasks: Sequence[Task],
    workers: int | None,
    name: str | None,
    directory: Path,
    say: Callable[[str], None],
    scheduler: str | None = None,
) -> Engine:
    """Return the engine for tasks of an experiment; methods with different files of users share no process.

    Without a name, worker processes are used where several are asked for, where a component comes from a file or an
    installed package, or where there is a limit of time or memory.  Otherwise this process computes, and lets several
    workers of the configuration do what is left where that saves time.
    """
    name, n_trials = name or config.execution.engine, sum(len(task.runs) for task in tasks)
    n = min(workers or config.execution.workers, n_trials)
    experiments = [point.experiment for point in config.points]
    own = any(has_own_code(experiment, method) for experiment in experiments for method in experiment.methods)
    parts = [part for experiment in experiments for part in components_of(experiment, *experiment.methods)]
    limits = limits_of(config.execution)
    if name == "serial" and (own or limits != Limits()):
        what = "a component that ends its process or never returns ends the experiment; "
        say(f"engine serial: {what if own else ''}execution.timeout and execution.memory are not enforced")
    isolated = limits != Limits() or any(map(_is_imported, parts))
    logs, groups = directory / "logs", groups_of(config.points)
    keys: dict[str, Any] = {"limits": limits, "logs": logs if own else None, "note": EndedWorkers(logs, say).note}
    engine = partial(processes, workers=n, **keys)
    if name == "serial" or (name is None and n == 1 and not isolated):
        return apart(groups, serial, engine) if len(groups) > 1 else serial
    if name == "dask":
        # Only here: the other engines need nothing of dask.
        from rmpc_bench.execution.engines.dask_cluster import dask_cluster

        _check_address(scheduler)
        engine = partial(dask_cluster, workers=n, scheduler=scheduler, **keys)
    if name is None and workers is None and not isolated and not own:
        return partial(here_first, workers=engine)
    return apart(groups, engine, engine) if len(groups) > 1 else engine


def _check_address(scheduler: str | None) -> None:
    """Refuse what is no address: a client of dask may wait without end for one without a port."""
    found = scheduler is None or _ADDRESS.fullmatch(scheduler)
    if not found or (scheduler and int(scheduler.rpartition(":")[2]) > LAST_PORT):
        raise WorkerError(f"engine dask: {scheduler!r} is no address of a scheduler, such as tcp://node7:8786")


def limits_of(execution: Execution) -> Limits:
    """Return the limits of worker processes that a configuration asks for."""
    timeout = execution.timeout
    step, run = (None, None) if timeout is None else (timeout.step, timeout.run)
    assert not isinstance(step, str) and not isinstance(run, str)
    return Limits(step, run, execution.memory_limit, execution.memory or "")


def _is_imported(part: Any) -> bool:
    """Whether a component comes from a file of the user or an installed package, not from the calling program."""
    recipe = recipe_of(part)
    if recipe is None:
        return False
    if recipe.code is not None or any(True for _ in inside(recipe.parameters)):
        return True
    module = getattr(recipe.design, "__module__", None) or ""
    return is_private(module) or distribution_of(module.partition(".")[0]) is not None
