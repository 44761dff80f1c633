"""Errors of a user, each with its place: of a whole configuration, or of the parameters of one component."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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

    Parameters
    ----------
    message : quotes values in quotation marks or after ``got``, or contains names of any length

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


@dataclass(frozen=True, order=True)
class Problem:
    """One thing wrong with a configuration, at a place a text editor can open."""

    file: str
    line: int
    column: int
    path: str
    message: str

    def __str__(self) -> str:
        """Render as ``file:line:column: path: message``."""
        where = f"{shortened(self.file)}:{self.line}:{self.column}: "
        message = shortened(self.message)
        return where + (f"{shortened(self.path)}: {message}" if self.path else message)


class ConfigError(Exception):
    """All problems of a configuration, sorted by their position."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(sorted(set(problems)))
        more = [f".. and {len(self.problems) - MAX_SHOWN} more"] if len(self.problems) > MAX_SHOWN else []
        super().__init__("\n".join([*map(str, self.problems[:MAX_SHOWN]), *more]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the problems, so that the error survives a worker process."""
        return type(self), (self.problems,)


class DesignError(Exception):
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
