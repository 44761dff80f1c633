"""Single-run components that are one function: a control law without memory, or a metric."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from rmpc_bench.components.words import words


def class_of(group: str, method: str, function: Callable[..., Any]) -> type:
    """Return a class whose method calls a function; arguments without a standard name are keys of the configuration."""
    parameters = inspect.signature(function).parameters
    known = words(group, method)
    keys = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for name, each in parameters.items() if name not in known]
    asked = [name for name in parameters if name in known]

    class FunctionComponent:
        """Keys of the function as attributes."""

        def __init__(self, **given: Any) -> None:
            self.given = given

    def call(self: Any, *values: Any) -> Any:
        return function(**dict(zip(asked, values, strict=True)), **self.given)

    of_self = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    of_call = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in asked]
    FunctionComponent.__init__.__signature__ = inspect.Signature([of_self, *keys])  # type: ignore[attr-defined]
    call.__signature__ = inspect.Signature([of_self, *of_call])  # type: ignore[attr-defined]
    setattr(FunctionComponent, method, call)
    FunctionComponent.__name__ = FunctionComponent.__qualname__ = function.__name__
    FunctionComponent.__module__ = function.__module__
    FunctionComponent.__doc__ = function.__doc__
    return FunctionComponent
