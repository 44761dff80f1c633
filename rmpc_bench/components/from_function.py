"""Single-run classes around an object of another library, which a function of the user makes for every run.

A decorator of an adapter turns the user's function into such a class:

    @filterpy_estimator
    def ukf(model, Ts, alpha: Positive = 0.1):
        return UnscentedKalmanFilter(..)

The arguments of the function are standard names and keys of the configuration, as those of `__init__` of a class.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from copy import deepcopy
from functools import partial
from typing import Any, overload

from rmpc_bench.components.global_generator import drawing_from
from rmpc_bench.components.single_run import single_run
from rmpc_bench.types.errors import unknown

ATTRIBUTES = (
    "Ne",
    "bridges_missing",
    "cost_per_step",
    "depends_on",
    "deterministic",
    "deviation",
    "expected_failures",
    "prepare",
    "preview",
    "regulates",
    "reports",
    "states",
)
"""Attributes of a single-run class that mean something to the bench."""


@overload
def class_around(base: type, function: Callable[..., Any], *, needs: tuple[str, ...] = (), **declared: Any) -> type: ...


@overload
def class_around(
    base: type, function: None, *, needs: tuple[str, ...] = (), **declared: Any
) -> Callable[..., type]: ...


def class_around(
    base: type, function: Callable[..., Any] | None, *, needs: tuple[str, ...] = (), **declared: Any
) -> Any:
    """Return a single-run class whose objects hold what a function has made.

    Parameters
    ----------
    base : class with the methods of the component; its `__init__` takes what the function has made, and after it any
        standard names and keys, each by its name.  If `rng` is among them, the function draws from it what it draws
        from NumPy's global generator.  With a static method `fits(made)` and a text `returns` it refuses what a
        function must not return, and with `owned(made)` objects that are the same in every run
    function : the user's function; its arguments are standard names and keys.  None where a decorator is written with
        arguments, ``@filterpy_estimator(deviation=True)``
    needs : arguments that the function must have
    declared : attributes of the class, such as ``deviation=True``

    Returns
    -------
    A class derived from `base` that is marked with `single_run` and has the name and the docstring of the function;
    without a function, a decorator.

    Raises
    ------
    TypeError
        If the function does not have an argument that it needs, or an attribute means nothing.

    Examples
    --------
    >>> class Held:
    ...     def __init__(self, made): self.x_hat = made
    ...     def update(self, y): return self.x_hat
    >>> def constant(value: float = 2.0): return [value]
    >>> class_around(Held, constant)(value=3.0).update(1.0)
    [3.0]
    """
    if function is None:
        return partial(class_around, base, needs=needs, **declared)
    for name in declared:
        if name not in ATTRIBUTES and not hasattr(base, name):
            raise TypeError(f"{function.__name__}: {unknown(name, ATTRIBUTES, 'attribute')}")
    of_function = _arguments(function)
    if missing := [name for name in needs if name not in of_function]:
        raise TypeError(f"{function.__name__} needs the argument{'s' * (len(missing) > 1)} {' and '.join(missing)}")
    of_base = dict(list(_arguments(base.__init__).items())[2:])  # type: ignore[misc]
    compared: list[bool] = []

    def returned(given: dict[str, Any], rng: Any) -> Any:
        call = drawing_from(rng, function) if "rng" in of_base else function
        return call(**{name: rng if name == "rng" else value for name, value in given.items() if name in of_function})

    def make(self: Any, **given: Any) -> None:
        rng = given.get("rng")
        # Called twice at first, so that every process gives the same answer in all of its runs.
        owned = getattr(base, "owned", None) if not compared else None
        other = returned(given, deepcopy(rng)) if owned else None
        made = returned(given, rng)
        if not getattr(base, "fits", _anything)(made):
            raise TypeError(f"{function.__name__} returned {_described(made)}; it must return {base.returns}")  # type: ignore[attr-defined]
        if owned and any(each is before for each in owned(made) for before in owned(other)):
            raise TypeError(
                f"{function.__name__} returns the same object for every run; make a new one in the function"
            )
        compared.append(True)
        base.__init__(self, made, **{name: value for name, value in given.items() if name in of_base})  # type: ignore[misc]

    first = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    every = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in (of_base | of_function).values()]
    make.__signature__ = inspect.Signature([first, *every])  # type: ignore[attr-defined]
    # `describe` shows the docstring of the module in which `__init__` is defined.
    make.__module__, make.__qualname__ = function.__module__, f"{function.__qualname__}.__init__"
    made_class = type(function.__name__, (base,), {**declared, "__init__": make, "__doc__": function.__doc__})
    made_class.__qualname__, made_class.__module__ = function.__qualname__, function.__module__
    return single_run(made_class)


def _anything(made: Any) -> bool:
    return True


def _described(made: Any) -> str:
    return "None" if made is None else f"an object of type {type(made).__name__}"


def _arguments(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Arguments by name, with annotations evaluated in the module of the function."""
    return dict(inspect.signature(function, eval_str=True).parameters)
