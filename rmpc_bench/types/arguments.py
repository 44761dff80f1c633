"""Arguments of public functions: a value of the wrong type is refused with its name before anything else happens."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import cache
from inspect import get_annotations
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from rmpc_bench.types.errors import DesignError

_NUMBERS: Mapping[Any, type] = {int: Integral, float: Real}


def check_arguments(function: Callable[..., Any], given: Mapping[str, Any]) -> None:
    """Refuse the first argument that does not have the type of its annotation; to be called with ``locals()``.

    Examples
    --------
    >>> def run(name: str, jobs: int | None = None): check_arguments(run, locals())
    >>> run("a", jobs=1.5)
    Traceback (most recent call last):
    ...
    rmpc_bench.types.errors.DesignError: run: jobs must be int | None (got 1.5)
    """
    for name, kind in _hints(function).items():
        if name in given and not _fits(given[name], kind):
            value, valid = given[name], get_annotations(function)[name]
            is_plain = isinstance(value, str | Real | NoneType)
            shown = repr(value) if is_plain else f"an object of type {type(value).__name__}"
            raise DesignError(f"{function.__name__}: {name} must be {valid} (got {shown:.80})", name)


@cache
def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    return get_type_hints(function)


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value has a type, as far as `isinstance` can say it; lists are read to their entries."""
    origin, args = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(_fits(value, each) for each in args)
    if origin is Literal:
        return any(type(value) is type(each) and value == each for each in args)
    if kind in _NUMBERS:
        return isinstance(value, _NUMBERS[kind]) and not isinstance(value, bool)
    if kind is Any or not isinstance(origin or kind, type):
        return True
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, name) for name in vars(kind) if not name.startswith("_"))
    if not isinstance(value, origin or kind) or (origin is not None and isinstance(value, str)):
        return False
    is_list = origin is not None and issubclass(origin, Collection) and not issubclass(origin, Mapping)
    return not is_list or all(_fits(each, args[0]) for each in value)
