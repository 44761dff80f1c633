"""Shards: a batch job computes the runs of all methods in one range, with a store in ``shards/I-of-N`` of the results.

Which shard this process computes is given, or read from the variables of a batch scheduler.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from shlex import quote
from typing import NamedTuple

from jaxtyping import Int

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.received.plain_files import DamagedError, StoreError
from rmpc_bench.received.store import FILE, MissingError, OccupiedError, is_filled
from rmpc_bench.simulation.ensemble import SIZE
from rmpc_bench.simulation.recording import kept
from rmpc_bench.store.store import Store
from rmpc_bench.types import Array
from rmpc_bench.types.result_layout import SHARDS

MOST_SHIFT = 0.1
"""How far the end of a shard may move to the end of a group of runs, as a share of the runs of a shard."""
LIBRARIES = "libraries"
"""Value of a store: key of the trials -> library of a user's files -> the versions that have computed them."""
SECONDS = 30.0
"""Longest time that `qstat` may take [s]."""
_CORES = ("SLURM_CPUS_PER_TASK", "NSLOTS", "PBS_NUM_PPN", "NCPUS")
"""Variables with the cores of a job: of SLURM, SGE, TORQUE and PBS Pro."""
_SLURM = "SLURM_ARRAY_TASK_ID"
_INDICES = {
    _SLURM: ("SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_MAX", "SLURM_ARRAY_TASK_STEP"),
    "SGE_TASK_ID": ("SGE_TASK_FIRST", "SGE_TASK_LAST", "SGE_TASK_STEPSIZE"),
}
"""Index of a task -> first index, last index and step of its array; PBS has no variables for these."""
_TEXT = re.compile(r"(\d{1,5})/(\d{1,5})")
_NAME = re.compile(r"([1-9]\d{0,4})-of-([1-9]\d{0,4})")


class Shard(NamedTuple):
    """Shard `number` of `total` shards; numbers count from 1."""

    number: int
    total: int

    def __str__(self) -> str:
        return f"{self.number}/{self.total}"

    @property
    def name(self) -> str:
        """Name of its directory."""
        return f"{self.number}-of-{self.total}"

    def runs(self, n_runs: int) -> range:
        """Return the runs of this shard; the shards of an experiment have each run once."""
        return range(_end(self.number - 1, self.total, n_runs), _end(self.number, self.total, n_runs))

    def directory(self, results: Path) -> Path:
        """Return the directory of this shard in a results directory."""
        return results / SHARDS / self.name


def _end(number: int, count: int, n_runs: int) -> int:
    """Return the end of a shard: equal, rounded to groups of runs where that changes the size little (`MOST_SHIFT`)."""
    end = number * n_runs // count
    of_group = min(round(end / SIZE) * SIZE, n_runs)
    return of_group if abs(of_group - end) * count <= MOST_SHIFT * n_runs else end


def parse_shard(text: str) -> Shard:
    """Read ``I/N``."""
    found = _TEXT.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"shard {text!r} is neither I/N, such as 2/7, nor 'auto'")
    shard = Shard(int(found[1]), int(found[2]))
    if not 1 <= shard.number <= shard.total:
        raise ValueError(
            f"shard {text!r}: the shards of {shard.total} are 1/{shard.total} to {shard.total}/{shard.total}"
        )
    return shard


def shards_in(results: Path, file: str) -> dict[Shard, Path]:
    """Return the shards of a results directory that have a file, with their directories, in their order.

    A DamagedError says that one is a symbolic link: opening a store completes its last write, also outside.
    """
    if not (results / SHARDS).is_dir():
        return {}
    names = ((_NAME.fullmatch(path.name), path) for path in (results / SHARDS).iterdir())
    found = {Shard(int(name[1]), int(name[2])): path for name, path in names if name and (path / file).exists()}
    for path in (results / SHARDS, *found.values()):
        if path.is_symlink():
            raise DamagedError(f"{path}: is a symbolic link; replace it by a directory")
    return {shard: found[shard] for shard in sorted(found, key=lambda shard: (shard.total, shard.number))}


