"""The statuses of a run."""

from __future__ import annotations

from enum import IntEnum
from typing import TypeAlias

from jaxtyping import Int8

from rmpc_bench.types.basics import Array


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
    DIVERGED = 1, "a state or an estimate exceeded its limit (`plant.diverged`), or a value is not a number"
    OUT_OF_RANGE = (
        2,
        "a drawn parameter or a state left the range of the plant (a mass, the length of an arm, `plant.bounds`)",
    )
    TOO_MANY_EVENTS = 3, "friction stopped and released a body more often in one sample than can be followed"
    EMPTY_SET = 4, "the measurement and the predicted set have no state in common"
    SINGULAR = (
        5,
        "the mechanism came to a pose in which its drives cannot move it every way, or the covariance of a nonlinear "
        "filter was indefinite twice",
    )
    INFEASIBLE = 6, "an optimiser reported that its constraints have no solution"
    NOT_CONVERGED = 7, "a solver did not converge (`SolverError`)"
    TIMEOUT = 8, "a step or the run took longer than `execution.timeout`"
    CRASHED = 9, "a component raised an exception, returned an invalid value or ended its process"

    @property
    def word(self) -> str:
        """The status as tables and files spell it: lower case with hyphens."""
        return self.name.lower().replace("_", "-")


Statuses: TypeAlias = Int8[Array, " runs"]
