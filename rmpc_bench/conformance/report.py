"""The outcome of all checks of a component, and its table."""

from __future__ import annotations

from textwrap import wrap
from typing import NamedTuple

from rmpc_bench.conformance.results import CheckResult

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
        """Return the result of one check.

        Raises
        ------
        KeyError
            If there is no such check.
        """
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
