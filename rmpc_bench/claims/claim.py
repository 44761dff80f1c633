"""A claim of a configuration.  This module does not import pandas, so that `check` stays fast."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class Finding(StrEnum):
    """Outcome of checking a claim; the value is its word in YAML and JSON, `sentence` the words for readers."""

    CONFIRMED = "confirmed"
    CONFIRMED_SMALLER = "confirmed-smaller"
    CONFIRMED_LARGER = "confirmed-larger"
    PARTIALLY_CONFIRMED = "partially-confirmed"
    INCONCLUSIVE = "inconclusive"
    DEPENDS_ON_ASSUMPTIONS = "depends-on-assumptions"
    NOT_CONFIRMED = "not-confirmed"
    NOT_TESTABLE = "not-testable"

    @property
    def sentence(self) -> str:
        """The finding in words."""
        return _SENTENCES.get(self, self.value.replace("-", " "))

    @property
    def is_confirmed(self) -> bool:
        """Whether the statement holds, whatever the size of the effect."""
        return self in (Finding.CONFIRMED, Finding.CONFIRMED_SMALLER, Finding.CONFIRMED_LARGER)


_SENTENCES = {
    Finding.CONFIRMED_SMALLER: "confirmed, smaller effect",
    Finding.CONFIRMED_LARGER: "confirmed, larger effect",
    Finding.DEPENDS_ON_ASSUMPTIONS: "depends on unstated assumptions",
}
FINDINGS = tuple(finding.value for finding in Finding)
"""The words that a configuration may record."""


@dataclass(frozen=True)
class Stated:
    """The size that a paper gives: the expression `of` is `value` +- `tolerance` (absolute); `text` as printed."""

    of: str
    value: float
    tolerance: float
    text: str


@dataclass(frozen=True)
class Claim:
    """One statement of a paper.

    Parameters
    ----------
    says : the statement, in one sentence
    source : where it stands
    check : comparisons, see `claims.grammar`; empty when nothing here can test it
    finding : the recorded finding
    stated : what the paper gives, as a text or as a size that is checked when all comparisons hold
    assumptions : what the paper leaves open and what this project assumes, one sentence each
    at : points of a sweep, path -> text of the value, one per interpretation in which the checks are made; terms that
        name a point of their own override it
    pooled : whether terms that name no point use the runs of all points together
    """

    says: str
    source: str
    check: tuple[str, ...]
    finding: Finding | None = None
    stated: str | Stated | None = None
    assumptions: tuple[str, ...] = ()
    at: tuple[Mapping[str, str], ...] = ()
    pooled: bool = False

    @property
    def of_paper(self) -> bool:
        """Whether the paper says so; what this project adds has a source that begins with ``additional result``."""
        return not self.source.startswith("additional result")
