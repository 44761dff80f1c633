"""From a configuration to stored trials: find what is missing, compute it, store every block as it arrives."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping
from contextlib import closing
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.identity import SweepPoint
from rmpc_bench.config.own_code import OwnCode, check_copies, in_directory
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.engines.blocks import BlockLengths, Pair, TaskQueue
from rmpc_bench.engines.choice import Engine, choose_engine
from rmpc_bench.engines.tasks import Done, Task
from rmpc_bench.execution.layout import keep_layout
from rmpc_bench.execution.progress import Progress, Silent
from rmpc_bench.execution.progress_file import ProgressFile, extent_of
from rmpc_bench.execution.separation import check_shared, separated, shared_of, warm_up_tasks
from rmpc_bench.execution.shards import Shard, stored_in, take_shards
from rmpc_bench.received.plain_files import content_of
from rmpc_bench.received.store import FILE, WriteError
from rmpc_bench.replaced_file import inside, refuse_outside, replace_text, replaced
from rmpc_bench.results.manifest import Session
from rmpc_bench.results.other_code import check_versions, note_versions, rows_of_other_code, stored_methods
from rmpc_bench.results.record import added_methods
from rmpc_bench.results.running import add_done, add_stored, running_comparison
from rmpc_bench.simulation.recording import kept
from rmpc_bench.store.columns import ranges
from rmpc_bench.store.store import Store
from rmpc_bench.types import Array
from rmpc_bench.types.result_files import CONFIG, COPIES, RESOLVED

if TYPE_CHECKING:
    from rmpc_bench.execution.stopping import Stopping


_ADDED = "# this directory has more methods: --add-method "


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


def compute(
    config: ExperimentConfig,
    directory: Path,
    *,
    workers: int | None = None,
    only: Collection[str] | None = None,
    progress: Progress | None = None,
    modified: Collection[str] = (),
    accept_versions: bool = False,
    engine: str | None = None,
    scheduler: str | None = None,
    shard: Shard | None = None,
    missing: bool = False,
) -> None:
    """Compute and store what is missing; the same call continues an interrupted one."""
    progress = progress or Silent()
    names = [method.name for method in config.experiment.methods]
    methods = names if only is None else [name for name in names if name in only]
    place = directory if shard is None else shard.directory(directory)
    also = {} if shard is None else stored_in(directory, config, methods, progress.say)
    runs = range(config.experiment.n_runs) if shard is None else shard.runs(config.experiment.n_runs)
    if (place / FILE).is_file() and not (place / FILE).stat().st_size:
        progress.say(f"{place / FILE} is empty: every trial is computed")
    with Store(place) as store:
        store.claim(config.hash, config.shared, config.own.names())
        if missing:
            take_shards(config, store, progress.say)
        first, trials, blocks = runs.start, dict[Pair, Mapping[str, float]](), dict[Pair, range]()
        _prepare(config, store, methods, progress, accept_versions=accept_versions)
        for folder in dict.fromkeys((place, directory)):
            _keep_configuration(config, folder, added_methods(store))
        stopping = _stopping(config, store, methods, progress)
        tasks = pending(config, store, methods, runs, also) if stopping is None else stopping.tasks()
        if tasks or shared_of(config.points):
            config, trials = separated(config, methods, progress, first)
        with Session(place, config, modified, progress.say):
            _say_other_code(config, store, methods, progress)
            n_left = sum(len(task.runs) for task in tasks)
            runs = runs if stopping is None else range(stopping.n_runs)
            file = ProgressFile(place, extent_of(config, methods), runs, store, n_left=n_left, shard=shard)
            if tasks:
                store.register(stored_methods(config, methods))
                note_versions(config, store, methods)
                chosen = choose_engine(config, tasks, workers, engine, place, progress.say, scheduler)
                with file:
                    blocks = _compute(config, store, tasks, chosen, progress, file, stopping)
            elif not file.is_up_to_date():
                with file:
                    pass
            # Workers of dask may be other machines.
            is_here = (engine or config.execution.engine) != "dask"
            check_shared(config, store, trials, blocks if is_here else {}, first)


def _prepare(
    config: ExperimentConfig, store: Store, methods: Collection[str], progress: Progress, *, accept_versions: bool
) -> None:
    """Check the stored rows, and store what reports need beside the trials."""
    check_versions(config, store, methods, accept=accept_versions)
    for name in added_methods(store):
        if name not in config.methods:
            text = f"{name}, which was added to {store.directory}, is not in this configuration: no table shows it"
            progress.say(text)
    keep_layout(config, store, methods)


def _say_other_code(config: ExperimentConfig, store: Store, methods: Collection[str], progress: Progress) -> None:
    apart = rows_of_other_code(config, store, methods)
    for line in apart.said("; they are computed again", ": computing them again (old ones kept)"):
        progress.say(line)


def _stopping(config: ExperimentConfig, store: Store, methods: Collection[str], progress: Progress) -> Stopping | None:
    """Return what decides how many runs are computed; None where the configuration gives their number."""
    if config.stop is None:
        return None
    # Claims and comparisons are imported where a rule evaluates them only.
    from rmpc_bench.execution.stopping import Stopping

    return Stopping(config, store, methods, lambda n, names: pending(config, store, names, range(n)), progress.say)


def _keep_configuration(config: ExperimentConfig, directory: Path, added: Mapping[str, str]) -> None:
    """Keep the configuration file, its resolved form and copies of the user's files with the trials.

    Methods that the command line has added are comments of the configuration file.
    """
    kept = directory / CONFIG
    # The resolved configuration of the directory itself does not take the place of the one it was made from.
    given = kept if config.path.resolve() == (directory / RESOLVED).resolve() and kept.exists() else config.path
    try:
        keep_sources(config.own, directory)
        resolved = in_directory(config.resolved, directory, config.own)
        replace_text(directory / RESOLVED, dump(plain(resolved)))
        lines = [line for line in content_of(given).splitlines(keepends=True) if not line.startswith(_ADDED.encode())]
        comments = [f"{_ADDED}{shlex.quote(text)}\n".encode() for text in added.values()]
        end = b"\n" if comments and lines and not lines[-1].endswith(b"\n") else b""
        with replaced(kept) as partial:
            partial.write_bytes(b"".join([*lines, end, *comments]))
    except OSError as error:
        raise WriteError(str(error)) from None


def keep_sources(own: OwnCode, directory: Path) -> None:
    """Copy every Python file that computes trials, with all that it imports: ``code/<hash>/tanks.py``.

    A copy that is there stays, since equal hashes mean equal programs.
    """
    check_copies(directory)
    for source in (*own.sources.values(), *own.parts.values()):
        for place, file in source.copies.items():
            path = directory / COPIES / source.folder / place
            if not path.exists():
                with inside(directory):
                    refuse_outside(path.parent)
                    path.parent.mkdir(parents=True, exist_ok=True)
                    with replaced(path) as partial:
                        partial.write_bytes(file.content)


def added_in(path: Path) -> list[str]:
    """Return the methods that comments of a kept configuration file add."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return [" ".join(shlex.split(line.removeprefix(_ADDED))) for line in lines if line.startswith(_ADDED)]


