"""An issue of a component's parameters, found before any run, and messages that several components share."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

from rmpc_bench.types.errors import DesignError


class Issue(NamedTuple):
    """One thing wrong with the parameters of a component."""

    key: str
    """The YAML key to blame, with dots inside a nested one; empty for the component as a whole."""
    message: str


def issues_of(function: Callable[..., Any], *arguments: Any) -> Iterator[Issue]:
    """Call a function and yield the `DesignError` that it raises as an issue; its result is dropped."""
    try:
        function(*arguments)
    except DesignError as error:
        yield Issue(error.parameter, str(error))


def no_such_component(noun: str, index: int, n: int) -> str:
    """Say that an index counts beyond the components there are: ``there is no state 3 (they count from 0 to 1)``."""
    return f"there is no {noun} {index} (they count from 0 to {n - 1})"


def unknown(name: str, known: Iterable[str], noun: str, way_out: str = "") -> str:
    """Say that a name is unknown, and give the nearest known one, or else all known ones.

    Parameters
    ----------
    name : the unknown name
    known : the names there are
    noun : what they are names of
    way_out : command that lists them
    """
    known = list(known)
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(known) or 'none'}"
    return f"{name!r} is not a known {noun}{hint}" + (f" ({way_out})" if way_out else "")
