"""Optional libraries: the extra of pip that installs each of them, and the kinds of components that need it.

Nothing is imported before `library` is called.  `stand_ins` lets any library be loaded without what it does not use.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

EXTRAS: Mapping[str, str] = {
    "casadi": "casadi",
    "control": "control",
    "do-mpc": "do_mpc",
    "filterpy": "filterpy",
    "fmu": "fmpy",
    "gymnasium": "gymnasium",
    "stonesoup": "stonesoup",
    "xarray": "xarray",
}
"""Extra -> module that it installs; a configuration may require these."""

MODULES: Mapping[str, str] = {**EXTRAS, "dask": "distributed", "pack": "rocrate", "parquet": "pyarrow"}
"""The same with the extras of an engine, an archive and a format."""

RELEASED = False
"""Whether a package index has the package."""

COMPUTES_WITH: Mapping[str, str] = {"do_mpc": "casadi"}
"""Module of an extra -> another library of which the version changes what it computes."""

NEEDED_BY: Mapping[tuple[str, str], str] = {
    ("plants", "env"): "gymnasium",
    ("plants", "casadi"): "casadi",
    ("plants", "control"): "control",
    ("models", "control"): "control",
    ("estimators", "control-lqe"): "control",
    ("controllers", "control-lqr"): "control",
    ("plants", "fmu"): "fmu",
}
"""Group and kind of a built-in component -> the extra that it needs."""


class MissingLibraryError(ImportError):
    """An optional library is not installed; the message says which extra of pip installs it."""


def is_installed(extra: str) -> bool:
    """Whether the module of an extra can be imported; it is not imported."""
    return find_spec(EXTRAS[extra]) is not None


def missing(extra: str) -> str:
    """Say that an extra is not installed.

    Examples
    --------
    >>> missing("do-mpc").partition("; ")[0]
    'the library do_mpc is not installed'
    """
    return f"the library {MODULES[extra]} is not installed; {install(extra)} installs it"


def install(*extras: str) -> str:
    """Return the command that installs some extras, here in a clone or wherever the package is installed."""
    names = ",".join(extras)
    if Path(__file__).parents[1].joinpath("Makefile").is_file():
        return f"make setup EXTRAS=dev,{names}"
    return f"pip install 'rmpc-bench[{names}]'" if RELEASED else f"pip install '.[{names}]' in a clone"


def need(group: str, kind: str) -> str:
    """Say which extra a built-in component needs, and whether it is installed; empty where it needs none."""
    extra = NEEDED_BY.get((group, kind))
    if extra is None:
        return ""
    return f"needs the extra {extra}" + ("" if is_installed(extra) else ", which is not installed")


def missing_for(group: str, kind: str) -> str:
    """Say that the library of a built-in component is not installed; empty where nothing is missing."""
    extra = NEEDED_BY.get((group, kind))
    return "" if extra is None or is_installed(extra) else missing(extra)


def missing_extra(error: BaseException) -> str:
    """Return the extra that installs the library which an import did not find; empty for any other error.

    Examples
    --------
    >>> missing_extra(ModuleNotFoundError("No module named 'numpy.x'", name="numpy.x"))
    ''
    """
    module = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else ""
    return next((extra for extra, name in EXTRAS.items() if name == module and not is_installed(extra)), "")


def library(extra: str, module: str = "") -> Any:
    """Import and return the module of an extra, or a submodule of it such as ``kalman`` of filterpy.

    A MissingLibraryError says that it is not installed.
    """
    if not is_installed(extra):
        raise MissingLibraryError(missing(extra), name=EXTRAS[extra])
    return import_module(".".join(filter(None, [EXTRAS[extra], module])))


@contextmanager
def stand_ins(modules: Mapping[str, Mapping[str, Any] | None]) -> Iterator[None]:
    """Put modules, name -> content, in place of those that a library imports but does not use.

    None makes the import fail.  Modules that are loaded already stay.
    """
    absent = [name for name in modules if name not in sys.modules]
    for name in absent:
        content, small = modules[name], ModuleType(name)
        vars(small).update(content or {})
        sys.modules[name] = small if content is not None else None  # type: ignore[assignment]
    try:
        yield
    finally:
        inside = tuple(f"{name}." for name in absent)
        for name in [*absent, *(each for each in sys.modules if each.startswith(inside))]:
            sys.modules.pop(name, None)
