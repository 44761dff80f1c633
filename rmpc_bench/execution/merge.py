"""Joining the shards of a directory into its trial store; no configuration is read and no code of a user is loaded."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from rmpc_bench.config.identity import code_version
from rmpc_bench.config.own_code import check_copies
from rmpc_bench.execution.progress_file import Column, Extent, ProgressFile
from rmpc_bench.execution.shards import LIBRARIES, Shard, join_libraries, readable_shards, shards_in
from rmpc_bench.received.plain_files import DamagedError, StoreError
from rmpc_bench.received.store import FILE, MissingError, WriteError, is_filled
from rmpc_bench.replaced_file import inside, refuse_outside, replaced
from rmpc_bench.results import manifest
from rmpc_bench.results.imported import refuse_imported
from rmpc_bench.results.record import PointMethod, StoredExperiment, read_experiment, write_experiment
from rmpc_bench.store.columns import said_runs
from rmpc_bench.store.differences import Names, changes
from rmpc_bench.store.store import Store
from rmpc_bench.types import Array
from rmpc_bench.types.errors import check_arguments
from rmpc_bench.types.result_layout import COPIES, SHARDS

KEPT = ("config.yaml", "config.resolved.yaml", "tuning.json")
"""Files of the configuration, and the record of its tuning, which a shard writes to the directory too."""


_Finished = dict[tuple[int, str], Int[Array, " runs"]]
"""Point of the sweep and method -> indices of runs, ascending."""


class Merged(NamedTuple):
    """What was joined."""

    shards: tuple[Shard, ...]
    missing: tuple[str, ...]  # which runs are missing, in words; empty when the experiment is complete


class _Missing(NamedTuple):
    """Trials that no store has."""

    names: tuple[str, ...]  # of the methods
    runs: Bool[Array, " runs"]  # whether a run is missing of any of them
    n: int


class _ShardRecord(NamedTuple):
    """A shard that is about to be joined."""

    shard: Shard
    experiment: StoredExperiment
    libraries: Mapping[str, Mapping[str, Sequence[str]]]
    files: Names  # hash of a source or a data file of the user -> names of its files -> their hashes


def merge(directory: str | Path, *, partial: bool = False, say: Callable[[str], None] = lambda text: None) -> Merged:
    """Join the shards of a directory into its trial store; shards and their stores stay as they are.

    Parameters
    ----------
    directory : of the results
    partial : whether runs may be missing, and shards may still be computed
    say : shows a line to the user

    Returns
    -------
    the shards, and what is missing

    Raises
    ------
    MissingError
        If there are no shards.
    StoreError
        If shards differ in their experiment or their code, or runs are missing without ``partial``; nothing is written
        then.
    WriteError
        If the store cannot be written.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> directory = tempfile.mkdtemp()
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4)
    >>> for shard in ("1/2", "2/2"):
    ...     _ = rmpc_bench.run(config, directory=directory, jobs=1, shard=shard)
    >>> [shard.name for shard in rmpc_bench.merge(directory).shards]
    ['1-of-2', '2-of-2']
    """
    check_arguments(merge, locals())
    place = Path(directory)
    parts, finished = _read(place, partial=partial, say=say)
    if not parts:
        refuse_imported(place)
        raise MissingError(
            f"{place}: there are no shards; `rmpc-bench run CONFIG --shard I/N -o {quote(str(place))}` computes one"
        )
    _check(place, parts)
    try:
        experiment = _joined([part.experiment for part in parts])
        missing = _missing(experiment, finished)
    except (KeyError, IndexError, ValueError):
        raise DamagedError(f"{place}: the layouts of the shards differ, compute the shards again") from None
    if missing.n and not partial:
        raise StoreError("\n".join([f"{place}: the shards are incomplete", *_said(place, missing), _ways_out(place)]))
    with inside(place), Store(place) as store:
        _copy(place, store, experiment, parts, say=say, partial=partial)
        # Rows of a run whose status differs are not copied, so that a run that a shard has may be missing here.
        missing = _missing(experiment, _with_finished({}, experiment, store))
        with _progress(place, store, experiment, missing.n):
            pass
    return Merged(tuple(part.shard for part in parts), tuple(_said(place, missing)))


def _ways_out(directory: Path) -> str:
    run, place = "`rmpc-bench run CONFIG", quote(str(directory))
    return (
        f"{run} --shard I/N -o {place}` computes a shard\n"
        f"{run} --missing -o {place}` computes all runs that are missing\n"
        f"`rmpc-bench merge {place} --partial` joins the runs that are there"
    )


def _read(directory: Path, *, partial: bool, say: Callable[[str], None]) -> tuple[list[_ShardRecord], _Finished]:
    """Read the records of all shards, and which runs they and the directory have: (point, method) -> runs."""
    parts: list[_ShardRecord] = []
    finished: _Finished = {}
    for shard, store in readable_shards(directory, say, also_running=not partial, also_damaged=not partial):
        experiment = read_experiment(store)
        parts.append(_ShardRecord(shard, experiment, store.data(LIBRARIES), store.file_names()))
        finished = _with_finished(finished, experiment, store)
    if parts and is_filled(directory):
        with Store(directory, writable=False) as store:
            finished = _with_finished(finished, parts[0].experiment, store)
    return parts, finished


def _with_finished(finished: _Finished, experiment: StoredExperiment, store: Store) -> _Finished:
    found = dict(finished)
    for number, point in enumerate(experiment.points):
        for name, method in point.methods.items():
            runs = store.finished(method.key, point.metric_keys.values(), point.recording(name), experiment.n_runs)
            found[number, name] = np.union1d(finished.get((number, name), runs), runs)
    return found


def _check(directory: Path, parts: Sequence[_ShardRecord]) -> None:
    """Refuse shards of different experiments, of different code, or of different versions of a user's libraries."""
    first, lines = parts[0], list[str]()
    for part in parts[1:]:
        if part.experiment.hash != first.experiment.hash:
            lines.append(f"{part.shard.name} is a shard of another experiment than {first.shard.name}")
    here = code_version()
    for part in parts:
        for name, method in _methods(part.experiment).items():
            if any(method.code.get(key) != value for key, value in here.items()):
                lines.append(f"{part.shard.name}: {name} was computed by another version of the bench than this one")
                continue
            other = _methods(first.experiment).get(name, method)
            if other.code != method.code:
                what = changes(other.code, method.code, {**first.files, **part.files}).values()
                files = " and ".join(dict.fromkeys(what)) or "its code"
                text = f"{name} was computed by other code than in {first.shard.name} ({files})"
                lines.append(f"{part.shard.name}: {text}")
    lines += _other_libraries(parts)
    if lines:
        lines = [f"  {SHARDS}/{line}" for line in dict.fromkeys(lines)]
        way_out = (
            "compute the shards again with one configuration and one version: "
            f"`rmpc-bench run CONFIG --shard I/N --fresh -o {quote(str(directory))}`"
        )
        raise StoreError("\n".join([f"{directory}: the shards do not belong together", *lines, way_out]))


