"""Checks, their results, and the comparison of arrays bit by bit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from textwrap import wrap
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from rmpc_bench.components.reference import CodeError
from rmpc_bench.components.single_design import SingleDesign
from rmpc_bench.components.user_code import last_user_frame
from rmpc_bench.types import Array, DesignError

Severity: TypeAlias = Literal["error", "warning", "information"]
"""Whether a broken rule makes results wrong (error), is a likely mistake (warning), or is only worth knowing."""
Status: TypeAlias = Literal["passed", "failed", "expected", "not checked"]
"""`expected`: the component declares that the check fails, in its attribute `expected_failures`."""
PACKAGE = str(Path(__file__).parents[1])


class NotApplicableError(Exception):
    """A check that has no meaning for this component; the message says why."""


class Returned(NamedTuple):
    """What a component has returned in another process."""

    values: Array | None
    raised: str = ""  # text of its exception; empty where there is none


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

    def result(self, status: Status, reason: str = "") -> CheckResult:
        """Return the result of this check."""
        return CheckResult(self.id, self.says, status, reason, self.severity)


class CheckResult(NamedTuple):
    """Outcome of one check on one component."""

    id: str
    says: str
    status: Status
    reason: str = ""  # why it failed or was not checked; the numbers of a check that passed, where it has some
    severity: Severity = "error"

    @property
    def counts(self) -> bool:
        """Whether the component does not conform because of this check."""
        return self.status == "failed" and self.severity == "error"

    def __str__(self) -> str:
        """Render as ``failed  batch-independence: a run gives ... (row 3 differs by 1e-17)``."""
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.status}  {self.id}: {self.says}{reason}"


def run_checks(checks: Iterable[Check], component: Any, example: Any) -> tuple[CheckResult, ...]:
    """Run every check; one that raises has failed, the others run all the same."""
    sequence = CheckSequence()
    return tuple(sequence.run(check, component, example) for check in checks)


class CheckSequence:
    """Checks one after the other, which are left out once one that comes first has failed."""

    def __init__(self) -> None:
        self.failed = ""

    def run(self, check: Check, component: Any, example: Any) -> CheckResult:
        """Run a check, unless one that comes first has failed."""
        if self.failed:
            return check.result("not checked", f"{self.failed} fails")
        result = _outcome(check, component, example)
        if check.is_first and result.status == "failed":
            self.failed = check.id
        return result


def _outcome(check: Check, component: Any, example: Any) -> CheckResult:
    try:
        return check.result("passed", check.run(component, example) or "")
    except NotApplicableError as error:
        return check.result("not checked", str(error))
    except AssertionError as error:
        return check.result("failed", str(error))
    except (Exception, SystemExit) as error:  # a component under test may raise anything
        return check.result("failed", raised(error))


def raised(error: BaseException) -> str:
    """Describe an exception of a component, with the last line of the user's code."""
    if isinstance(error, DesignError | CodeError):
        place = getattr(error, "place", None)
        return f"{error}" if place is None else f"{Path(place.file).name}:{place.line}: {error}"
    frame = last_user_frame(error)
    notes = "".join(f", {note}" for note in getattr(error, "__notes__", ()))
    text = f": {error}" if str(error) else ""
    return f"raised {type(error).__name__}{text}{f' at {frame}' if frame else ''}{notes}"


def with_expected(results: Iterable[CheckResult], expected: Mapping[str, str]) -> tuple[CheckResult, ...]:
    """Replace failures that the component declares; a declared failure that passes, or does not exist, is an error."""
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
    """Fail the running check with a reason unless a condition holds."""
    if not holds:
        raise AssertionError(otherwise)


def require_same(name: str, found: Array, expected: Array) -> None:
    """Fail the running check, with both shapes or the first entry that differs, unless all bits agree; NaN is NaN."""
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


def copies(arrays: Iterable[Array]) -> list[Array]:
    """Copy arrays, to compare them with after a call."""
    return [np.array(array) for array in arrays]


def require_unchanged(arrays: Iterable[Array], before: Iterable[Array]) -> None:
    """Fail the running check unless arrays that were passed to a call are what they were."""
    for number, (array, copy) in enumerate(zip(arrays, before, strict=True)):
        require_same(f"argument {number}", array, copy)


def _frozen(component: Any, _: Any) -> None:
    if isinstance(component, SingleDesign):
        raise NotApplicableError("a component written for one run has an object per run")
    try:
        component.attribute_of_a_conformance_check = 1
    except AttributeError:
        return
    del component.attribute_of_a_conformance_check
    raise AssertionError("an attribute can be set; make the class a frozen dataclass or a NamedTuple")


FROZEN = Check("frozen", "the design cannot be changed after it was made", _frozen, "warning")


def base_class(kind: type, noun: str) -> Check:
    """Return the check that a component is of a class."""

    def run(component: Any, _: Any) -> None:
        require(isinstance(component, kind), f"{type(component).__name__} is not a subclass of {kind.__name__}")

    return Check("base-class", f"the {noun} is a subclass of {kind.__name__}", run, is_first=True)


WIDTH = 100
"""Characters of a line of the table."""


class Report(NamedTuple):
    """Outcome of all checks of a component."""

    component: str
    group: str
    results: tuple[CheckResult, ...]

    @property
    def failed(self) -> tuple[CheckResult, ...]:
        """Checks of the class `error` that have failed."""
        return tuple(result for result in self.results if result.counts)

    @property
    def passed(self) -> bool:
        """Whether no check of the class `error` has failed."""
        return not self.failed

    def result(self, id: str) -> CheckResult:
        """Return the result of one check."""
        for result in self.results:
            if result.id == id:
                return result
        raise KeyError(f"there is no check {id!r} of {self.group}")

    def __str__(self) -> str:
        """Render as a table: outcome, check, rule, and the numbers or the reason below it."""
        noun = self.group.removesuffix("s") or "component"
        lines = [f"{self.component}: {noun}", ""]
        width = 2 + max((len(result.id) for result in self.results), default=0)
        left_out = [result for result in self.results if result.status == "not checked" and _follows(result)]
        for result in self.results:
            if result in left_out:
                continue
            lines.append(f"  {_word(result):13}{result.id:{width}}{result.says}")
            lines += [f"  {'':13}{'':{width}}{line}" for line in wrap(result.reason, max(WIDTH - width - 15, 40))]
        if left_out:
            lines.append(f"  {'not checked':13}{len(left_out)} more, because {left_out[0].reason}")
        return "\n".join([*lines, "", f"  {self.summary()}"])

    def summary(self) -> str:
        """Return the counts of the outcomes.

        Examples
        --------
        >>> Report("f.py:F", "estimators", (CheckResult("exact", "x_hat is the state", "passed"),)).summary()
        '1 passed'
        """
        words = [_word(result) for result in self.results]
        known = ("passed", "FAILED", "warning", "information", "expected", "not checked")
        return ", ".join(f"{words.count(word)} {word.lower()}" for word in known if word in words)


def _follows(result: CheckResult) -> bool:
    """Whether a check was left out because another one has failed."""
    return result.reason.endswith(" fails")


def _word(result: CheckResult) -> str:
    """Return the outcome in one word; a failure that makes results wrong stands out."""
    if result.status != "failed":
        return result.status
    return "FAILED" if result.severity == "error" else result.severity
