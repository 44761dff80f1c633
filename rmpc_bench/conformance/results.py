"""Checks, their results, and the comparison of arrays bit by bit."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal, NamedTuple

import numpy as np

from rmpc_bench.types import Array


class Check(NamedTuple):
    """One rule that a kind of component keeps."""

    id: str
    says: str
    """The rule in one sentence."""
    run: Callable[[Any, Any], None]
    """Takes the component and the example; raises AssertionError where the rule is broken."""


class CheckResult(NamedTuple):
    """Outcome of one check on one component."""

    id: str
    says: str
    status: Literal["passed", "failed"]
    reason: str = ""
    """Why it failed, with the numbers; empty where it passed."""

    def __str__(self) -> str:
        """Render as ``failed  batch-independence: a run gives ... (row 3 differs by 1e-17)``."""
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.status}  {self.id}: {self.says}{reason}"


def run_checks(checks: Iterable[Check], component: Any, example: Any) -> tuple[CheckResult, ...]:
    """Run every check; one that raises has failed, the others run all the same.

    Parameters
    ----------
    checks : the rules of the component's kind
    component : what is checked
    example : the data that it is checked with
    """
    return tuple(_result(check, component, example) for check in checks)


def _result(check: Check, component: Any, example: Any) -> CheckResult:
    try:
        check.run(component, example)
    except AssertionError as error:
        return CheckResult(check.id, check.says, "failed", str(error))
    except Exception as error:  # a component under test may raise anything
        return CheckResult(check.id, check.says, "failed", f"raised {type(error).__name__}: {error}")
    return CheckResult(check.id, check.says, "passed")


def require(holds: bool, otherwise: str) -> None:
    """Fail the running check with a reason unless a condition holds.

    Raises
    ------
    AssertionError
        With the reason.
    """
    if not holds:
        raise AssertionError(otherwise)


def require_same(name: str, found: Array, expected: Array) -> None:
    """Fail the running check unless two arrays agree bit for bit; NaN equals NaN.

    Raises
    ------
    AssertionError
        With both shapes, or with the first entry that differs.
    """
    found, expected = np.asarray(found), np.asarray(expected)
    require(found.shape == expected.shape, f"{name} has shape {found.shape} instead of {expected.shape}")
    if np.array_equal(found, expected, equal_nan=found.dtype.kind == "f"):
        return
    equal = (found == expected) | ((found != found) & (expected != expected))
    place = tuple(int(index) for index in np.argwhere(~equal)[0])
    raise AssertionError(f"{name}{list(place)} is {found[place]!r} instead of {expected[place]!r}")


def require_frozen(component: Any) -> None:
    """Fail the running check unless a design refuses a new attribute.

    Raises
    ------
    AssertionError
        If the attribute could be set.
    """
    try:
        component.attribute_of_a_conformance_check = 1
    except AttributeError:
        return
    del component.attribute_of_a_conformance_check
    raise AssertionError("an attribute can be set; make the class a frozen dataclass or a NamedTuple")


def copies(arrays: Iterable[Array]) -> list[Array]:
    """Copy arrays, to compare them with after a call."""
    return [np.array(array) for array in arrays]


def require_unchanged(arrays: Iterable[Array], before: Iterable[Array]) -> None:
    """Fail the running check unless arrays that were passed to a call are what they were.

    Raises
    ------
    AssertionError
        With the first entry that differs.
    """
    for number, (array, copy) in enumerate(zip(arrays, before, strict=True)):
        require_same(f"argument {number}", array, copy)