def _other_libraries(parts: Sequence[_ShardRecord]) -> list[str]:
    """Say which shards were computed with another major or minor version of a library of a user's file."""
    lines, seen = [], dict[tuple[str, str], tuple[Shard, Sequence[str]]]()
    for part in parts:
        for key, libraries in part.libraries.items():
            for library, versions in libraries.items():
                shard, before = seen.setdefault((key, library), (part.shard, versions))
                if not {_series(each) for each in versions} & {_series(each) for each in before}:
                    there = f"{library} {', '.join(before)} in {shard.name}"
                    lines.append(f"{part.shard.name}: computed with {library} {', '.join(versions)}, and with {there}")
    return lines


def _series(version: str) -> tuple[str, ...]:
    """Major and minor version."""
    return tuple(version.split(".")[:2])


def _methods(experiment: StoredExperiment) -> dict[str, PointMethod]:
    return {name: method for point in experiment.points for name, method in point.methods.items()}


def _joined(experiments: Sequence[StoredExperiment]) -> StoredExperiment:
    """Return the record of the first shard, with the largest number of runs and the series of all methods."""
    # The series of a method are missing in the record of a shard that has not computed the method.
    points = []
    for each in zip(*(experiment.points for experiment in experiments), strict=True):
        methods = {
            name: next((other for point in each if (other := point.methods.get(name)) and _has_series(other)), method)
            for name, method in each[0].methods.items()
        }
        points.append(replace(each[0], methods=methods))
    return replace(experiments[0], n_runs=max(each.n_runs for each in experiments), points=tuple(points))


