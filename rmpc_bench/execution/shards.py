"""Shards: ranges of the runs of an experiment; a batch job computes one of them into a trial store of its own.

A shard I of N has the runs of all methods in one contiguous range.  Its store is in ``shards/I-of-N`` of the results
directory.  Random numbers depend on the run only, so the shards together have the trials of the whole experiment.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from rmpc_bench.received.plain_files import DamagedError
from rmpc_bench.simulation.ensemble import SIZE

FOLDER = "shards"
"""Directory of the shards in a results directory."""
MOST_SHIFT = 0.1
"""How far the end of a shard may move to the end of a group of runs, as a share of the runs of a shard."""
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
        return results / FOLDER / self.name


def _end(number: int, count: int, n_runs: int) -> int:
    """Return the end of a shard: equal, rounded to groups of runs where that changes the size little (`MOST_SHIFT`)."""
    end = number * n_runs // count
    of_group = min(round(end / SIZE) * SIZE, n_runs)
    return of_group if abs(of_group - end) * count <= MOST_SHIFT * n_runs else end


def parse_shard(text: str) -> Shard:
    """Read ``I/N``."""
    found = _TEXT.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"{text!r} is neither I/N, such as 2/7, nor 'auto'")
    shard = Shard(int(found[1]), int(found[2]))
    if not 1 <= shard.number <= shard.total:
        raise ValueError(f"{text!r}: the shards of {shard.total} are 1/{shard.total} to {shard.total}/{shard.total}")
    return shard


def shards_in(results: Path, file: str) -> dict[Shard, Path]:
    """Return the shards of a results directory that have a file, with their directories, in their order.

    A DamagedError says that one is a symbolic link: opening a store completes its last write, also outside.
    """
    if not (results / FOLDER).is_dir():
        return {}
    names = ((_NAME.fullmatch(path.name), path) for path in (results / FOLDER).iterdir())
    found = {Shard(int(name[1]), int(name[2])): path for name, path in names if name and (path / file).exists()}
    for path in (results / FOLDER, *found.values()):
        if path.is_symlink():
            raise DamagedError(f"{path}: is a symbolic link; replace it by a directory")
    return {shard: found[shard] for shard in sorted(found, key=lambda shard: (shard.total, shard.number))}
