"""Checks, their results, and the comparison of arrays bit by bit."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from rmpc_bench.components.reference import CodeError
from rmpc_bench.components.single_design import SingleDesign
from rmpc_bench.types import Array, DesignError

Severity: TypeAlias = Literal["error", "warning", "information"]
"""Whether a broken rule makes results wrong (error), is a likely mistake (warning), or is only worth knowing."""
Outcome: TypeAlias = Literal["passed", "failed", "expected", "not checked"]
"""`expected`: the component declares that the check fails, in its attribute `expected_failures`."""
PACKAGE = str(Path(__file__).parents[1])


class NotApplicableError(Exception):
    """A check that has no meaning for this component; the message says why."""


class Returned(NamedTuple):
    """What a component has returned in another process."""

    values: Array | None
    raised: str = ""
    """Text of its exception; empty where there is none."""


class Check(NamedTuple):
    """One rule that a kind of component keeps."""

    id: str
    says: str
    """The rule in one sentence."""
    run: Callable[[Any, Any], str | None]
    """Takes the component and the example; raises AssertionError where the rule is broken; may return numbers."""
    severity: Severity = "error"
    is_first: bool = False
    """Whether the remaining checks make no sense where this one fails."""


class CheckResult(NamedTuple):
    """Outcome of one check on one component."""

    id: str
    says: str
    status: Outcome
    reason: str = ""
    """Why it failed or was not checked; the numbers of a check that passed, where it has some."""
    severity: Severity = "error"

    @property
    def counts(self) -> bool:
        """Whether the component does not conform because of this check."""
        return self.status == "failed" and self.severity == "error"

    def __str__(self) -> str:
        """Render as ``failed  batch-independence: a run gives ... (row 3 differs by 1e-17)``."""
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.status}  {self.id}: {self.says}{reason}"


def run_checks(
    checks: Iterable[Check], component: Any, example: Any, *, begin: Callable[[Check], None] = lambda check: None
) -> tuple[CheckResult, ...]:
    """Run every check; one that raises has failed, the others run all the same.

    Parameters
    ----------
    checks : the rules of the component's kind
    component : what is checked
    example : the data that it is checked with
    begin : called before every check
    """
    results: list[CheckResult] = []
    first: CheckResult | None = None
    for check in checks:
        begin(check)
        result = run_check(check, component, example) if first is None else not_checked(check, first.id)
        if check.is_first and result.status == "failed":
            first = result
        results.append(result)
    return tuple(results)


def not_checked(check: Check, first: str) -> CheckResult:
    """Return the result of a check that is left out because another one has failed."""
    return CheckResult(check.id, check.says, "not checked", f"{first} fails", check.severity)


def run_check(check: Check, component: Any, example: Any) -> CheckResult:
    """Run one check.

    Parameters
    ----------
    check : the rule
    component, example : what it takes
    """
    status: Outcome = "failed"
    try:
        status, reason = "passed", check.run(component, example) or ""
    except NotApplicableError as error:
        status, reason = "not checked", str(error)
    except AssertionError as error:
        status, reason = "failed", str(error)
    except (Exception, SystemExit) as error:  # a component under test may raise anything
        status, reason = "failed", raised(error)
    return CheckResult(check.id, check.says, status, reason, check.severity)


def raised(error: BaseException) -> str:
    """Describe an exception of a component, with the last line of the user's code.

    Examples
    --------
    >>> raised(ValueError("negative level"))
    'raised ValueError: negative level'
    """
    if isinstance(error, DesignError | CodeError):
        place = getattr(error, "place", None)
        return f"{error}" if place is None else f"{Path(place.file).name}:{place.line}: {error}"
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not frame.filename.startswith(PACKAGE)]
    notes = "".join(f", {note}" for note in getattr(error, "__notes__", ()))
    place = f" at {Path(own[-1].filename).name}:{own[-1].lineno}" if own else ""
    text = f": {error}" if str(error) else ""
    return f"raised {type(error).__name__}{text}{place}{notes}"


def with_expected(results: Iterable[CheckResult], expected: Mapping[str, str]) -> tuple[CheckResult, ...]:
    """Replace failures that the component declares; a declared failure that passes, or does not exist, is an error.

    Parameters
    ----------
    results : of all checks
    expected : id of a check -> why it is expected to fail
    """
    changed = []
    for result in results:
        reason = expected.get(result.id)
        if reason is not None and result.status == "failed":
            result = result._replace(status="expected", reason=f"{reason}; {result.reason}")
        elif reason is not None and result.status == "passed":
            text = f"declared in `expected_failures` ({reason}), but it passes; remove the entry"
            result = result._replace(status="failed", reason=text, severity="error")
        changed.append(result)
    unknown = sorted(set(expected) - {result.id for result in changed})
    if unknown:
        text = f"there is no check {', '.join(map(repr, unknown))}"
        changed.append(CheckResult("expected-failures", "declared failures are checks", "failed", text))
    return tuple(changed)


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
    place = first_difference(found, expected)
    raise AssertionError(f"{name}{list(place)} is {found[place]!r} instead of {expected[place]!r}")


def first_difference(found: Array, expected: Array) -> tuple[int, ...]:
    """Return the first place at which two arrays of one shape differ; NaN equals NaN."""
    equal = (found == expected) | ((found != found) & (expected != expected))
    return tuple(int(index) for index in np.argwhere(~equal)[0])


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


def _frozen(component: Any, _: Any) -> None:
    if isinstance(component, SingleDesign):
        raise NotApplicableError("a component written for one run has an object per run")
    require_frozen(component)


FROZEN = Check("frozen", "the design cannot be changed after it was made", _frozen, "warning")
