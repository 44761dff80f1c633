"""claims.md: the statements of the paper and the findings of this project."""

from __future__ import annotations

import math
from collections.abc import Iterable

from rmpc_bench.analysis.rounding import significant_text
from rmpc_bench.claims.claim import Claim, Finding, point_words
from rmpc_bench.claims.comparison import ComparisonResult
from rmpc_bench.claims.evidence import evidence, number_text
from rmpc_bench.claims.size import Size
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.types.texts import inert_markdown

INFORMATIONAL = "For information only: the configuration was modified or did not run at full size."
_SECTIONS = ("What the paper says", "Additional results", "Suspected misprints")


def claims_markdown(verdicts: Iterable[ClaimVerdict], *, informational: bool, ending: str = "svg") -> str:
    """Write claims.md, with a line of its own for `informational` findings, of a changed or smaller experiment.

    Additional results and suspected misprints are behind the statements of the paper; figures end with `ending`.
    """
    ordered = sorted(verdicts, key=lambda verdict: _SECTIONS.index(_section(verdict.claim)))
    lines = [INFORMATIONAL, ""] if informational else []
    section = ""
    for position, verdict in enumerate(ordered, 1):
        if _section(verdict.claim) != section:
            section = _section(verdict.claim)
            lines += [f"# {section}", ""]
        lines += [f"## {position}. {_text(verdict.claim.says)}", "", *_items(verdict, ending), ""]
    return "\n".join(lines)


def _section(claim: Claim) -> str:
    return _SECTIONS[0 if claim.of_paper else 2 if claim.is_misprint else 1]


def _items(verdict: ClaimVerdict, ending: str) -> list[str]:
    """The list below a statement."""
    claim = verdict.claim
    items = [f"- source: {_text(claim.source)}"]
    if claim.quote:
        items.append(f'- quote: "{_text(claim.quote)}"')
    items += _finding(verdict)
    if claim.figures:
        items.append(
            f"- figure: {', '.join(f'[{name}](figures/{name}.{ending})' for name in map(_text, claim.figures))}"
        )
    if verdict.reason:
        items.append(f"- not evaluated: {_text(verdict.reason)}")
    items += _interpretations(verdict)
    items += [f"- {_text(cases_text(verdict))}"] if verdict.cases else []
    items += [_comparison(comparison) for comparison in verdict.comparisons]
    items.append(f"- {_text(basis_text(verdict))}")
    items += [f"- {_text(lead)} {_code(code)}{rest}" for lead, code, rest in map(size_parts, verdict.sizes)]
    if isinstance(claim.stated, str):
        items.append(f"- stated: {_text(claim.stated)}")
    assumptions = [*claim.assumptions, *limits(verdict)]
    if assumptions:
        items += ["- assumptions:", *(f"  - {_text(assumption)}" for assumption in assumptions)]
    return items


def _finding(verdict: ClaimVerdict) -> list[str]:
    """The finding, joined with those of other configurations, and the recorded one."""
    recorded = f" (recorded: {verdict.claim.finding.sentence})" if verdict.claim.finding else ""
    if not verdict.claim.elsewhere:
        return [f"- finding: **{verdict.words}**{recorded}"]
    others = [f"{_text(name)} ({finding.sentence})" for name, finding in verdict.claim.elsewhere.items()]
    return [
        f"- finding: **{verdict.joined.sentence}**, joined over this configuration and {', '.join(others)}",
        f"- finding here: {verdict.words}{recorded}",
    ]


def _interpretations(verdict: ClaimVerdict) -> list[str]:
    """Under which interpretations the statement holds, under which it does not, and their grounds in the text."""
    found = verdict.interpretations
    items = []
    for finding in dict.fromkeys(each.finding for each in found):
        points = [each.at for each in found if each.finding == finding]
        items.append(f"- {finding.sentence} at: {_text('; '.join(points))}")
    if verdict.claim.grounds:
        grounds = verdict.claim.grounds.items()
        items += ["- grounds in the text:", *(f"  - {_text(name)}: {_text(ground)}" for name, ground in grounds)]
    return items


def cases_text(verdict: ClaimVerdict) -> str:
    """Count the cases of a statement with a hedge."""
    held, failed = (verdict.cases.count(outcome) for outcome in (True, False))
    level = "" if verdict.level is None else f", each at a one-sided level of {100 * verdict.level:.2g} %"
    return f"holds for {verdict.claim.holds_for}: {held} of {len(verdict.cases)} cases hold, {failed} do not{level}"


def basis_text(verdict: ClaimVerdict) -> str:
    """Say which runs a finding rests on, and at which point of a sweep."""
    runs = "1 run" if verdict.n_runs == 1 else f"{verdict.n_runs} runs"
    basis = f"{runs}, seed {verdict.seed}" if verdict.n_runs else "exact, no runs"
    return f"{basis}{_where(verdict.claim)}"


def size_parts(size: Size) -> tuple[str, str, str]:
    """Write a stated number and the computed one: the text before the expression, the expression, the text behind."""
    size = size.rounded()
    lead = f"stated: {_line(size.stated.text or size.stated.printed)}; computed: "
    text = f" is {number_text(size.value)}"
    if size.interval is not None and size.interval[0] < size.interval[1]:
        low, high = (number_text(end) for end in size.interval)
        text += f" [{low}, {high}]"
    if size.is_exact:
        difference = "" if size.relative is None or size.finding is Finding.EQUAL else f" by {_percent(size.relative)}"
        text += f", {size.finding.sentence}{difference}"
    return lead, _line(size.stated.of), text


def _percent(relative: float) -> str:
    return "more than any percentage" if math.isinf(relative) else f"{significant_text(100 * relative, 2)} %"


def limits(verdict: ClaimVerdict) -> list[str]:
    """Limits of ours that decide the finding."""
    limits = dict.fromkeys(size.stated.close for size in verdict.sizes if size.is_exact and size.finding != "equal")
    return [f"Close means within {100 * limit:g} %, a limit of ours." for limit in limits]


def _where(claim: Claim) -> str:
    """The point of a sweep that a claim is checked at."""
    if claim.pooled:
        return ", all points of the sweep together"
    return f", at {point_words(claim.at[0])}" if len(claim.at) == 1 else ""


def _comparison(comparison: ComparisonResult) -> str:
    where = f" at {_text(comparison.at)}" if comparison.at else ""
    return f"- {_code(comparison.text)}{where}: {_text(evidence(comparison))}"


def _line(text: str) -> str:
    return " ".join(text.split())


def _text(text: str) -> str:
    """Write a text on one line, without HTML and links; formulas stay, and so does code that ends in the text."""
    line = inert_markdown(_line(text))
    # A backtick without another one would take the next code of this project for text.
    is_closed = line.count("`") % 2 == 0 and "``" not in line and "\\`" not in line
    return line if is_closed else line.replace("`", "&#96;")


def _code(text: str) -> str:
    """Write an expression on one line as code, which a backtick would end."""
    return f"`{_line(text).replace('`', chr(39))}`"
