"""The statements of a paper with their findings, as a page shows them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rmpc_bench.claims.claim import Claim
from rmpc_bench.claims.evidence import evidence
from rmpc_bench.claims.markdown import cases_text, limits
from rmpc_bench.claims.verdict import ClaimVerdict

MOST_OPEN, MOST_WORDS = 8, 100
"""Statements that are not folded, and the words of all of them."""
OURS = "ours, not in the paper"


class ClaimItem(NamedTuple):
    """A statement."""

    finding: str
    statement: str
    source: str
    behind: str
    """What the folded lines below it contain."""
    lines: Sequence[str]


def claim_items(verdicts: Sequence[ClaimVerdict]) -> list[ClaimItem]:
    """Return the statements of the paper, then additional results and suspected misprints."""
    return [_item(verdict) for verdict in sorted(verdicts, key=lambda verdict: _order(verdict.claim))]


def n_open(items: Sequence[ClaimItem]) -> int:
    """Count the statements that are not folded."""
    words = 0
    for n, item in enumerate(items[:MOST_OPEN]):
        words += sum(len(text.split()) for text in (item.finding, item.statement, item.source, item.behind))
        if words > MOST_WORDS and n:
            return n
    return min(len(items), MOST_OPEN)


def _order(claim: Claim) -> int:
    return 0 if claim.of_paper else 2 if claim.is_misprint else 1


def _item(verdict: ClaimVerdict) -> ClaimItem:
    claim = verdict.claim
    assumptions = [*claim.assumptions, *limits(verdict)]
    grounds = [f"{name}: {ground}" for name, ground in claim.grounds.items()]
    n = len(assumptions)
    behind = f"{n} assumption{'s' * (n > 1)}" if n else "numbers"
    lines = [*assumptions, *grounds, *_found(verdict)]
    source = claim.source if claim.of_paper or claim.is_misprint else OURS
    return ClaimItem(verdict.joined_words, _line(claim.says), _line(source), behind, [*map(_line, lines)])


def _found(verdict: ClaimVerdict) -> list[str]:
    """Say how the finding came about: joined with others, recorded, by interpretation, by case, and its numbers."""
    claim, lines = verdict.claim, list[str]()
    if claim.quote:
        lines.append(f'The paper: "{claim.quote}"')
    if claim.elsewhere:
        others = ", ".join(f"{name} ({finding.sentence})" for name, finding in claim.elsewhere.items())
        lines.append(f"Joined over this experiment ({verdict.words}) and {others}.")
    if verdict.differs and claim.finding is not None:
        lines.append(f"Recorded earlier: {claim.finding.sentence}. The finding has changed.")
    if verdict.reason:
        lines.append(f"Not evaluated: {verdict.reason}.")
    for finding in dict.fromkeys(each.finding for each in verdict.interpretations):
        points = [each.at for each in verdict.interpretations if each.finding == finding]
        lines.append(f"{finding.sentence.capitalize()} at: {'; '.join(points)}.")
    lines += [cases_text(verdict)] if verdict.cases else []
    lines += [f"{each.text}{f' at {each.at}' if each.at else ''}: {evidence(each)}" for each in verdict.comparisons]
    return lines


def _line(text: str) -> str:
    return " ".join(text.split())
