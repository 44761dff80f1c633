"""State of the derived files of a directory, so that `run` with nothing to do computes and draws nothing again.

`published.json` has a fingerprint of everything that the files were made from, the size and time of every file, and
what the command line has shown.  If the trial store, the configuration, the code of this package, a library or a file
has changed, the files are written again.  Experiments with own components are always published again, as their code
may read anything.

The same command on the same files has the same configuration.  So the file also has the command, the hash of every file
that was read for its configuration and what was said about it: `unchanged` needs neither the configuration nor NumPy.
"""

from __future__ import annotations

import json
import os
import platform
import stat
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rmpc_bench
from rmpc_bench.installed import version_of
from rmpc_bench.received.plain_files import DamagedError, content_of, json_of
from rmpc_bench.received.store import FILE as STORE
from rmpc_bench.replaced_file import replace_text

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig


FILE = "published.json"
PROGRESS = "progress.json"
KEPT = ("config.yaml", "config.resolved.yaml", "manifest.json")
"""Files that are not derived from trials, but written with them."""
TUNING = "tuning.json"  # record of a tuning, from which values of the configuration come
_LIBRARIES = ("numpy", "scipy", "pandas", "matplotlib", "jinja2", "fonttools", "pydantic", "pyyaml")
"""Libraries that decide what is in the configuration and in the derived files."""
_SHAPE = {
    "fingerprint": str,
    "state": (str, None),
    "command": {"arguments": [str], "read": {str: str}, "beside": [str]},
    "shown": {"said": list, "notes": list, "lines": list, "width": int, "uncompared": bool, "codes": [int]},
    "files": {str: [int]},
}
_COUNTER = slice(24, 28)  # bytes of an SQLite file that count its changes


@dataclass(frozen=True)
class Shown:
    """What the command line shows of published results."""

    said: list[str]  # lines for stderr about the configuration
    notes: list[str]  # lines for stderr about the results
    lines: list[str]  # the text at the end of a run, without its time
    width: int  # columns that it is laid out for
    # whether there are claims, and these are not the results of the configuration as its file states it
    uncompared: bool
    codes: list[int]  # exit code without and with ``--strict``

    def text(self, seconds: float) -> str:
        """Return the text at the end of a run."""
        return with_time("\n".join(self.lines), seconds, self.width)


def with_time(text: str, seconds: float, width: int) -> str:
    """Put the time of a command [s] behind the first line of a screen, where there is room."""
    first, *rest = text.split("\n")
    timed = f"{first}, {seconds:.1f} s" if seconds < 1.95 else f"{first}, {seconds:.0f} s"
    wide = sum(character > "\u1100" for character in timed)
    has_room = "   " in first and len(timed) + wide <= width and "INTERRUPTED" not in first
    return "\n".join([timed if has_room else first, *rest])


@dataclass(frozen=True)
class Command:
    """A command and the files that its configuration was made from."""

    arguments: list[str]  # everything given that decides the configuration and what is shown
    read: dict[str, str]  # absolute path -> SHA-256 of a file; empty for one that is not there, see `plain_files.noted`
    beside: list[str]  # all configurations in the directory of the first one, as claims name those of other files

    @classmethod
    def of(cls, arguments: Sequence[str], path: Path, read: Mapping[str, str]) -> Command:
        """Return a command whose configuration has been loaded."""
        return cls([os.path.abspath(path), *arguments], {**read}, _configs_beside(path))

    def is_that_of(self, arguments: Sequence[str], path: Path) -> bool:
        """Whether a command has the same configuration as this one had."""
        if self.arguments != [os.path.abspath(path), *arguments] or self.beside != _configs_beside(path):
            return False
        # If the first file was not noted, the others may be missing, too.
        return self.arguments[0] in self.read and all(_hash_of(name) == sha for name, sha in self.read.items())


def unchanged(arguments: Sequence[str], path: Path, directories: Iterable[Path], width: int) -> Shown | None:
    """Return what the same command has shown in a terminal of this width, where nothing has changed; else None."""

    def is_same(data: Mapping[str, Any], directory: Path) -> bool:
        return Command(**data["command"]).is_that_of(arguments, path) and data["state"] == _state(directory)

    found = (_shown(directory, is_same, width) for directory in directories)
    return next((shown for shown in found if shown is not None), None)


