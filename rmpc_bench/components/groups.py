"""Which kind of component something in a user's file is."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from rmpc_bench.components.single_run import is_single_run
from rmpc_bench.components.user_class import METHODS
from rmpc_bench.types.contract import BASES

_ARGUMENTS: Mapping[str, frozenset[str]] = {
    "estimators": frozenset({"x0", "P0", "M0"}),
    "controllers": frozenset({"estimator"}),
    "references": frozenset({"ny"}),
    "noises": frozenset({"n"}),
}
"""Group -> arguments that only design functions of this group receive."""


def group_of(found: Any) -> str | None:
    """Return the group of the registry that a class or a function belongs to; None where its text does not show it.

    Examples
    --------
    >>> def design(model, n_steps, *, x0, P0, c=1.0): ...
    >>> group_of(design)
    'estimators'
    """
    if isinstance(found, type):
        base = next((group for group, kind in BASES.items() if issubclass(found, kind) and found is not kind), None)
        if base is not None:
            return base
    if is_single_run(found) and isinstance(found, type):
        return next((group for group, each in METHODS.items() if any(_has(found, names) for names in each)), None)
    return _group_of_function(found) if inspect.isfunction(found) else None


def _has(kind: type, names: tuple[str, ...]) -> bool:
    return all(callable(getattr(kind, name, None)) for name in names)


def _group_of_function(function: Callable[..., Any]) -> str | None:
    """Return the group by the annotation of what a function returns, or by arguments that only one group receives."""
    returned = inspect.get_annotations(function).get("return")
    name = returned if isinstance(returned, str) else getattr(returned, "__name__", "")
    by_name = {kind.__name__: group for group, kind in BASES.items()}
    if name.rpartition(".")[2] in by_name:
        return by_name[name.rpartition(".")[2]]
    taken = {*inspect.signature(function).parameters}
    if is_single_run(function):
        return "controllers" if "x_hat" in taken and "u" not in taken else "metrics"
    return next((group for group, words in _ARGUMENTS.items() if words & taken), None)


def components_in(module: Any) -> dict[str, str]:
    """Return the components that a module defines itself, with their groups."""
    own = {name: value for name, value in vars(module).items() if getattr(value, "__module__", None) == module.__name__}
    groups = {name: group_of(value) for name, value in own.items() if not name.startswith("_")}
    return {name: group for name, group in sorted(groups.items()) if group is not None}
