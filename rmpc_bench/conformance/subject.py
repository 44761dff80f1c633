"""The component under test: where it comes from, and how its design is made, in any process."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.code import CodeReference, split_reference
from rmpc_bench.components.loading import load
from rmpc_bench.components.single_run import design_function
from rmpc_bench.types import DesignError
from rmpc_bench.types.contract import BASES


@dataclass(frozen=True)
class Subject:
    """A component under test as a recipe, so that it can be made in every process.

    Parameters
    ----------
    text : how the report names it
    group : group of the registry; empty where it follows from the component
    code : file and name; None for a component of an installed module or of the registry
    module, name : installed module and name in it; a module of ``""`` is a kind of the registry
    keys : keywords of its design function
    """

    text: str
    group: str = ""
    code: CodeReference | None = None
    module: str = ""
    name: str = ""
    keys: Mapping[str, Any] = field(default_factory=dict)

    def loaded(self) -> Any:
        """Import what it names: a class or a function.

        Raises
        ------
        DesignError
            If it cannot be imported.
        """
        if self.code is not None:
            return load(self.code)
        if not self.module:
            return registry.get(self.group, self.name)
        found: Any = import_module(self.module)
        for name in self.name.split("."):
            found = getattr(found, name)
        return found

    def made(self, group: str, provided: Mapping[str, Any]) -> Any:
        """Make the design.

        Parameters
        ----------
        group : group of the registry
        provided : what the bench provides; the design function gets what it asks for

        Raises
        ------
        DesignError
            If a key is missing or unknown, or the result is no component of the group.
        """
        design = design_function(group, self.loaded())
        parameters = inspect.signature(design).parameters
        given = {name: provided[name] for name in parameters if name in provided and wanted(parameters[name], name)}
        unknown = sorted(set(self.keys) - set(parameters))
        if unknown:
            raise DesignError(f"{unknown[0]!r} is no key of it; it has {', '.join(parameters) or 'none'}")
        missing = [
            name
            for name, each in parameters.items()
            if each.default is each.empty and name not in (*given, *self.keys) and each.kind not in _COLLECTING
        ]
        if missing:
            raise DesignError(f"needs a value for {', '.join(missing)}; give it as a key")
        return registry.checked(group, self.text, design(**given, **self.keys), provided)


_COLLECTING = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)


def wanted(parameter: inspect.Parameter, name: str) -> bool:
    """Whether a parameter gets what the bench provides: sets of bounded noises only where there is no default."""
    return name != "M0" or parameter.default is parameter.empty


def subject_of(component: Any, group: str = "", keys: Mapping[str, Any] | None = None) -> Subject:
    """Return the recipe of a component.

    Parameters
    ----------
    component : a class, a design function, ``PATH.py:NAME`` or a name of the registry
    group : group of the registry, such as ``estimators``; found from the component unless given
    keys : keywords of its design function

    Raises
    ------
    DesignError
        If another process could not find it.
    """
    keys = dict(keys or {})
    if isinstance(component, str):
        parts = split_reference(component)
        if parts is None:
            group = group or next((each for each in registry.BUILT_IN if component in registry.names(each)), "")
            if not group:
                raise DesignError(f"{component!r} is neither PATH.py:NAME nor a name of a component")
            return Subject(component, group, None, "", component, keys)
        path, name = Path(parts[0]).resolve(), parts[1]
        return Subject(component, group, CodeReference(path, name, component), "", "", keys)
    name = getattr(component, "__qualname__", "")
    if not name or "<" in name:
        shown = name or f"an object of type {type(component).__name__}"
        raise DesignError(f"{shown} cannot be made in another process; give a class or function of a file")
    return Subject(name, group, *_place(component, name), keys)


def _place(component: Any, name: str) -> tuple[CodeReference | None, str, str]:
    """Return the file of a class or function, or its module where that can be imported by its name."""
    module = sys.modules.get(component.__module__)
    package = component.__module__.partition(".")[0]
    file = getattr(module, "__file__", None)
    installed = package == "rmpc_bench" or file is None or "site-packages" in Path(file).parts
    if installed:
        return None, component.__module__, name
    path = Path(str(file)).resolve()
    return CodeReference(path, name, f"{path.name}:{name}"), "", ""


def groups_of(component: Any) -> Iterator[str]:
    """Return the groups that a component may belong to, the likeliest one first.

    Parameters
    ----------
    component : a class or a design function
    """
    if inspect.isclass(component):
        for group, base in BASES.items():
            if issubclass(component, base):
                yield group
                return
        for method, group in _METHODS:
            if callable(getattr(component, method, None)):
                yield group
                return
    yield from _GUESSES


_METHODS = (
    ("update", "estimators"),
    ("correct", "estimators"),
    ("control", "controllers"),
    ("step", "plants"),
    ("evaluate", "metrics"),
    ("sample", "references"),
)
"""Method of a single-run component -> its group."""
_GUESSES = ("estimators", "controllers", "plants", "references", "noises", "metrics", "figures")
"""Groups that are tried for a design function, whose result says what it is."""


def group_of(subject: Subject, provided: Callable[[str], Mapping[str, Any]]) -> str:
    """Find the group of a component.

    Parameters
    ----------
    subject : the component
    provided : what the bench provides, by group

    Raises
    ------
    DesignError
        If there is none.
    """
    if subject.group:
        return subject.group
    candidates = list(groups_of(subject.loaded()))
    if len(candidates) == 1:
        return candidates[0]
    reasons = []
    for group in candidates:
        try:
            subject.made(group, provided(group))
        except Exception as error:  # a design function may raise anything for the wrong arguments
            reasons.append(f"{registry.singular(group)}: {error}")
            continue
        return group
    raise DesignError(f"{subject.text} is no component ({'; '.join(reasons)}); say which with --group")
