"""From a configuration to stored trials: find what is missing, compute it, store every block as it arrives."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.own_code import OwnCode, check_copies, in_directory
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.engines.blocks import Pair
from rmpc_bench.engines.choice import ComputeOptions, Engine, choose_engine
from rmpc_bench.engines.tasks import Task
from rmpc_bench.execution.layout import keep_layout
from rmpc_bench.execution.missing import pending, stored_blocks
from rmpc_bench.execution.progress import Progress
from rmpc_bench.execution.progress_file import ProgressFile, extent_of
from rmpc_bench.execution.separation import check_shared, separated, shared_of, warm_up_tasks
from rmpc_bench.execution.shards import Shard, stored_in, take_shards
from rmpc_bench.received.plain_files import content_of
from rmpc_bench.received.store import FILE, WriteError
from rmpc_bench.replaced_file import inside, refuse_outside, replace_text, replaced
from rmpc_bench.results.imported import refuse_imported
from rmpc_bench.results.manifest import session
from rmpc_bench.results.other_code import check_versions, note_versions, rows_of_other_code, stored_methods
from rmpc_bench.results.record import added_methods
from rmpc_bench.results.running import add_done, add_stored, running_comparison
from rmpc_bench.store.store import Store
from rmpc_bench.types.result_layout import CONFIG, COPIES, RESOLVED

if TYPE_CHECKING:
    from rmpc_bench.execution.stopping import Stopping


_ADDED = "# this directory has more methods: --add-method "


def compute(
    config: ExperimentConfig,
    directory: Path,
    *,
    how: ComputeOptions = ComputeOptions(),  # noqa: B008 - immutable
    only: Collection[str] | None = None,
    progress: Progress | None = None,
    shard: Shard | None = None,
    missing: bool = False,
) -> None:
    """Compute and store what is missing; the same call continues an interrupted one."""
    progress = progress or Progress()
    methods = [each.name for each in config.experiment.methods if only is None or each.name in only]
    place = directory if shard is None else shard.directory(directory)
    also = {} if shard is None else stored_in(directory, config, methods, progress.say)
    runs = range(config.experiment.n_runs) if shard is None else shard.runs(config.experiment.n_runs)
    if (place / FILE).is_file() and not (place / FILE).stat().st_size:
        progress.say(f"{place / FILE} is empty: every trial is computed")
    refuse_imported(directory)
    with Store(place) as store:
        store.claim(config.hash, config.shared, config.own.names())
        if missing:
            take_shards(config, store, progress.say)
        first, trials, blocks = runs.start, dict[Pair, Mapping[str, float]](), dict[Pair, range]()
        _prepare(config, store, methods, progress, how)
        for folder in dict.fromkeys((place, directory)):
            _keep_configuration(config, folder, added_methods(store))
        stopping = _stopping(config, store, methods, progress)
        tasks = pending(config, store, methods, runs, also) if stopping is None else stopping.tasks()
        if tasks or shared_of(config.points):
            config, trials = separated(config, methods, progress, first)
        with session(place, config, config.overrides, progress.say):
            apart = rows_of_other_code(config, store, methods)
            for line in apart.said("; they are computed again", ": computing them again (old ones kept)"):
                progress.say(line)
            n_left = sum(len(task.runs) for task in tasks)
            runs = runs if stopping is None else range(stopping.n_runs)
            file = ProgressFile(place, extent_of(config, methods), runs, store, n_left=n_left, tasks=tasks, shard=shard)
            if tasks:
                store.register(stored_methods(config, methods))
                note_versions(config, store, methods)
                engine = choose_engine(config, tasks, how, place, progress.say)
            if tasks or not file.is_up_to_date():
                with file:
                    blocks = _compute(config, store, tasks, engine, progress, file, stopping) if tasks else {}
            # Workers of dask may be other machines, whose bits may differ.
            is_here = (how.engine or config.execution.engine) != "dask"
            check_shared(config, store, trials, blocks if is_here else {}, first)


def _prepare(
    config: ExperimentConfig, store: Store, methods: Collection[str], progress: Progress, how: ComputeOptions
) -> None:
    """Check the stored rows, and store what reports need beside the trials."""
    check_versions(config, store, methods, accept=how.accept_versions)
    for name in added_methods(store):
        if name not in config.methods:
            text = f"{name}, which was added to {store.directory}, is not in this configuration: no table shows it"
            progress.say(text)
    keep_layout(config, store, methods)


def _stopping(config: ExperimentConfig, store: Store, methods: Collection[str], progress: Progress) -> Stopping | None:
    """Return what decides how many runs are computed; None where the configuration gives their number."""
    if config.stop is None:
        return None
    # Claims and comparisons are imported where a rule evaluates them only.
    from rmpc_bench.execution.stopping import Stopping

    return Stopping(config, store, methods, progress.say)


def _keep_configuration(config: ExperimentConfig, directory: Path, added: Mapping[str, str]) -> None:
    """Keep the configuration file, its resolved form and copies of the user's files with the trials."""
    # Methods that the command line has added are comments of the configuration file.
    kept = directory / CONFIG
    # The resolved configuration of the directory itself does not take the place of the one it was made from.
    given = kept if config.path.resolve() == (directory / RESOLVED).resolve() and kept.exists() else config.path
    try:
        keep_sources(config.own, directory)
        resolved = in_directory(config.resolved, directory, config.own)
        replace_text(directory / RESOLVED, dump(plain(resolved)))
        content = content_of(given) if config.content is None else config.content.encode()
        lines = [line for line in content.splitlines(keepends=True) if not line.startswith(_ADDED.encode())]
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
        add_stored(running, config, store, tasks)
    progress.start(config.name, file.total, file.done, running)
    try:
        with closing(stored_blocks(config, store, tasks, engine)) as results:
            for queue, done in results:
                add_done(running, config, done)
                file.note(done)
                progress.advance(len(done.task.runs))
                pair = done.task.point, done.task.method
                blocks[pair] = min(blocks.get(pair, done.task.runs), done.task.runs, key=lambda runs: runs.start)
                following = [] if stopping is None else stopping.after(len(done.task.runs))
                if stopping is not None and following:
                    queue.add(following)
                    file.extend(following, stopping.n_runs)
                    progress.extend(sum(len(task.runs) for task in following))
    finally:
        progress.stop()
    return blocks
