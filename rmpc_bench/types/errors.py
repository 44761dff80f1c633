"""Errors of a user, each with its place: issues found before any run, arguments, messages that components share."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from inspect import get_annotations
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

OTHER_NAMES: Mapping[str, str] = {
    "normal": "gaussian",
    "w": "process",
    "v": "measurement",
    "sigma": "std",
    "stddev": "std",
    "var": "cov",
    "variance": "cov",
    "kf": "kalman",
    "components": "only",
}
"""Names that other programs and papers use -> the name here."""


class Issue(NamedTuple):
    """One thing wrong with the parameters of a component."""

    key: str  # the YAML key to blame, with dots inside a nested one; empty for the component as a whole
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


def does_not_fit(shape: tuple[int, ...], expected: tuple[int, int]) -> str:
    """Say that a matrix has the wrong shape, with both shapes, and whether its transpose would fit.

    Examples
    --------
    >>> does_not_fit((1, 2), (2, 1))
    'shape (1, 2) does not fit: 2 x 1 numbers are required, as in its transpose'
    """
    turned = ", as in its transpose" if shape == expected[::-1] and shape != expected else ""
    return f"shape {shape} does not fit: {expected[0]} x {expected[1]} numbers are required{turned}"


def unknown(name: str, known: Iterable[str], noun: str, way_out: str = "") -> str:
    """Say that a name of a `noun` is unknown, with the nearest known one, or else all; `way_out` is a command."""
    known = list(known)
    near = nearest(name, known)
    hint = f"; did you mean {near!r}?" if near else f"; known: {', '.join(known) or 'none'}"
    return f"{name!r} is not a known {noun}{hint}" + (f" ({way_out})" if way_out else "")


def nearest(name: str, known: Sequence[str]) -> str | None:
    """Return the known name that an unknown one probably means; None where none is near.

    Examples
    --------
    >>> nearest("tank.py", ["pi.py", "tanks.py"])
    'tanks.py'
    """
    # A name in the wrong case is nearest to the same name in the right one.
    near = [each for each in known if each.lower() == name.lower()]
    near = near or [each for each in known if each == OTHER_NAMES.get(name.lower())]
    # One of two letters is enough in a short name, such as `Hp`; `corners` is not near to `none`.
    cutoff = 0.5 if len(name) < 4 else 0.55
    return next(iter(near or difflib.get_close_matches(name, known, n=1, cutoff=cutoff)), None)


def row_by_row(values: Sequence[Any], meaning: Callable[[int, int], str] | None = None) -> str:
    """Say that a matrix is written row by row, with the two matrices that a flat list could mean.

    `meaning` says what the rows and columns of a shape stand for; only the shape is shown without it.

    Examples
    --------
    >>> row_by_row([1, 0])
    'write it row by row: [[1, 0]] is 1 x 2, [[1], [0]] is 2 x 1'
    """
    texts = [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
    n = len(texts)
    readings = {(1, n): f"[[{', '.join(texts)}]]", (n, 1): f"[{', '.join(f'[{text}]' for text in texts)}]"}
    words = [
        f"{text} is {rows} x {columns}" + (f" ({meaning(rows, columns)})" if meaning else "")
        for (rows, columns), text in readings.items()
    ]
    return f"write it row by row: {', '.join(words)}"


MAX_QUOTED = 200
"""Largest number of characters of a value that a message quotes."""
MAX_SHOWN = 50
"""Problems that are printed."""
_MAX_MESSAGE = 4000
_QUOTED = re.compile(rf"(?<!\w)(['\"])((?:(?!\1)[^\n]){{{MAX_QUOTED}}})(?:(?!\1)[^\n])+\1")
_GOT = re.compile(rf"\(got ([^\n]{{{MAX_QUOTED}}})[^\n]+\)")
_WORD = re.compile(rf"(\S{{{MAX_QUOTED}}})\S{{8,}}")


def shortened(message: str) -> str:
    """Return a message in which the text of a value has at most 200 characters.

    Examples
    --------
    >>> print(shortened("must be a number (got '" + 300 * "x" + "')").replace(200 * "x", "x..x"))
    must be a number (got 'x..x...')
    """
    if len(message) <= MAX_QUOTED:
        return message
    short = _QUOTED.sub(r"\1\2...\1", message)
    short = _GOT.sub(lambda found: found[0] if len(found[0]) <= MAX_QUOTED + 12 else f"(got {found[1]}...)", short)
    short = _WORD.sub(r"\1...", short)
    return short if len(short) <= _MAX_MESSAGE else f"{short[:_MAX_MESSAGE]}..."


MAPPING = "(mapping)"
"""Name of the file, which does not exist, of a configuration that a program gives as a mapping."""


@dataclass(frozen=True, order=True)
class Problem:
    """One thing wrong with a configuration, at a place a text editor can open."""

    file: str
    line: int
    column: int
    path: str
    message: str

    def __str__(self) -> str:
        """Render as ``file:line:column: path: message``; without the place, or a number of it, that there is not."""
        is_file = self.file and not self.file.endswith(MAPPING)
        place = [shortened(self.file), *(str(number) for number in (self.line, self.column) if number)]
        where = f"{':'.join(place)}: " if is_file else ""
        message = shortened(self.message)
        return where + (f"{shortened(self.path)}: {message}" if self.path else message)


class ConfigError(ValueError):
    """All problems of a configuration, sorted by their position; `found` has them in the order they were found in."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.found, self.problems = tuple(problems), tuple(sorted(set(problems)))
        more = [f".. and {len(self.problems) - MAX_SHOWN} more"] if len(self.problems) > MAX_SHOWN else []
        super().__init__("\n".join([*map(str, self.problems[:MAX_SHOWN]), *more]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the problems, so that the error survives a worker process."""
        return type(self), (self.problems,)


class DesignError(ValueError):
    """Invalid parameters of a design; raised before any run.

    Parameters
    ----------
    message : what is wrong and the way out
    parameter : the parameter to blame, with dots inside a nested one, so that the message can point at its place; a key
        that contains a dot stands in double quotes
    """

    def __init__(self, message: str, parameter: str = "") -> None:
        self.parameter = parameter
        super().__init__(message)


class InvalidReturnValue(Exception):
    """A component returned a value that does not have the shape, the type or the range that the bench expects."""


class SolverError(Exception):
    """A component could not solve its problem at one sample of one run; the run ends, or the step is held.

    Raise it in a component written for one run.  `on_failure` says what follows.

    Parameters
    ----------
    message : what the solver reported
    infeasible : whether the problem has no solution; otherwise the solver did not converge

    Examples
    --------
    >>> str(SolverError("maximum number of iterations reached"))
    'maximum number of iterations reached'
    """

    def __init__(self, message: str = "", *, infeasible: bool = False) -> None:
        self.infeasible = infeasible
        super().__init__(message)


class OutOfRange(Exception):
    """A plant written for one run has left the range for which it is defined; the run ends with `out-of-range`.

    Parameters
    ----------
    message : what has happened, such as ``the tank is empty``
    """


class TimeLimit(BaseException):
    """A step or a run has taken longer than `execution.timeout`; raised by the bench within the call of a component.

    It is no `Exception`, so that a component which catches all of its own errors does not go on.
    """


class WorkerError(Exception):
    """Worker processes cannot load the experiment."""


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