def up_to_date(config: ExperimentConfig, directory: Path, options: Collection[str], width: int) -> Shown | None:
    """Return what was shown where no trial is missing and every derived file is as it was written; else None."""

    def is_same(data: Mapping[str, Any], place: Path) -> bool:
        return bool(data["fingerprint"] == _fingerprint(config, place, options))

    return _shown(directory, is_same, width)


def _shown(directory: Path, is_same: Callable[[Mapping[str, Any], Path], bool], width: int) -> Shown | None:
    """Return what a directory has to show if it was made from the same and all its files are as they were written."""
    try:
        data = json_of(directory / FILE, _SHAPE, "")
        if data is None or data["shown"]["width"] != width or not is_same(data, directory):
            return None
        files: Mapping[str, Any] = data["files"]
        # `status` reads it; what it says changes without a change of the results.
        _mark(directory / PROGRESS)
        if any(_mark(directory / name) != mark for name, mark in files.items()):
            return None
        return Shown(**data["shown"])
    except (OSError, TypeError, DamagedError):
        # It is not one of this version; it is written again.
        return None


def keep_state(
    config: ExperimentConfig,
    directory: Path,
    options: Collection[str],
    paths: Iterable[Path],
    shown: Shown,
    command: Command,
) -> None:
    """Note what was published, and from what."""
    fingerprint = _fingerprint(config, directory, options)
    (directory / FILE).unlink(missing_ok=True)
    if fingerprint is None:
        return
    files = {path.relative_to(directory).as_posix(): _mark(path) for path in paths}
    kept = [*KEPT, *([TUNING] if config.tuning is not None and (directory / TUNING).exists() else [])]
    files |= {name: _mark(directory / name) for name in kept}
    data = {
        "fingerprint": fingerprint,
        "state": _state(directory),
        "command": asdict(command),
        "shown": asdict(shown),
        "files": files,
    }
    replace_text(directory / FILE, json.dumps(data, indent=1) + "\n")


def _fingerprint(config: ExperimentConfig, directory: Path, options: Collection[str]) -> str | None:
    """Hash all that derived files are made from; None with own code, another library or a writer that was killed."""
    # They import NumPy.
    from rmpc_bench.config_file.tree import plain
    from rmpc_bench.engines.tasks import has_own_code

    experiments = [point.experiment for point in config.points]
    own = any(has_own_code(experiment, method) for experiment in experiments for method in experiment.methods)
    with_libraries = any(names for point in config.points for names in point.modules.values())
    if own or with_libraries or config.own.names() or not all(figure.is_built_in for figure in config.figures):
        return None
    state = _state(directory)
    parts = [
        state,
        *sorted(options),
        config.path.read_bytes(),
        plain(config.resolved),
        [*config.overrides, *sorted(config.added.items()), *config.left_out],
    ]
    return None if state is None else _hash(parts)


def _state(directory: Path) -> str | None:
    """Hash the trial store, the libraries and the code of this package; None where a writer of the store was killed."""
    store = directory / STORE
    if store.with_name(f"{STORE}-journal").exists():
        return None
    with store.open("rb") as file:
        counter = file.read(100)[_COUNTER].hex()
    versions = [platform.python_version(), rmpc_bench.__version__, rmpc_bench.NUMERICS, *map(version_of, _LIBRARIES)]
    return _hash([str(directory), counter, _mark(store), versions, _sources()])


def _hash(parts: Sequence[Any]) -> str:
    return sha256(repr(parts).encode()).hexdigest()


def _hash_of(path: str) -> str:
    """SHA-256 of a file; empty where it is not there."""
    try:
        return sha256(content_of(path)).hexdigest()
    except FileNotFoundError:
        return ""


def _configs_beside(path: Path) -> list[str]:
    return sorted(each.name for each in path.parent.glob("*.yaml"))


def _sources() -> list[tuple[str, int, int]]:
    """Size and time of every file of this package: while it is developed, its version does not change."""
    found = []
    for folder, folders, names in os.walk(Path(rmpc_bench.__file__).parent):
        folders[:] = sorted({*folders} - {"__pycache__", "configs"})
        for name in sorted(names):
            status = os.stat(os.path.join(folder, name))
            found.append((name, status.st_size, status.st_mtime_ns))
    return found


def _mark(path: Path) -> list[int]:
    """Size and time of a regular file; OSError for any other."""
    status = path.lstat()
    if not stat.S_ISREG(status.st_mode):
        raise OSError(f"{path} is not a regular file")
    return [status.st_size, status.st_mtime_ns]
