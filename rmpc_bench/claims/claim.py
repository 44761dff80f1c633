"""A statement of a paper, as a configuration records it.  Light: plain `check` imports it without pandas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

FINDINGS = (
    "confirmed",
    "confirmed-smaller",
    "confirmed-larger",
    "partially-confirmed",
    "inconclusive",
    "depends-on-assumptions",
    "not-confirmed",
    "not-testable",
)


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
    check : comparisons, see `claim_grammar`; empty when nothing here can test it
    finding : the recorded finding
    stated : what the paper gives, as a text or as a size that is checked when all comparisons hold
    assumptions : what the paper leaves open and what this project assumes, one sentence each
    at : points of a sweep, path -> text of the value, one per reading in which the checks are made; terms that name a
        point of their own override it
    pooled : whether terms that name no point speak of the runs of all points together
    """

    says: str
    source: str
    check: tuple[str, ...]
    finding: str | None = None
    stated: str | Stated | None = None
    assumptions: tuple[str, ...] = ()
    at: tuple[Mapping[str, str], ...] = ()
    pooled: bool = False

    @property
    def of_paper(self) -> bool:
        """Whether the paper says so; what the bench adds has a source that begins with ``additional result``."""
        return not self.source.startswith("additional result")
