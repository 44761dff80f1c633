"""Installed packages: their versions, and their components, from entry points of groups such as ``rmpc_bench.plants``.

A component is loaded when a configuration uses it.  A package that cannot be loaded is an error of the configuration
that uses it, and of no other command.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from typing import Any


class BrokenPackageError(Exception):
    """An installed component that cannot be loaded, or whose name is not unique."""


@dataclass(frozen=True)
class InstalledComponent:
    """A component of an installed package."""

    name: str  # name of the entry point
    points: tuple[EntryPoint, ...]  # entry points with this name; more than one if several packages have it

    @property
    def origin(self) -> str:
        """Distribution and version, such as ``my-package 1.2``."""
        return " and ".join(_origin(point) for point in self.points)

    def load(self) -> Any:
        """Import the component; a BrokenPackageError says that this fails, or that several packages have the name."""
        if len(self.points) > 1:
            packages = " and ".join(_package(point) for point in self.points)
            written = " or ".join(f"{_package(point)}:{self.name}" for point in self.points)
            raise BrokenPackageError(f"{self.name!r} is in {packages}; write {written}")
        try:
            return self.points[0].load()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever the import of another package raises
            reason = f"{type(error).__name__}: {error}".splitlines()[0]
            raise BrokenPackageError(f"{self.points[0].value} of {self.origin} cannot be loaded ({reason})") from error


@cache
def installed(group: str) -> Mapping[str, InstalledComponent]:
    """Return the installed components of a group of the registry: by their names, and by ``package:name``."""
    named: dict[str, list[EntryPoint]] = {}
    for point in sorted(entry_points(group=f"rmpc_bench.{group}"), key=_package):
        named.setdefault(point.name, []).append(point)
    found = {name: InstalledComponent(name, tuple(points)) for name, points in named.items()}
    whole = {
        f"{_package(point)}:{name}": InstalledComponent(name, (point,))
        for name, points in named.items()
        for point in points
    }
    return found | whole


@cache
def version_of(library: str) -> str:
    """Return the version of an installed library, "" if it is not there; a process looks once, which takes long."""
    try:
        return version(library)
    except PackageNotFoundError:
        return ""


def _package(point: EntryPoint) -> str:
    """Name of the distribution, normalised; of the module where there is none."""
    name = point.value.split(".")[0].split(":")[0] if point.dist is None else point.dist.name
    return re.sub(r"[-_.]+", "-", name).lower()


def _origin(point: EntryPoint) -> str:
    return _package(point) if point.dist is None else f"{_package(point)} {point.dist.version}"
