"""Installed modules: where they lie, and the distribution and version that they belong to; nothing is imported."""

from __future__ import annotations

import sys
import sysconfig
from functools import lru_cache
from pathlib import Path

_OWN = "rmpc_bench"
_INSTALLED = ("site-packages", "dist-packages")
_found_installed: set[str] = set()
"""Modules that this process has found to be installed."""


def is_standard(module: str) -> bool:
    """Whether a module belongs to the standard library or to the bench itself."""
    return module in sys.stdlib_module_names or module == _OWN


def local_directory(module: str) -> Path | None:
    """Return the directory on the path of Python in which a module lies that is not installed there.

    Such a module is found through PYTHONPATH, the current directory or an editable installation: its source may change
    while its version does not.
    """
    if is_standard(module) or module in _found_installed:
        return None
    for finder in sys.meta_path:
        # A module of this name that another file has loaded must not be found, so that `sys.modules` is not asked.
        find = getattr(finder, "find_spec", None)
        spec = find(module, None) if find is not None else None
        if spec is not None:
            break
    else:
        return None
    inside = list(spec.submodule_search_locations or ())
    if not spec.has_location and not inside:
        return None
    # A package lies one level deeper than its directory; one without __init__.py has no file.
    place = Path(inside[0]).parent if inside else Path(str(spec.origin)).parent
    if not _is_installed(place):
        return place.absolute()
    # An installed module stays where it is; a local one may be added at any time.
    _found_installed.add(module)
    return None


def _is_installed(directory: Path) -> bool:
    standard = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib")}
    return any(part in _INSTALLED for part in directory.parts) or str(directory) in standard


@lru_cache(maxsize=256)
def distribution_of(module: str) -> tuple[str, str] | None:
    """Return name and version of the distribution that provides a module; None where there is none."""
    from importlib.metadata import PackageNotFoundError, packages_distributions, version

    try:
        # Most distributions have the name of their module; to look in all of them takes half a second.
        return _canonical(module), version(module)
    except PackageNotFoundError:
        pass
    for name in packages_distributions().get(module, ()):
        return _canonical(name), version(name)
    return None


def _canonical(name: str) -> str:
    return name.lower().replace("_", "-").replace(".", "-")
