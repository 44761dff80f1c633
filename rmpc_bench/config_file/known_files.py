"""Configurations that have a name: the files below ``configs``, and those that are installed with this package.

A configuration is named by its place, ``configs/zenere2018/fig7.yaml``, by ``zenere2018/fig7``, or by ``fig7`` where no
other has this name.  A file of the current directory always comes before an installed one.  Imports no NumPy, so that
the names are listed at once.
"""

from __future__ import annotations

import os
from difflib import get_close_matches
from pathlib import Path

import rmpc_bench
from rmpc_bench.received.plain_files import note_absent

FOLDER = "configs"
SUFFIX = ".yaml"
MAX_NAME = 1000  # largest number of characters of a file name


def installed_folder() -> Path:
    """Return the directory of the installed configurations; in a checkout it is the one beside the package."""
    package = Path(rmpc_bench.__file__).parent
    inside = package / FOLDER
    return inside if inside.is_dir() else package.with_name(FOLDER)


def known_configs() -> list[str]:
    """Places of all configurations that have a name, such as ``configs/quickstart.yaml``."""
    return sorted({*_places(Path(FOLDER)), *_places(installed_folder())})


def short_names(place: str) -> list[str]:
    """Return the short names of ``configs/zenere2018/fig7.yaml``: ``zenere2018/fig7`` and ``fig7``."""
    inside = Path(place).relative_to(FOLDER).with_suffix("")
    return [inside.as_posix(), inside.name]


def files_of(name: str) -> list[Path]:
    """Return the files that a place below configs or a short name may mean, those of the current directory first."""
    for folder in (Path(FOLDER), installed_folder()):
        found = [place for place in _places(folder) if name == place or name in short_names(place)]
        if found:
            return [folder / Path(place).relative_to(FOLDER) for place in found]
    return []


def is_file_name(text: object) -> bool:
    """Whether a value may be the name of a file; the operating system refuses others."""
    return isinstance(text, str) and bool(text.strip()) and len(text) <= MAX_NAME and "\0" not in text


def file_beside(directory: Path, name: str) -> Path:
    """Return the file that a configuration names in ``extends`` or ``plant.from``, relative to its directory.

    If there is none, the name is a place below configs or a short name of an installed configuration.
    """
    file, folder = directory / name, installed_folder()
    if os.path.exists(file) or not is_file_name(name):
        return file
    note_absent(file)
    found = [place for place in _places(folder) if name == place or name in short_names(place)]
    return folder / Path(found[0]).relative_to(FOLDER) if len(found) == 1 else file


def located(given: str | Path) -> Path:
    """Return the file of a configuration that is given by a path, or by a place below configs or a short name.

    Raises a ConfigError if a name may mean several configurations, or is neither a file nor a name.
    """
    path, name = Path(given), Path(given).as_posix()
    is_name = path.suffix != SUFFIX or path.parts[:1] == (FOLDER,)
    if os.path.isfile(path) or not is_name:
        return path
    found = files_of(name)
    if len(found) == 1:
        return found[0]
    if len(found) > 1:
        raise _error(name, f"may be any of {', '.join(map(str, found))}")
    if os.path.exists(path):
        # What cannot be read as a configuration is described by the reader.
        return path
    known = known_configs()
    names = known if path.suffix == SUFFIX else [short for place in known for short in short_names(place)]
    near = get_close_matches(name, names, n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    raise _error(name, f"there is no such file{hint} (rmpc-bench list configs)")


def _error(name: str, message: str) -> Exception:
    # Imported here because `types` needs NumPy, and the names of configurations are listed without it.
    from rmpc_bench.types import ConfigError, Problem

    return ConfigError([Problem(name, 1, 1, "", message)])


def _places(folder: Path) -> list[str]:
    """Places of the files of a directory, as if it were ``configs``."""
    return sorted(f"{FOLDER}/{path.relative_to(folder).as_posix()}" for path in folder.rglob(f"*{SUFFIX}"))
