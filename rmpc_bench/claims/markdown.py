"""claims.md: the statements of the paper and the findings of this project."""

from __future__ import annotations

from collections.abc import Iterable

from rmpc_bench.claims.claim import Claim, Stated
from rmpc_bench.claims.comparison import ComparisonResult
from rmpc_bench.claims.evidence import evidence, number_text
from rmpc_bench.claims.verdict import ClaimVerdict, point_words

INFORMATIONAL = "For information only: the configuration was modified or did not run at full size."


def claims_markdown(verdicts: Iterable[ClaimVerdict], *, informational: bool) -> str:
    """Write claims.md.

    Parameters
    ----------
    verdicts : the verdicts; additional results are moved behind the statements of the paper
    informational : True when the configuration was modified or not at full size

    Returns
    -------
    Markdown, ending with a newline
    """
    ordered = sorted(verdicts, key=lambda verdict: not verdict.claim.of_paper)
    lines = [INFORMATIONAL, ""] if informational else []
    for position, verdict in enumerate(ordered, 1):
        if position == 1 or ordered[position - 2].claim.of_paper != verdict.claim.of_paper:
            lines += ["# What the paper says" if verdict.claim.of_paper else "# Additional results", ""]
        lines += [f"## {position}. {_line(verdict.claim.says)}", "", *_items(verdict), ""]
    return "\n".join(lines)


def _items(verdict: ClaimVerdict) -> list[str]:
    """The list below a statement."""
    claim = verdict.claim
    items = [f"- source: {_line(claim.source)}", f"- finding: **{verdict.finding.sentence}**"]
    if claim.finding:
        items[-1] += f" (recorded: {claim.finding.sentence})"
    if verdict.reason:
        items.append(f"- not evaluated: {_line(verdict.reason)}")
    for finding in dict.fromkeys(each.finding for each in verdict.interpretations):
        points = [each.at for each in verdict.interpretations if each.finding == finding]
        items.append(f"- {finding.sentence} at: {'; '.join(points)}")
    items += [_comparison(comparison) for comparison in verdict.comparisons]
    runs = "1 run" if verdict.n_runs == 1 else f"{verdict.n_runs} runs"
    basis = f"{runs}, seed {verdict.seed}" if verdict.n_runs else "exact, no runs"
    items.append(f"- {basis}{_where(claim)}")
    if isinstance(claim.stated, Stated):
        size = number_text(verdict.size_written)
        items.append(f"- stated: {_line(claim.stated.text)}; computed: `{claim.stated.of}` is {size}")
    elif claim.stated:
        items.append(f"- stated: {_line(claim.stated)}")
    if claim.assumptions:
        items += ["- assumptions:", *(f"  - {_line(assumption)}" for assumption in claim.assumptions)]
    return items


def _where(claim: Claim) -> str:
    """The point of a sweep that a claim is checked at."""
    if claim.pooled:
        return ", all points of the sweep together"
    return f", at {point_words(claim.at[0])}" if len(claim.at) == 1 else ""


def _comparison(comparison: ComparisonResult) -> str:
    where = f" at {comparison.at}" if comparison.at else ""
    return f"- `{_line(comparison.text)}`{where}: {evidence(comparison)}"


def _line(text: str) -> str:
    return " ".join(text.split())
