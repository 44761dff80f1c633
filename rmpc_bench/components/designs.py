"""From a kind or a reference to a design function, whatever the user has written: a function or a class."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.code import CodeError, CodeReference
from rmpc_bench.components.loading import load
from rmpc_bench.components.single_run import design_function
from rmpc_bench.installed import BrokenPackageError
from rmpc_bench.types.errors import DesignError

DesignFunction = Callable[..., Any]


def replacement_of(group: str, kind: str) -> str:
    """Say what has become of a component that has another name now; empty for any other one."""
    known = registry.RENAMED_FIGURES if group == "figures" else {}
    return registry.unknown_kind(kind, group) if kind in known else ""


def is_built_in(group: str, kind: str) -> bool:
    """Whether a kind is one of this package; a component from a file is not."""
    return kind in registry.BUILT_IN[group]


def registered_design(group: str, kind: str) -> DesignFunction:
    """Return the design function of a registered kind."""
    try:
        design = registry.get(group, kind)
    except BrokenPackageError as error:
        raise CodeError(str(error)) from None
    return design if is_built_in(group, kind) else _design(group, design, kind)


def loaded_design(group: str, reference: CodeReference) -> DesignFunction:
    """Return the design function that a reference names."""
    return _design(group, load(reference), reference.text)


def _design(group: str, found: Any, name: str) -> DesignFunction:
    try:
        return _cached(group, found)
    except DesignError as error:
        raise CodeError(f"{name}: {error}") from None


@cache
def _cached(group: str, found: Any) -> DesignFunction:
    """One function for every component, since the keys of a function are read once."""
    return design_function(group, found)