def _has_series(method: PointMethod) -> bool:
    return bool(method.series) or method.moments is not None


def _missing(experiment: StoredExperiment, finished: _Finished) -> _Missing:
    """Find the trials that no store has; trials that points of a sweep share count once."""
    names, anywhere, count = dict[str, None](), np.zeros(experiment.n_runs, dtype=bool), 0
    seen = set[str]()
    for (number, name), runs in finished.items() if experiment.has_runs else ():
        key = experiment.points[number].methods[name].key
        lacks = np.ones(experiment.n_runs, dtype=bool)
        lacks[runs] = False
        if key not in seen and lacks.any():
            names[name], count = None, count + int(lacks.sum())
            anywhere |= lacks
        seen.add(key)
    return _Missing(tuple(names), anywhere, count)


def _said(directory: Path, missing: _Missing) -> list[str]:
    """Say which runs are missing: of every shard where there is one division into shards, else of all."""
    if not missing.n:
        return []
    runs = said_runs(np.flatnonzero(missing.runs))
    return [f"  runs {runs} are missing ({', '.join(missing.names)})", *_lost(directory)]


def _lost(directory: Path) -> list[str]:
    there = shards_in(directory, FILE)
    counts = {shard.total for shard in there}
    if len(counts) != 1:
        return []
    [count] = counts
    lost = [Shard(number, count).name for number in range(1, count + 1) if Shard(number, count) not in there]
    return [f"  shards without a store: {', '.join(lost)}"] if lost else []


def _copy(
    directory: Path,
    store: Store,
    experiment: StoredExperiment,
    parts: Sequence[_ShardRecord],
    *,
    say: Callable[[str], None],
    partial: bool,
) -> None:
    """Copy rows, arrays, configuration and manifests of the shards into the directory."""
    arrays: dict[str, Array] = {}
    wanted, taken = _array_names(experiment), {part.shard for part in parts}
    for shard, other in readable_shards(
        directory, lambda text: None, also_running=not partial, also_damaged=not partial
    ):
        if shard not in taken:
            continue
        store.claim(experiment.hash, other.data("shared"), other.file_names())
        store.copy_from(other)
        join_libraries(store, other)
        here = _array_names(read_experiment(other)) & wanted
        arrays |= {name: other.array(name) for name in here - arrays.keys()}
    write_experiment(store, experiment, arrays)
    places = {shard.name: shard.directory(directory) for shard in sorted(taken)}
    _keep_configuration(directory, [*places.values()])
    for text in manifest.join(directory, places):
        say(text)


def _array_names(experiment: StoredExperiment) -> set[str]:
    """Return the names of all arrays that a record needs."""
    names: set[str | None] = set()
    for point in experiment.points:
        names.add(point.reference)
        for method in point.methods.values():
            names |= {*method.series.values(), *(method.moments or ())}
    return {name for name in names if name is not None}


def _keep_configuration(directory: Path, places: Sequence[Path]) -> None:
    """Copy what the directory lacks: the configuration and the user's files of the shards."""
    try:
        for place in places:
            check_copies(place)
            for file in (*KEPT, *(str(path.relative_to(place)) for path in (place / COPIES).rglob("*"))):
                source, target = place / file, directory / file
                # A link of a directory that somebody else made may lead to any file.
                if source.is_file() and source.resolve() == place.resolve() / file and not target.exists():
                    refuse_outside(target.parent)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    with replaced(target) as partial:
                        shutil.copyfile(source, partial)
    except OSError as error:
        raise WriteError(str(error)) from None


def _progress(directory: Path, store: Store, experiment: StoredExperiment, n_missing: int) -> ProgressFile:
    """Return the progress file of the whole experiment."""
    columns: dict[str, Column] = {}
    for number, point in enumerate(experiment.points if experiment.has_runs else ()):
        metric = point.metric_keys.get(experiment.primary)
        for name, method in point.methods.items():
            columns.setdefault(method.key, Column(number, point.title, name, method.key, metric))
    n_runs, given = experiment.n_runs, (experiment.name, experiment.hash)
    extent = Extent(
        *given, n_runs, experiment.methods, experiment.primary, tuple(columns.values()), len(columns) * n_runs
    )
    return ProgressFile(directory, extent, range(n_runs), store, n_left=n_missing)