def _compute(
    config: ExperimentConfig,
    store: Store,
    tasks: list[Task],
    engine: Engine,
    progress: Progress,
    file: ProgressFile,
    stopping: Stopping | None,
) -> dict[Pair, range]:
    """Compute and store tasks, and return the first block of every method."""
    experiments = tuple(point.experiment for point in config.points)
    warm_up_tasks(experiments, tasks if stopping is None else stopping.kinds(), progress)
    running, blocks = running_comparison(config), dict[Pair, range]()
    if file.done:
        add_stored(running, config, store)
    progress.start(config.name, file.total, file.done, running)
    try:
        queue = TaskQueue(tasks, BlockLengths(experiments, config.execution.fixed_block))
        with closing(engine(experiments, queue)) as results:
            for done in results:
                store_block(store, config.points[done.task.point], done)
                queue.note(done)
                add_done(running, config, done)
                file.note(done)
                progress.advance(len(done.task.runs))
                pair = done.task.point, done.task.method
                blocks[pair] = min(blocks.get(pair, done.task.runs), done.task.runs, key=lambda runs: runs.start)
                following = [] if stopping is None else stopping.after(len(done.task.runs))
                if following:
                    queue.add(following)
                    n_more = sum(len(task.runs) for task in following)
                    file.extend(n_more)
                    progress.extend(n_more)
    finally:
        progress.stop()
    return blocks


def store_block(store: Store, point: SweepPoint, done: Done) -> None:
    """Store a finished block of a method at a point of the sweep."""
    block, task = done.block, done.task
    names = [metric.name for metric in point.experiment.metrics]
    columns = {point.metric_keys[name]: column for name, column in zip(names, block.metrics, strict=True)}
    key, draw = point.method_keys[task.method], point.uncertainty_key
    store.add_block(key, task.runs, block, columns, draw, done.uncertainty)
