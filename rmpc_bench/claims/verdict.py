"""What a paper says, judged on the stored trials.

A statement is judged as we read it on the experiment as we read it; nothing here scores a paper.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import Claim, Stated
from rmpc_bench.claims.comparison import Compared, compared
from rmpc_bench.claims.evaluator import EvaluationError, Evaluator
from rmpc_bench.claims.evidence import evidence, plain, shown
from rmpc_bench.claims.grammar import ExpressionError, parse, parse_expression


@dataclass(frozen=True)
class Verdict:
    """The computed finding of a claim, with its numbers.

    Parameters
    ----------
    claim : what was judged
    finding : found, found-smaller, found-larger, partly, undecided, not found or not testable
    numbers : one record per comparison that could be evaluated
    seed, n_runs : of the experiment
    reason : why a comparison could not be evaluated; else empty
    size : value of the stated expression, None where none is stated
    interpretations : point in words and its finding, of a claim that is made at several points
    """

    claim: Claim
    finding: str
    numbers: tuple[Compared, ...]
    seed: int
    n_runs: int
    reason: str = ""
    size: float | None = None
    interpretations: tuple[tuple[str, str], ...] = ()


class _Interpretation(NamedTuple):
    """What the checks of a claim have come to at one point."""

    numbers: list[Compared]
    reasons: list[str]
    size: float | None

    def finding(self, claim: Claim) -> str:
        if self.reasons:
            return "inconclusive"
        held = [number.holds for number in self.numbers]
        if all(held):
            return "confirmed" + _size_suffix(claim.stated, self.size)
        if False not in held:
            return "inconclusive"
        return "partially-confirmed" if True in held else "not-confirmed"


def judge(claim: Claim, trials: Trials) -> Verdict:
    """Compute the finding of a claim.

    Parameters
    ----------
    claim : the claim
    trials : the table of trials

    Returns
    -------
    the verdict; a claim that cannot be evaluated is undecided, with the reason
    """
    interpretations = [_read(claim, trials, at) for at in claim.at or ({},)]
    findings = [interpretation.finding(claim) for interpretation in interpretations]
    numbers = tuple(number for interpretation in interpretations for number in interpretation.numbers)
    reasons = "; ".join(
        dict.fromkeys(reason for interpretation in interpretations for reason in interpretation.reasons)
    )
    n_runs = len(trials.each[0].runs)
    finding = _overall(findings) if claim.check else "not-testable"
    named = tuple(zip(map(_words, claim.at), findings, strict=True)) if len(claim.at) > 1 and claim.check else ()
    return Verdict(claim, finding, numbers, trials.seed, n_runs, reasons, interpretations[0].size, named)


def _read(claim: Claim, trials: Trials, at: Mapping[str, str]) -> _Interpretation:
    """Make all checks of a claim at one point."""
    numbers, reasons, size = [], [], None
    where = _words(at) if len(claim.at) > 1 else ""
    for check in claim.check:
        try:
            chain = parse(check)
        except ExpressionError as error:
            reasons.append(f"{check}: {error}")
            continue
        for statement in (chain,) if chain.everywhere else chain.links:
            try:
                evaluator = Evaluator(trials, statement, at, pooled=claim.pooled)
                numbers.append(replace(compared(statement, evaluator), at=where))
            except EvaluationError as error:
                reasons.append(f"{statement.text}: {error}")
    if isinstance(claim.stated, Stated):
        try:
            node = parse_expression(claim.stated.of)
            size = Evaluator(trials, node, at, pooled=claim.pooled).number(node)
        except (ExpressionError, EvaluationError) as error:
            reasons.append(f"{claim.stated.of}: {error}")
    return _Interpretation(numbers, reasons, size)


def _words(at: Mapping[str, str]) -> str:
    """Name a point: by its name alone where it has one, else by its values."""
    named = {"name": at["name"]} if "name" in at else {}
    rest = [f"{path}={value}" for path, value in at.items() if path not in named]
    return ", ".join([*named.values(), *rest])


def _overall(findings: Sequence[str]) -> str:
    """Sum up the findings of all interpretations: one that holds in some of them only depends on what is not stated."""
    if len(set(findings)) == 1:
        return findings[0]
    held = [finding.startswith("confirmed") for finding in findings]
    if all(held):
        return findings[0]  # the sizes differ: the first interpretation is ours
    if any(held):
        return "depends-on-assumptions"
    return next(finding for finding in ("partially-confirmed", "inconclusive") if finding in findings)


def _size_suffix(stated: str | Stated | None, size: float | None) -> str:
    if not isinstance(stated, Stated) or size is None or abs(size - stated.value) <= stated.tolerance:
        return ""
    # A reduction of -8 % is smaller than one of -10 %.
    grows = size > stated.value if stated.value >= 0 else size < stated.value
    return "-larger" if grows else "-smaller"


def claims_table(verdicts: Iterable[Verdict]) -> list[dict[str, Any]]:
    """Turn verdicts into what claims.json holds.

    Parameters
    ----------
    verdicts : the verdicts

    Returns
    -------
    one dictionary per claim, of JSON types and finite numbers; inf is a text, an open end of an interval None
    """
    return [
        {
            "says": verdict.claim.says,
            "source": verdict.claim.source,
            "check": list(verdict.claim.check),
            "at": "all" if verdict.claim.pooled else [dict(at) for at in verdict.claim.at],
            "recorded": verdict.claim.finding,
            "finding": verdict.finding,
            "interpretations": [{"at": at, "finding": finding} for at, finding in verdict.interpretations],
            "reason": verdict.reason or None,
            "numbers": [_number_row(number) for number in verdict.numbers],
            "n_runs": verdict.n_runs,
            "seed": verdict.seed,
            "stated": _stated_row(verdict.claim.stated),
            "size": None if verdict.size is None else plain(verdict.size),
            "assumptions": list(verdict.claim.assumptions),
        }
        for verdict in verdicts
    ]


def _number_row(number: Compared) -> dict[str, Any]:
    ends = None if number.interval is None else [end if math.isfinite(end) else None for end in number.interval]
    return {
        "text": number.text,
        "left": plain(number.left),
        "right": plain(number.right),
        "holds": number.holds,
        "interval": ends,
        "n": number.n,
        "left_out": number.left_out,
        "at": number.at or None,
        "k": number.k,
        "entry": None if number.entry is None else list(number.entry),
    }


def _stated_row(stated: str | Stated | None) -> Any:
    if not isinstance(stated, Stated):
        return stated
    row = {"of": stated.of, "value": plain(stated.value), "tolerance": plain(stated.tolerance)}
    return {**row, "text": stated.text}


def claims_markdown(verdicts: Iterable[Verdict], *, informational: bool) -> str:
    """Write claims.md.

    Parameters
    ----------
    verdicts : the verdicts
    informational : True when the configuration was modified or not at full size

    Returns
    -------
    Markdown, ending with a newline
    """
    ordered = sorted(verdicts, key=lambda verdict: not verdict.claim.of_paper)
    lines = []
    if informational:
        lines += ["For information only: the configuration was modified or did not run at full size.", ""]
    for position, verdict in enumerate(ordered, 1):
        if position == 1 or ordered[position - 2].claim.of_paper != verdict.claim.of_paper:
            lines += ["# What the paper says" if verdict.claim.of_paper else "# Additional results", ""]
        lines += [f"## {position}. {_line(verdict.claim.says)}", "", *_items(verdict), ""]
    return "\n".join(lines)


def _items(verdict: Verdict) -> list[str]:
    claim = verdict.claim
    items = [f"- source: {_line(claim.source)}", f"- finding: **{verdict.finding}**"]
    if claim.finding:
        items[-1] += f" (recorded: {claim.finding})"
    if verdict.reason:
        items.append(f"- not evaluated: {_line(verdict.reason)}")
    for finding in dict.fromkeys(finding for _, finding in verdict.interpretations):
        items.append(f"- {finding} at: " + "; ".join(at for at, each in verdict.interpretations if each == finding))
    items += [_number_item(number) for number in verdict.numbers]
    where = _where(claim)
    runs = "1 run" if verdict.n_runs == 1 else f"{verdict.n_runs} runs"
    items.append(f"- {runs}, seed {verdict.seed}{where}" if verdict.n_runs else f"- exact, without runs{where}")
    if isinstance(claim.stated, Stated):
        items.append(f"- stated: {_line(claim.stated.text)}; here `{claim.stated.of}` is {shown(verdict.size)}")
    elif claim.stated:
        items.append(f"- stated: {_line(claim.stated)}")
    if claim.assumptions:
        items += ["- assumptions:", *(f"  - {_line(assumption)}" for assumption in claim.assumptions)]
    return items


def _where(claim: Claim) -> str:
    """The point of a sweep that a claim is made at."""
    if claim.pooled:
        return ", of every point of the sweep"
    return f", at {_words(claim.at[0])}" if len(claim.at) == 1 else ""


def _number_item(number: Compared) -> str:
    where = f" at {number.at}" if number.at else ""
    return f"- `{_line(number.text)}`{where}: {evidence(number)}"


def _line(text: str) -> str:
    return " ".join(text.split())
