"""Trials of shards: what another store of the directory has, and the shards that `run --missing` takes."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from shlex import quote

from jaxtyping import Int

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.execution.database import FILE, MissingError, OccupiedError, StoreError
from rmpc_bench.execution.shards import FOLDER, Shard, shards_in
from rmpc_bench.execution.store import Store
from rmpc_bench.simulation.recording import kept
from rmpc_bench.types import Array

LIBRARIES = "libraries"
"""Value of a store: key of the trials -> library of a user's files -> the versions that have computed them."""


def stored_in(
    directory: Path, config: ExperimentConfig, methods: Collection[str], say: Callable[[str], None]
) -> dict[str, Int[Array, " stored"]]:
    """Return key of a method -> its runs that the store of a directory has; a shard does not compute these again."""
    if not (directory / FILE).exists():
        return {}
    try:
        with Store(directory, writable=False) as store:
            store.check(config.hash, config.shared, config.own.names())
            return {
                key: store.finished(
                    key, point.metric_keys.values(), kept(point.experiment, name), config.experiment.n_runs
                )
                for point in config.points
                for name, key in point.method_keys.items()
                if name in methods
            }
    except OccupiedError:
        say(f"another process writes to {directory / FILE}: its trials are computed again where this shard has them")
        return {}


def take_shards(config: ExperimentConfig, store: Store, say: Callable[[str], None]) -> None:
    """Copy the trials of all shards into the store of their directory; runs of a lost shard are left to compute."""
    taken = []
    for shard, other in readable_shards(store.directory, say):
        other.check(config.hash, config.shared, config.own.names())
        store.copy_from(other)
        join_libraries(store, other)
        taken.append(shard)
    say(f"shards with stored trials: {', '.join(shard.name for shard in taken) or 'none'}")


def readable_shards(
    directory: Path, say: Callable[[str], None], *, also_running: bool = True, also_damaged: bool = False
) -> Iterator[tuple[Shard, Store]]:
    """Open the stores of all shards of a directory, one after the other."""
    for shard, place in shards_in(directory, FILE).items():
        try:
            store = Store(place, writable=False)
        except OccupiedError:
            if also_running:
                text = f"{place} is being computed; wait for its end, or end its process"
                raise StoreError(f"{text} (rmpc-bench status {quote(str(directory))})") from None
            say(f"left out: {FOLDER}/{shard.name}, which is being computed")
            continue
        except (StoreError, MissingError) as error:
            if also_damaged:
                raise
            say(f"left out: {FOLDER}/{shard.name}, which cannot be read ({error})")
            continue
        with store:
            yield shard, store


def join_libraries(store: Store, other: Store) -> None:
    """Note the versions of libraries that have computed the rows of another store."""
    here, there = store.data(LIBRARIES), other.data(LIBRARIES)
    joined = {key: dict(libraries) for key, libraries in here.items()}
    for key, libraries in there.items():
        before = joined.setdefault(key, {})
        for library, versions in libraries.items():
            before[library] = sorted({*before.get(library, []), *versions})
    if joined != here:
        store.set_meta(LIBRARIES, json.dumps(joined))
