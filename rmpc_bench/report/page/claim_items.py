"""The statements of a paper with their findings, as a page shows them."""

from __future__ import annotations

from rmpc_bench.claims.claim import Claim, Finding
from rmpc_bench.claims.evidence import evidence
from rmpc_bench.claims.markdown import INFORMATIONAL, basis_text, cases_text, limits, size_parts
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.report.page.blocks import Block, Piece, Text, code, heading, link, paragraph
from rmpc_bench.report.page.source import PageSource

GROUPS = ("", "Additional results", "Suspected misprints")
"""Headings; statements of the paper come first and need none."""
SHORT = {
    Finding.CONFIRMED: "yes",
    Finding.CONFIRMED_SMALLER: "yes",
    Finding.CONFIRMED_LARGER: "yes",
    Finding.EQUAL: "yes",
    Finding.CLOSE: "yes",
    Finding.NOT_CONFIRMED: "no",
    Finding.DIFFERENT: "no",
}
"""How a finding is coloured; all others are open."""


def claim_blocks(source: PageSource) -> list[Block]:
    """Return a block per statement, grouped as in claims.md."""
    blocks: list[Block] = []
    informational = bool(source.overrides or source.incomplete)
    names = {figure.name for figure in source.figures}
    for number, title in enumerate(GROUPS):
        group = [verdict for verdict in source.verdicts if _group(verdict.claim) == number]
        blocks += [heading(title)] if group and title else []
        blocks += [_item(verdict, names, 4 if title else 3) for verdict in group]
    if blocks and informational:
        blocks.insert(0, paragraph(INFORMATIONAL, "note"))
    return blocks


def _group(claim: Claim) -> int:
    return 0 if claim.of_paper else 2 if claim.is_misprint else 1


def finding_style(finding: Finding) -> str:
    """Return ``yes``, ``no`` or ``open``."""
    return SHORT.get(finding, "open")


def _item(verdict: ClaimVerdict, figures: set[str], level: int) -> Block:
    claim = verdict.claim
    return {
        "kind": "claim",
        "level": level,
        "statement": _line(claim.says),
        "finding": verdict.joined_words,
        "style": finding_style(verdict.joined),
        "source": _line(claim.source),
        "quote": _line(claim.quote),
        "lines": _lines(verdict),
        "figures": [link(f"#figure-{name}", name) for name in claim.figures if name in figures],
        "numbers": _numbers(verdict),
        "assumptions": [_line(text) for text in (*claim.assumptions, *limits(verdict))],
        "grounds": [f"{name}: {_line(ground)}" for name, ground in claim.grounds.items()],
    }


def _lines(verdict: ClaimVerdict) -> list[Text]:
    """Say how the finding came about: joined with others, recorded, by interpretation, by case."""
    claim, lines = verdict.claim, list[Text]()
    if claim.elsewhere:
        others = ", ".join(f"{name} ({finding.sentence})" for name, finding in claim.elsewhere.items())
        lines.append(f"Joined over this experiment ({verdict.words}) and {others}.")
    if verdict.differs and claim.finding is not None:
        lines.append(f"Recorded earlier: {claim.finding.sentence}. The finding has changed.")
    if verdict.reason:
        lines.append(f"Not evaluated: {_line(verdict.reason)}.")
    found = verdict.interpretations
    for finding in dict.fromkeys(each.finding for each in found):
        points = [each.at for each in found if each.finding == finding]
        lines.append(f"{finding.sentence.capitalize()} at: {'; '.join(points)}.")
    if verdict.cases:
        text = cases_text(verdict)
        lines.append(f"{text[0].upper()}{text[1:]}.")
    if isinstance(claim.stated, str):
        lines.append(f"Stated: {_line(claim.stated)}.")
    return lines


def _numbers(verdict: ClaimVerdict) -> list[Text]:
    """Return the checks with their numbers, then the stated numbers, then what they rest on."""
    found: list[Text] = []
    for comparison in verdict.comparisons:
        where = f" at {comparison.at}" if comparison.at else ""
        found.append([code(_line(comparison.text)), f"{where}: {evidence(comparison)}"])
    for lead, expression, rest in map(size_parts, verdict.sizes):
        pieces: list[Piece] = [lead[0].upper() + lead[1:], code(expression), rest]
        found.append(pieces)
    return [*found, f"Basis: {basis_text(verdict)}."]


def _line(text: str) -> str:
    return " ".join(text.split())
