"""Engines compute tasks; this chooses one: this process, worker processes, or a dask cluster."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from rmpc_bench.components.loading import is_private
from rmpc_bench.components.reference import distribution_of
from rmpc_bench.components.transport import inside, recipe_of
from rmpc_bench.components.user_code import noted_signals
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.identity import SweepPoint
from rmpc_bench.config.sections import Execution
from rmpc_bench.engines.blocks import Pair, TaskQueue
from rmpc_bench.engines.pool import EndedWorkers, processes
from rmpc_bench.engines.tasks import Done, Task, contained, forget_draws, is_built_in, parts_of, warm_up_own
from rmpc_bench.engines.watch import Limits
from rmpc_bench.extras import missing
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.types.errors import WorkerError

_ADDRESS = re.compile(r"([a-z]+://)?(\[[0-9a-fA-F:.]+\]|[^\s:/\[\]]+):[0-9]{1,5}")
LAST_PORT = 65_535
"""The largest number of a port."""
Engine: TypeAlias = Callable[[Sequence[Experiment], TaskQueue], Generator[Done]]
"""Takes tasks from a queue until it is empty and all of them are finished.

Tasks that are added to the queue between two results are computed too.
"""


@dataclass(frozen=True)
class ComputeOptions:
    """How trials are computed; what is not given follows from the configuration."""

    workers: int | None = None
    engine: str | None = None
    scheduler: str | None = None  # address of a scheduler of dask
    accept_versions: bool = False  # whether other versions of a user's libraries may add to stored trials


def choose_engine(
    config: ExperimentConfig, tasks: Sequence[Task], how: ComputeOptions, directory: Path, say: Callable[[str], None]
) -> Engine:
    """Return the engine for tasks of an experiment; methods with different files of users share no process.

    Without a name, worker processes are used where a component comes from a file or an installed package, or where
    there is a limit of time or memory.  Otherwise this process computes, and lets several workers do what is left where
    that saves time.  Workers then start one by one, as far as each saves time.
    """
    name, n_trials = how.engine or config.execution.engine, sum(len(task.runs) for task in tasks)
    n = min(how.workers or config.execution.workers, n_trials)
    experiments = [point.experiment for point in config.points]
    parts = parts_of(experiments)
    own = not all(map(is_built_in, parts))
    limits = limits_of(config.execution)
    if name == "serial" and (own or limits != Limits()):
        what = "a component that ends its process or never returns ends the experiment; "
        say(f"engine serial: {what if own else ''}execution.timeout and execution.memory are not enforced")
    isolated = limits != Limits() or any(map(_is_imported, parts))
    logs, groups = directory / "logs", groups_of(config.points)
    keys: dict[str, Any] = {"limits": limits, "logs": logs if own else None, "note": EndedWorkers(logs, say).note}
    engine = partial(processes, workers=n, gradually=name is None, **keys)
    if name == "serial" or (name is None and n == 1 and not isolated):
        return apart(groups, serial, engine) if len(groups) > 1 else serial
    if name == "dask":
        # Only here: the other engines need nothing of dask.
        try:
            from rmpc_bench.engines.dask_cluster import dask_cluster
        except ModuleNotFoundError:
            raise WorkerError(f"engine dask: {missing('dask')}") from None
        _check_address(how.scheduler)
        engine = partial(dask_cluster, workers=n, scheduler=how.scheduler, say=say, **keys)
    if name is None and not isolated and not own:
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


def serial(
    experiments: Sequence[Experiment], queue: TaskQueue, ends: Callable[[], bool] = lambda: False
) -> Generator[Done]:
    """Do the tasks in this process, one after the other."""
    try:
        with single_thread(), noted_signals() as signals:
            warm_up_own(experiments)
            begun = set[str]()
            while not ends() and (task := queue.take()) is not None:
                for done in contained(experiments, task, lambda error: bool(signals)):
                    if signals:
                        # A component has caught the interruption.
                        signal.raise_signal(signals[0])
                    yield done._replace(loads=task.method not in begun)
                    begun.add(task.method)
    finally:
        forget_draws()


def here_first(experiments: Sequence[Experiment], queue: TaskQueue, workers: Engine) -> Generator[Done]:
    """Do the tasks in this process, or in worker processes as soon as that takes less time."""
    yield from serial(experiments, queue, lambda: queue.pays(1))
    queue.give_back()
    if len(queue):
        yield from workers(experiments, queue)


def groups_of(points: Sequence[SweepPoint]) -> dict[tuple[str, ...], set[Pair]]:
    """Return hashes of files and names of packages -> the methods with exactly these; built-in methods first."""
    found: dict[tuple[str, ...], set[Pair]] = {}
    for number, point in enumerate(points):
        for name in point.methods:
            kinds = (point.own_code.get(name, {}).get(kind, {}) for kind in ("sources", "installed"))
            code = {each for roles in kinds for role in roles.values() for each in role}
            found.setdefault(tuple(sorted(code)), set()).add((number, name))
    return dict(sorted(found.items()))


def apart(groups: Mapping[Any, set[Pair]], others: Engine, built_in: Engine) -> Engine:
    """Return an engine that computes one group of methods after the other, each in processes of its own."""

    def engine(experiments: Sequence[Experiment], queue: TaskQueue) -> Generator[Done]:
        while len(queue):
            for files, pairs in groups.items():
                part = queue.part(pairs)
                if len(part):
                    alone = [
                        replace(each, methods=tuple(one for one in each.methods if (number, one.name) in pairs))
                        for number, each in enumerate(experiments)
                    ]
                    yield from (others if files else built_in)(alone, part)

    return engine
