"""Shapes and types checked at run time, once for every combination that a function meets.

Whether arguments and result agree with their annotations follows from their classes, of arrays from dtype and shape.
A function that has met a combination and passed is not checked again for it: a check takes far longer than most steps.
What does not follow from classes (lists, dictionaries, literals, objects of other libraries) is checked at every call.
After `ALWAYS` calls of a function in a process only every `EVERY`-th one is looked at: these are calls of a loop over
steps, and a look at their classes takes as long as a small step.
"""

import functools
import types
from collections.abc import Callable, Hashable
from typing import Any

import jaxtyping
import numpy as np
from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""Checks types as mypy does: an integer is a float."""
CHECK = jaxtyping.jaxtyped
"""The check of jaxtyping, before `jaxtyped` takes its place."""
ALWAYS, EVERY = 1000, 16
CONTAINERS = (list, dict, set, frozenset, np.ndarray)
BY_CLASS = {int, float, bool, complex, types.NoneType, types.FunctionType, types.MethodType}
"""Classes whose objects are accepted or refused by their class alone; more are added when they are met."""
BY_VALUE: set[type] = set()
"""Classes met whose objects are checked every time."""


class UnknownError(Exception):
    """A value whose class does not say whether it agrees with an annotation."""


def mark(value: Any) -> Hashable:
    """Return all of a value that a check looks at."""
    kind = type(value)
    if kind is np.ndarray:
        return value.dtype, value.shape
    if kind in BY_CLASS:
        return kind
    if kind is tuple:
        return (tuple, *map(mark, value))
    if kind is str:
        return value
    if kind in BY_VALUE or not _judged_by_class(kind):
        BY_VALUE.add(kind)
        raise UnknownError
    BY_CLASS.add(kind)
    return kind


def _judged_by_class(kind: type) -> bool:
    own = kind.__module__.partition(".")[0] in ("rmpc_bench", "numpy")
    plain_tuple = issubclass(kind, tuple) and not hasattr(kind, "_fields")
    return own and not plain_tuple and not issubclass(kind, (*CONTAINERS, type))


def jaxtyped(function: Any = None, *, typechecker: Callable[..., Any]) -> Any:
    """Decorate as `jaxtyping.jaxtyped`, with a memory of the combinations that have passed."""
    if function is None:
        return functools.partial(jaxtyped, typechecker=typechecker)
    if not isinstance(function, types.FunctionType) or "Literal" in str(function.__annotations__):
        return CHECK(function, typechecker=typechecker)
    results: list[Any] = []
    # Made at the first call: a process calls a small part of all functions that it imports.
    check = functools.cache(lambda: CHECK(function, typechecker=typechecker))
    check_result = functools.cache(lambda: CHECK(_giving(results, function), typechecker=typechecker))
    passed: dict[Hashable, set[Hashable]] = {}
    calls = 0

    @functools.wraps(function)
    def remembered(*args: Any, **kwargs: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > ALWAYS and calls % EVERY:
            return function(*args, **kwargs)
        try:
            given = (tuple(map(mark, args)), *((name, mark(value)) for name, value in kwargs.items()))
        except UnknownError:
            return check()(*args, **kwargs)
        known = passed.get(given)
        if known is None:
            result = check()(*args, **kwargs)
            passed[given] = set()
            return result
        result = function(*args, **kwargs)
        try:
            made = mark(result)
            if made in known:
                return result
        except UnknownError:
            made = None
        results.append(result)
        try:
            check_result()(*args, **kwargs)
        finally:
            results.pop()
        if made is not None:
            known.add(made)
        return result

    return remembered


def _giving(results: list[Any], function: types.FunctionType) -> types.FunctionType:
    """Return a function with the annotations of another one that returns the last result."""
    last = lambda *_, **__: results[-1]  # noqa: E731
    # The names in annotations are those of the module of the function.
    same_names = types.FunctionType(last.__code__, function.__globals__, closure=last.__closure__)
    return functools.update_wrapper(same_names, function)
