"""Shapes and types checked at run time, once for every combination that a function meets.

Whether arguments and result agree with their annotations follows from their classes, of arrays from dtype and shape.
A function that has met a combination and passed is not checked again for it: a check takes far longer than most steps.
Functions that are defined anew at every step have the same code; they share the check, and what has passed it.
What does not follow from classes (lists, dictionaries, literals, objects of other libraries) is checked at every call.
After `ALWAYS` calls of a function in a process only every `EVERY`-th one is looked at: these are calls of a loop over
steps, and a look at their classes takes as long as a small step.
"""

import functools
import types
from collections.abc import Callable, Hashable
from contextvars import ContextVar
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


CALLED: ContextVar[Callable[..., Any]] = ContextVar("called")
"""What a check calls between that of the arguments and that of the result."""


class Met:
    """What all functions with the same code have met."""

    def __init__(self, function: types.FunctionType, typechecker: Callable[..., Any]) -> None:
        self.code = function.__code__  # so that no other code gets its id
        self.passed: dict[Hashable, set[Hashable]] = {}  # arguments -> results
        # Made at the first call: a process calls a small part of all functions that it imports.
        self._checked = functools.cache(lambda: CHECK(_calling(function), typechecker=typechecker))

    def check(self, function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """Call one of the functions, or what gives its result, with all checks."""
        token = CALLED.set(function)
        try:
            return self._checked()(*args, **kwargs)
        finally:
            CALLED.reset(token)


MET: dict[int, Met] = {}
"""id of a code -> what its functions have met."""


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
    code = id(function.__code__)
    if code not in MET:
        MET[code] = Met(function, typechecker)
    met, calls = MET[code], 0

    @functools.wraps(function)
    def remembered(*args: Any, **kwargs: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > ALWAYS and calls % EVERY:
            return function(*args, **kwargs)
        try:
            given = (tuple(map(mark, args)), *((name, mark(value)) for name, value in kwargs.items()))
        except UnknownError:
            return met.check(function, args, kwargs)
        known = met.passed.get(given)
        if known is None:
            result = met.check(function, args, kwargs)
            met.passed[given] = set()
            return result
        result = function(*args, **kwargs)
        try:
            made = mark(result)
            if made in known:
                return result
        except UnknownError:
            made = None
        met.check(lambda *_, **__: result, args, kwargs)
        if made is not None:
            known.add(made)
        return result

    return remembered


def _calling(function: types.FunctionType) -> types.FunctionType:
    """Return a function with the annotations of another one that calls what `CALLED` says."""
    current = CALLED
    called = lambda *args, **kwargs: current.get()(*args, **kwargs)  # noqa: E731
    # The names in annotations are those of the module of the function.
    same_names = types.FunctionType(called.__code__, function.__globals__, closure=called.__closure__)
    return functools.update_wrapper(same_names, function)
