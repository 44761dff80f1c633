"""Names, units and functions of an ordinary differential equation, as a configuration gives them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rmpc_bench.types import DesignError

Names = int | list[str] | dict[str, str]
"""A count, a list of names, or names with their units."""


def names_of(given: Names, key: str, letter: str) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return names and units; those of a count are ``x.0``, ``x.1`` and so on, without units."""
    if isinstance(given, int):
        if given < (letter != "u"):
            raise DesignError(f"must be at least 1 (got {given})", key)
        return tuple(f"{letter}.{i}" for i in range(given)), {}
    names = [str(name) for name in given]
    if not names and letter != "u":
        raise DesignError("must name at least one", key)
    for name in names:
        if not name.isidentifier() or name in ("x", "u", "y", "u_command"):
            raise DesignError(f"{name!r} is no name: letters, digits and _, and not x, u, y or u_command", key)
    doubled = [name for i, name in enumerate(names) if name in names[:i]]
    if doubled:
        raise DesignError(f"{doubled[0]!r} is given twice", key)
    units = {name: str(unit) for name, unit in given.items() if unit} if isinstance(given, Mapping) else {}
    return tuple(names), units


def refuse_shared(states: Sequence[str], inputs: Sequence[str], key: str = "inputs") -> None:
    """Refuse an input with the name of a state: `bounds` could mean either."""
    shared = [name for name in inputs if name in states]
    if shared:
        raise DesignError(f"{shared[0]!r} is the name of a state, too; `bounds` could mean either", key)


def is_timed(rhs: Any, key: str = "ode") -> bool:
    """Whether a function takes (t, x, u, p) and not (x, u, p)."""
    n = _positional(rhs, key)
    if n not in (3, 4):
        raise DesignError(f"{function_name(rhs)} must take (x, u, p) or (t, x, u, p); it takes {_signature(rhs)}", key)
    return n == 4


def check_output(output: Any, key: str = "output") -> None:
    """Refuse an output function that takes anything but (x, p)."""
    n = _positional(output, key)
    if n in (3, 4) and key == "output":
        reason = "u(k) is computed from y(k), so an output cannot depend on the input of the same sample"
        raise DesignError(f"{function_name(output)} must take (x, p): {reason}", "output")
    if n != 2:
        raise DesignError(f"{function_name(output)} must take (x, p); it takes {_signature(output)}", key)


def count(names: Names) -> int:
    """Return the number of names."""
    return names if isinstance(names, int) else len(names)


def _positional(function: Any, key: str) -> int:
    """Count the arguments without a default that a function takes by position."""
    if not callable(function):
        raise DesignError(f"must be a function (got an object of type {type(function).__name__})", key)
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    given = _parameters(function).values()
    return sum(each.kind in kinds and each.default is inspect.Parameter.empty for each in given)


def _parameters(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}


def _signature(function: Callable[..., Any]) -> str:
    return f"({', '.join(_parameters(function))})"


def function_name(function: Any) -> str:
    """Name of a user's function."""
    return str(getattr(function, "__name__", type(function).__name__))
