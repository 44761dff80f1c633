"""Arrays and numbers as annotations, the status of a run, and errors.

The constraints are marks of annotated-types, which pydantic brings along and reads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any, Protocol, TypeAlias

import numpy.typing as npt
from annotated_types import Ge, Gt, Le
from jaxtyping import Int8

Array: TypeAlias = npt.NDArray[Any]
Matrix: TypeAlias = float | list[float] | list[list[float]]
"""A number stands for that number times the identity, a list for its diagonal."""


class OverTime:
    """Mark of an annotation: numbers that may depend on the time index k."""


class OfTime(Protocol):
    """A number that depends on time."""

    def __call__(self, values: Mapping[str, float], /) -> float:
        """Value at ``{"k": k}``; ValueError where there is none."""


SystemMatrix: TypeAlias = Annotated[Any, OverTime()]
"""None (zero), a number (times the identity), a list (the diagonal) or a list of rows, of numbers or `OfTime`."""

Positive: TypeAlias = Annotated[float, Gt(0)]
NonNegative: TypeAlias = Annotated[float, Ge(0)]
Count: TypeAlias = Annotated[int, Ge(1)]
Horizon: TypeAlias = Annotated[int, Ge(1), Le(1000)]
"""Samples ahead; the matrices of a prediction grow with its square."""


class Status(IntEnum):
    """What became of a run; the text of a member is shown wherever a failure is counted."""

    explanation: str

    def __new__(cls, value: int, explanation: str) -> Status:
        """Attach the explanation to the number."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.explanation = explanation
        return member

    OK = 0, "the run reached its last sample"
    DIVERGED = 1, "a state, an estimate or an input grew beyond all bounds or stopped being a number"
    OUT_OF_RANGE = 2, "a drawn parameter or the state left what the plant is made for (a mass, the length of an arm)"
    TOO_MANY_EVENTS = 3, "friction stopped and released a body more often in one sample than can be followed"
    EMPTY_SET = 4, "the measurement and the predicted set have no state in common"
    SINGULAR = 5, "the mechanism came to a pose in which its drives cannot move it every way"

    @property
    def word(self) -> str:
        """The status as tables and files spell it: lower case with hyphens."""
        return self.name.lower().replace("_", "-")


Statuses: TypeAlias = Int8[Array, " runs"]


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
        where = f"{self.file}:{self.line}:{self.column}: "
        return where + (f"{self.path}: {self.message}" if self.path else self.message)


class ConfigError(Exception):
    """Everything that is wrong with a configuration, sorted by place, at once."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(sorted(set(problems)))
        super().__init__("\n".join(str(problem) for problem in self.problems))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the problems, so that the error survives a worker process."""
        return type(self), (self.problems,)


class DesignError(Exception):
    """A design that cannot be made from its parameters; raised before any run.

    Parameters
    ----------
    message : what is wrong and the way out
    parameter : the parameter to blame, with dots inside a nested one, so that the message can point at its place
    """

    def __init__(self, message: str, parameter: str = "") -> None:
        self.parameter = parameter
        super().__init__(message)
