"""State of the derived files of a directory, so that `run` with nothing to do computes and draws nothing again.

`published.json` has a fingerprint of everything that the files were made from, the size and time of every file, and
what the command line has shown.  If the trial store, the configuration, the code of this package, a library or a file
has changed, the files are written again.  Experiments with own components are always published again, as their code
may read anything.  Imports neither pandas nor matplotlib.
"""

from __future__ import annotations

import json
import os
import platform
import stat
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rmpc_bench
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.tree import plain
from rmpc_bench.execution.database import FILE as STORE
from rmpc_bench.execution.engines.tasks import has_own_code
from rmpc_bench.replaced_file import replace_text

if TYPE_CHECKING:
    from rmpc_bench.execution.publish import Publication

FILE = "published.json"
KEPT = ("config.yaml", "config.resolved.yaml", "manifest.json")
"""Files that are not derived from trials, but written with them."""
_LIBRARIES = ("numpy", "scipy", "pandas", "matplotlib", "jinja2", "fonttools")
"""Libraries that decide what is in the derived files."""
_COUNTER = slice(24, 28)
"""Bytes of an SQLite file that count its changes."""


@dataclass(frozen=True)
class Shown:
    """What the command line shows of published results.

    Parameters
    ----------
    notes : lines for stderr
    head, tail : the text at the end of a run before and after its time
    timed : whether the text has a time
    is_final : whether these are the results of the configuration as its file states it
    codes : exit code without and with ``--strict``
    """

    notes: list[str]
    head: str
    tail: str
    timed: bool
    is_final: bool
    codes: list[int]

    def text(self, seconds: float) -> str:
        """Return the text at the end of a run.

        Parameters
        ----------
        seconds : how long the command took [s]
        """
        return f"{self.head} done in {seconds:.1f} s{self.tail}" if self.timed else self.head

    @classmethod
    def of(cls, written: Publication, notes: Sequence[str], codes: Sequence[int]) -> Shown:
        """Return what is shown of results that have just been published.

        Parameters
        ----------
        written : what `publish` has returned
        notes : lines for stderr
        codes : exit code without and with ``--strict``
        """
        head, time, tail = written.summary(0.0).partition(" done in 0.0 s")
        return cls([*notes], head, tail, bool(time), written.results.is_final, [*codes])


def up_to_date(config: ExperimentConfig, directory: Path, options: Collection[str]) -> Shown | None:
    """Return what was shown where no trial is missing and every derived file is as it was written; else None.

    Parameters
    ----------
    config : the experiment
    directory : of its results
    options : options that decide what is computed or shown
    """
    try:
        data = json.loads((directory / FILE).read_text(encoding="utf-8"))
        files: Mapping[str, Any] = data["files"]
        if data["fingerprint"] != _fingerprint(config, directory, options):
            return None
        if any(_mark(directory / name) != mark for name, mark in files.items()):
            return None
        return Shown(**data["shown"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        # There is no such file, or not one of this version.
        return None


def keep_state(
    config: ExperimentConfig, directory: Path, options: Collection[str], paths: Iterable[Path], shown: Shown
) -> None:
    """Note what was published, and from what.

    Parameters
    ----------
    config, directory, options : as in `up_to_date`
    paths : the derived files
    shown : what the command line shows
    """
    fingerprint = _fingerprint(config, directory, options)
    (directory / FILE).unlink(missing_ok=True)
    if fingerprint is None:
        return
    files = {path.relative_to(directory).as_posix(): _mark(path) for path in paths}
    files |= {name: _mark(directory / name) for name in KEPT}
    data = {"fingerprint": fingerprint, "shown": asdict(shown), "files": files}
    replace_text(directory / FILE, json.dumps(data, indent=1) + "\n")


def _fingerprint(config: ExperimentConfig, directory: Path, options: Collection[str]) -> str | None:
    """Hash everything that the derived files are made from; None where own code takes part or a writer was killed."""
    experiments = [point.experiment for point in config.points]
    own = any(has_own_code(experiment, method) for experiment in experiments for method in experiment.methods)
    if own or config.own.names() or not all(figure.is_built_in for figure in config.figures):
        return None
    store = directory / STORE
    if store.with_name(f"{STORE}-journal").exists():
        return None
    with store.open("rb") as file:
        counter = file.read(100)[_COUNTER].hex()
    parts = [
        str(directory),
        *sorted(options),
        config.path.read_bytes(),
        plain(config.resolved),
        [*config.overrides, *sorted(config.added.items()), *config.left_out],
        [counter, _mark(store)],
        [platform.python_version(), rmpc_bench.__version__, *map(_version, _LIBRARIES)],
        _sources(),
    ]
    return sha256(repr(parts).encode()).hexdigest()


def _sources() -> list[tuple[str, int, int]]:
    """Size and time of every file of this package: while it is developed, its version does not change."""
    found = []
    for folder, folders, names in os.walk(Path(rmpc_bench.__file__).parent):
        folders[:] = sorted({*folders} - {"__pycache__", "configs"})
        for name in sorted(names):
            status = os.stat(os.path.join(folder, name))
            found.append((name, status.st_size, status.st_mtime_ns))
    return found


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return ""


def _mark(path: Path) -> list[int]:
    """Size and time of a regular file; OSError for any other."""
    status = path.lstat()
    if not stat.S_ISREG(status.st_mode):
        raise OSError(f"{path} is not a regular file")
    return [status.st_size, status.st_mtime_ns]
