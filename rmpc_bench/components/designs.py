"""From a kind, a reference to a file, or a user's class or function to a design function; the group it belongs to."""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from functools import cache, partial
from typing import Any

from rmpc_bench import registry
from rmpc_bench.components.loading import load
from rmpc_bench.components.reference import CodeError, CodeReference, split_reference
from rmpc_bench.components.single_run import design_function, is_single_run, single_run
from rmpc_bench.components.user_class import METHODS, methods_of
from rmpc_bench.components.user_runs import drawing_from
from rmpc_bench.installed import BrokenPackageError
from rmpc_bench.types.contract import BASES, undefined_methods
from rmpc_bench.types.errors import DesignError, check_arguments, unknown

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
        return next((group for group in METHODS if methods_of(group, found)), None)
    return _group_of_function(found) if inspect.isfunction(found) else None


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


def register(group: str, name: str, design: Any) -> None:
    """Add a component under a name; a changed one replaces the earlier one, with a line on stderr.

    Parameters
    ----------
    group : ``"estimator"``, ``"controller"``, ``"plant"`` and so on (or the plural)
    name : what a configuration writes after ``kind:``
    design : the component's design function or class; its keywords become keys of the configuration

    Raises
    ------
    DesignError
        If the group is not one, the name is that of a built-in component, or the class is none of the group.

    Examples
    --------
    >>> import rmpc_bench
    >>> @rmpc_bench.single_run
    ... def peak(y, factor: float = 1.0):
    ...     return factor * y.max()
    >>> rmpc_bench.register("metric", "peak-of-y", peak)  # now a kind with the key `factor`
    """
    check_arguments(register, locals())
    group = registry.group_named(group)
    where = f"{registry.singular(group)} {name!r}"
    try:
        if design_function(group, design) is design and isinstance(design, type):
            if missing := undefined_methods(group, design):
                raise DesignError(f"{design.__qualname__} does not define {', '.join(missing)}")
    except DesignError as error:
        raise DesignError(f"{where}: {error}", "design") from None
    registry.register(group, name, design)


def figure_names(kinds: Iterable[str]) -> tuple[str, ...]:
    """Name the files of figures, without ending: the kind, or the name in a user's file, with a number if repeated."""
    counts: Counter[str] = Counter()
    names = []
    for kind in kinds:
        parts = split_reference(kind)
        name = kind if parts is None else parts[1]
        counts[name] += 1
        names.append(name if counts[name] == 1 else f"{name}-{counts[name]}")
    return tuple(names)


ATTRIBUTES = (
    "Ne",
    "P_is",
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
    own = {"__init__": _init_of(base, function, of_function), "__doc__": function.__doc__}
    made_class = type(function.__name__, (base,), {**declared, **own})
    made_class.__qualname__, made_class.__module__ = function.__qualname__, function.__module__
    return single_run(made_class)


def _init_of(
    base: Any, function: Callable[..., Any], of_function: Mapping[str, inspect.Parameter]
) -> Callable[..., None]:
    """Return an `__init__` that gives what the function has made to that of the base class."""
    of_base = dict(list(_arguments(base.__init__).items())[2:])
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
        if hasattr(base, "fits") and not base.fits(made):
            what = "None" if made is None else f"an object of type {type(made).__name__}"
            raise TypeError(f"{function.__name__} returned {what}; it must return {base.returns}")
        if owned and any(each is before for each in owned(made) for before in owned(other)):
            raise TypeError(
                f"{function.__name__} returns the same object for every run; make a new one in the function"
            )
        compared.append(True)
        base.__init__(self, made, **{name: value for name, value in given.items() if name in of_base})

    first = inspect.Parameter("self", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    every = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in {**of_base, **of_function}.values()]
    make.__signature__ = inspect.Signature([first, *every])  # type: ignore[attr-defined]
    # `describe` shows the docstring of the module in which `__init__` is defined.
    make.__module__, make.__qualname__ = function.__module__, f"{function.__qualname__}.__init__"
    return make


def _arguments(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Arguments by name, with annotations evaluated in the module of the function."""
    return dict(inspect.signature(function, eval_str=True).parameters)


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


_cached = cache(design_function)
"""One function for every component, since the keys of a function are read once."""
