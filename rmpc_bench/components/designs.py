"""From a kind or a reference to a design function, whatever the user has written: a function or a class."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.code import CodeError, CodeReference
from rmpc_bench.components.loading import load

DesignFunction = Callable[..., Any]


def is_built_in(group: str, kind: str) -> bool:
    """Whether a kind is one of this package; a component from a file is not."""
    return kind in registry.BUILT_IN[group]


def registered_design(group: str, kind: str) -> DesignFunction:
    """Return the design function of a registered kind.

    Parameters
    ----------
    group : of the registry
    kind : a name of `registry.names`
    """
    design = registry.get(group, kind)
    return design if is_built_in(group, kind) else design_function(group, design)


def loaded_design(group: str, reference: CodeReference) -> DesignFunction:
    """Return the design function that a reference names.

    Raises
    ------
    CodeError
        If the file cannot be imported, has no such name, or the name is no component.
    """
    found = load(reference)
    if not callable(found):
        kind, noun = type(found).__name__, registry.singular(group)
        if inspect.ismodule(found):
            kind = "module"
        raise CodeError(f"{reference.text} is a {kind}, not a class or a function that makes a {noun}")
    return design_function(group, found)


def design_function(group: str, found: Any) -> DesignFunction:
    """Return the function that makes the design."""
    made: DesignFunction = found
    return made