def stored_in(
    directory: Path, config: ExperimentConfig, methods: Collection[str], say: Callable[[str], None]
) -> dict[str, Int[Array, " stored"]]:
    """Return key of a method -> its runs that the store of a directory has; a shard does not compute these again."""
    if not is_filled(directory):
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
            say(f"left out: {SHARDS}/{shard.name}, which is being computed")
            continue
        except (StoreError, MissingError) as error:
            if also_damaged:
                raise
            say(f"left out: {SHARDS}/{shard.name}, which cannot be read ({error})")
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


class ArrayJobError(Exception):
    """The shard of this process cannot be found from its environment."""


class _Array(NamedTuple):
    """Indices of an array job: first, first + step, .., last."""

    first: int
    last: int
    step: int

    @property
    def size(self) -> int:
        return (self.last - self.first) // self.step + 1


def n_cores(environment: Mapping[str, str]) -> int:
    """Return the number of cores of the batch job, at most those that this process may use."""
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    given = [int(environment[name]) for name in _CORES if environment.get(name, "").isdecimal()]
    return max(1, min([here, *given[:1]]))


def shard_of_array_job(environment: Mapping[str, str]) -> Shard:
    """Return the shard of the task of an array job of SLURM, PBS or SGE; `ArrayJobError` where it is none."""
    for name, (first, last, step) in _INDICES.items():
        if environment.get(name, "undefined") != "undefined":  # as SGE says outside of an array
            array = _Array(_number(environment, first), _number(environment, last), _number(environment, step, "1"))
            if name == _SLURM:
                _refuse_gaps(environment, array)
            return _shard(environment, name, array)
    for name in ("PBS_ARRAY_INDEX", "PBS_ARRAYID"):
        if name in environment:
            return _pbs(environment, name)
    raise ArrayJobError(
        "this process is no task of an array job: none of SLURM_ARRAY_TASK_ID, PBS_ARRAY_INDEX, PBS_ARRAYID and "
        "SGE_TASK_ID is set; give I/N"
    )


def _refuse_gaps(environment: Mapping[str, str], array: _Array) -> None:
    if (count := _number(environment, "SLURM_ARRAY_TASK_COUNT")) != array.size:
        raise ArrayJobError(
            f"the array has {count} of the {array.size} indices from {array.first} to {array.last}: --shard auto needs "
            "a range without gaps; give I/N"
        )


def _pbs(environment: Mapping[str, str], name: str) -> Shard:
    """Ask `qstat` for the indices: PBS sets the index of the task only."""
    job = environment.get("PBS_ARRAY_ID") or environment.get("PBS_JOBID") or ""
    way_out = f"give --shard with the number of tasks, such as $(({name}))/7 for an array that begins with 1"
    try:
        command = ["qstat", "-f", job]
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=True)
    except (OSError, subprocess.SubprocessError) as error:
        raise ArrayJobError(
            f"`qstat -f {job}` does not show how many tasks the array has ({error}); {way_out}"
        ) from None
    # PBS Pro has the first name, TORQUE the second, with the largest number of running tasks after a %.
    found = re.search(
        r"(?:array_indices_submitted|job_array_request) = (\d+)(?:-(\d+))?(?::(\d+))?(?:%\d+)?\s", done.stdout
    )
    if found is None:
        raise ArrayJobError(f"`qstat -f {job}` shows no range of indices of the array; {way_out}")
    first = int(found[1])
    return _shard(environment, name, _Array(first, int(found[2] or first), int(found[3] or 1)))


def _shard(environment: Mapping[str, str], name: str, array: _Array) -> Shard:
    index = _number(environment, name)
    if array.step < 1 or index not in range(array.first, array.last + 1, array.step):
        text = f"{array.first}-{array.last}" + (f":{array.step}" if array.step != 1 else "")
        raise ArrayJobError(f"{name} is {index}, which is not an index of the array {text}; give I/N")
    return Shard((index - array.first) // array.step + 1, array.size)


def _number(environment: Mapping[str, str], name: str, default: str = "") -> int:
    text = environment.get(name, default)
    try:
        return int(text)
    except ValueError:
        raise ArrayJobError(f"{name} must be a whole number (got {text!r}); give I/N") from None
