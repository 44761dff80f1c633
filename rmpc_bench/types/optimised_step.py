"""Result of the optimisation of a constrained controller at one sample of one run."""

from __future__ import annotations

from enum import IntEnum


class OptimisedStep(IntEnum):
    """How the moves of a sample were found; the entry `qp` of a command's info has its number."""

    explanation: str

    def __new__(cls, value: int, explanation: str) -> OptimisedStep:
        """Attach the explanation to the number."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.explanation = explanation
        return member

    SKIPPED = 0, "no limit acts: the closed form is the minimum"
    SOLVED = 1, "the quadratic program was solved, and no slack is in use"
    SOFTENED = 2, "the quadratic program was solved, and the slack of a soft limit is in use"
    INFEASIBLE = 3, "no moves satisfy the hard limits; the fallback was used"
    NOT_CONVERGED = 4, "the solver did not find the minimum; the fallback was used"

    @property
    def word(self) -> str:
        """The result as tables and files spell it: lower case with hyphens."""
        return self.name.lower().replace("_", "-")

    @property
    def failed(self) -> bool:
        """Whether the fallback was used."""
        return self in (OptimisedStep.INFEASIBLE, OptimisedStep.NOT_CONVERGED)
