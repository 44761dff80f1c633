"""claims.md: the statements of the paper, the findings of this project and the evidence with its numbers.

All numbers are rounded so that another CPU gives the same text, see `analysis.rounding`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from rmpc_bench.analysis.rounding import STABLE, decimal_text, significant, significant_text
from rmpc_bench.claims.claim import Claim, Finding, point_words
from rmpc_bench.claims.comparison import ComparisonResult
from rmpc_bench.claims.decision import Change
from rmpc_bench.claims.verdict import ClaimVerdict, Size
from rmpc_bench.types.texts import inert_markdown

_MOST_PLACES = 12
_MIN_DIGITS, _MAX_DIGITS = 4, 9
"""Significant digits; beyond the second limit two numbers count as equal."""


def _decimals(uncertainty: float) -> int:
    """Count the decimal places that show an uncertainty with two digits: 0 to 12, and 3 where it is 0 or unknown.

    >>> _decimals(0.0123), _decimals(4.5), _decimals(160.0)
    (3, 1, 0)
    """
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return 3
    return min(_MOST_PLACES, max(0, 1 - math.floor(math.log10(uncertainty))))


def evidence(comparison: ComparisonResult) -> str:
    """Write whether a comparison holds, and by which numbers."""
    comparison = comparison.rounded()
    word = {True: "holds", False: "does not hold", None: "inconclusive"}[comparison.holds]
    interval = comparison.interval
    reach = math.nan if interval is None else (interval[1] - interval[0]) / 2
    details = [_sides(comparison, reach)]
    if interval is not None:
        low, high = (number_text(end, reach) for end in interval)
        details.append(f"interval of the difference [{low}, {high}]")
    if comparison.n:
        details.append(f"n = {comparison.n}")
    if comparison.n_excluded:
        runs = "1 run" if comparison.n_excluded == 1 else f"{comparison.n_excluded} runs"
        details.append(f"{runs} excluded (failed or not computed)")
    return "; ".join([f"{word}; {', '.join(details)}", *_further(comparison)])


def _further(comparison: ComparisonResult) -> list[str]:
    """Write what would change the outcome: another threshold, more runs, further runs."""
    found = []
    if comparison.exceptions is not None:
        found.append(f"at most {significant_text(100 * comparison.exceptions, 2)} % of all runs are exceptions")
    if comparison.below_margin:
        found.append(f"the difference is below the margin of relevance of {comparison.below_margin}")
    # Sides that are equal up to rounding are equivalent within 0.
    if comparison.change is not None and comparison.change.high != 0:
        found.append(change_text(comparison.change))
    if comparison.n_deciding is not None:
        found.append(f"about {comparison.n_deciding:,} runs would decide")
    return found


def change_text(change: Change) -> str:
    """Write at which value of a number of the check the outcome changes.

    >>> change_text(Change("factor", 0.28, 0.331)), change_text(Change("relative margin", 0.0, 0.132))
    ('outcome changes at factors from 0.28 to 0.331', 'equivalent within margins of 13.2 % or more')
    """
    low, high = (significant_text(end, _MIN_DIGITS) for end in (change.low, change.high))
    if change.kind == "margin":
        return f"equivalent within margins of {high} or more"
    if change.kind == "relative margin":
        return f"equivalent within margins of {significant_text(100 * change.high, 3)} % or more"
    where = f"a {change.kind} of {low}" if low == high else f"{change.kind}s from {low} to {high}"
    return f"outcome changes at {where}"


def _sides(comparison: ComparisonResult, reach: float) -> str:
    """Write the two sides, with the place where they were taken and how many other entries are equal."""
    if comparison.n_entries > 1 and comparison.n_equal == comparison.n_entries:
        return f"equal to {_MAX_DIGITS} digits in all {comparison.n_entries} entries"
    digits = _digits(comparison.left, comparison.right)
    left, right = (number_text(side, reach, digits) for side in (comparison.left, comparison.right))
    text = f"{left} and {right}"
    # Equal numbers support every comparison but these; whether they are equal to the last bit is left to rounding.
    surprising = comparison.holds is (comparison.operator in ("<", ">"))
    if left == right and comparison.interval is None and surprising:
        text += f", equal to {_MAX_DIGITS} digits"
    place = [] if comparison.k is None else [f"k = {comparison.k}"]
    if comparison.entry is not None:
        place.append("entry " + ",".join(map(str, comparison.entry)))
    if place:
        text = f"{_extreme(comparison)} at {', '.join(place)}: {text}"
    if comparison.n_equal and comparison.n_entries > 1:
        text += f"; equal to {_MAX_DIGITS} digits in {comparison.n_equal} of {comparison.n_entries} entries"
    return text


def _extreme(comparison: ComparisonResult) -> str:
    """Say which of the entries is given."""
    if comparison.operator in ("~", "=="):
        return "largest difference"
    return "smallest margin" if comparison.holds else "largest violation"


def _digits(left: float, right: float) -> int:
    """Significant digits that distinguish two numbers, with one more to see by how much."""
    for digits in range(_MIN_DIGITS, _MAX_DIGITS + 1):
        if significant_text(left, digits) != significant_text(right, digits):
            return digits if digits == _MIN_DIGITS else min(digits + 1, _MAX_DIGITS)
    return _MIN_DIGITS


def number_text(value: float | None, uncertainty: float = math.nan, digits: int = _MIN_DIGITS) -> str:
    """Write a number with the digits that its uncertainty, half the width of its interval, supports."""
    if value is None or math.isnan(value):
        return "-"
    if math.isinf(value):
        return str(value)
    if not (math.isfinite(uncertainty) and uncertainty > 0 and 1e-4 <= abs(value) < 1e6):
        return significant_text(value, digits)
    return decimal_text(value, _decimals(significant(uncertainty, STABLE)))


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
