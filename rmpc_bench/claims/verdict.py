"""The finding of a claim: its checks evaluated on the stored trials.

A finding refers to our interpretation of the statement and to the configured experiment.  It is no rating of a paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims import joining
from rmpc_bench.claims.claim import Claim, Finding, HoldsFor, point_words
from rmpc_bench.claims.comparison import ComparisonResult, compared
from rmpc_bench.claims.evaluator import EvaluationError, Evaluator
from rmpc_bench.claims.grammar import ExpressionError, parse
from rmpc_bench.claims.size import Size, size_of


class Interpretation(NamedTuple):
    """The finding at one of several points that a claim is checked at."""

    at: str
    """The point in words."""
    finding: Finding


@dataclass(frozen=True)
class ClaimVerdict:
    """The computed finding of a claim, with its numbers.

    Parameters
    ----------
    claim : what was judged
    finding : the outcome in this experiment
    comparisons : one record per comparison that could be evaluated
    seed, n_runs : of the experiment
    reason : why a comparison could not be evaluated; else empty
    sizes : the stated numbers and the computed ones, at the first point
    interpretations : of a claim that is checked at several points
    cases : of a statement with a hedge, whether each of its cases holds
    level : one-sided error of each case of a statement about any or most of them; None where there is none
    confidence : level of the intervals of the comparisons
    """

    claim: Claim
    finding: Finding
    comparisons: tuple[ComparisonResult, ...]
    seed: int
    n_runs: int
    reason: str = ""
    sizes: tuple[Size, ...] = ()
    interpretations: tuple[Interpretation, ...] = ()
    cases: tuple[joining.Outcome, ...] = ()
    level: float | None = None
    confidence: float = 0.95

    @property
    def joined(self) -> Finding:
        """The finding over this and all other configurations with the same statement."""
        if not self.claim.elsewhere:
            return self.finding
        return joining.over_interpretations([self.finding, *self.claim.elsewhere.values()])

    @property
    def words(self) -> str:
        """The finding here with its cases or interpretations, or with the margin that all differences stay below."""
        counted = f", in {self.cases.count(True) or 'none'} of {len(self.cases)} cases" if self.cases else ""
        n_confirmed = sum(each.finding.is_confirmed for each in self.interpretations)
        if n_confirmed < len(self.interpretations):
            counted = f": confirmed under {n_confirmed or 'none'} of {len(self.interpretations)} interpretations"
        held = [each.below_margin for each in self.comparisons if each.holds] if self.finding.is_confirmed else []
        # One comparison beyond its margin is enough for a statement that matters.
        margin = f", but below the margin of relevance of {held[0]}" if held and all(held) else ""
        return f"{self.finding.sentence}{counted}{margin}"

    @property
    def joined_words(self) -> str:
        """The joined finding; where no other configuration has the statement, with what it rests on."""
        return self.joined.sentence if self.claim.elsewhere else self.words

    @property
    def differs(self) -> bool:
        """Whether the configuration records another finding."""
        return self.claim.finding is not None and self.finding != self.claim.finding


@dataclass(frozen=True)
class _AtPoint:
    """The checks of a claim and its stated numbers, evaluated at one point."""

    comparisons: list[list[ComparisonResult]] = field(default_factory=list)
    """For every check its comparisons."""
    reasons: list[str] = field(default_factory=list)
    sizes: list[Size] = field(default_factory=list)

    @property
    def cases(self) -> list[joining.Outcome]:
        """Whether each check holds."""
        return [joining.all_of([each.holds for each in check]) for check in self.comparisons]

    def finding(self, claim: Claim) -> Finding:
        if self.reasons:
            return Finding.INCONCLUSIVE
        if not claim.check:
            return joining.over_numbers([size.finding for size in self.sizes if size.is_exact])
        return self.with_sizes(joining.over_list(self.cases))

    def with_sizes(self, finding: Finding) -> Finding:
        """Say of a statement that holds whether the effect has the stated size."""
        effects = (size.effect for size in self.sizes)
        return next((each for each in effects if each is not finding), finding) if finding.is_confirmed else finding


def judge(claim: Claim, trials: Trials) -> ClaimVerdict:
    """Compute the finding of a claim; one that cannot be evaluated is inconclusive, with the reason."""
    at = claim.at or ({},)
    hedged = claim.holds_for is not HoldsFor.ALL
    n_cases = len(at) * len(claim.check)
    # So many cases fail at least where "can" or "usually" is untrue: they share the error of one of them, one-sided.
    failing = n_cases - joining.needed(n_cases, claim.holds_for) + 1
    level = (1 - trials.confidence) / (2 * failing) if hedged and n_cases else None
    confidence = trials.confidence if level is None else 1 - 2 * level
    points = [_evaluated(claim, trials, where, confidence) for where in at]
    reasons = dict.fromkeys(reason for point in points for reason in point.reasons)
    cases = [case for point in points for case in point.cases] if hedged else []
    findings = [point.finding(claim) for point in points] if claim.is_testable else [Finding.NOT_TESTABLE]
    overall = joining.over_interpretations(findings)
    if hedged and claim.check:
        overall = points[0].with_sizes(joining.over_cases(cases, claim.holds_for))
    if hedged and reasons:
        overall = Finding.INCONCLUSIVE
    several = len(claim.at) > 1 and claim.is_testable and not hedged
    return ClaimVerdict(
        claim=claim,
        finding=overall,
        comparisons=tuple(each for point in points for check in point.comparisons for each in check),
        seed=trials.seed,
        n_runs=len(trials.each[0].runs),
        reason="; ".join(reasons),
        sizes=tuple(points[0].sizes),
        interpretations=tuple(map(Interpretation, map(point_words, claim.at), findings)) if several else (),
        cases=tuple(cases),
        level=level,
        confidence=confidence,
    )


def _evaluated(claim: Claim, trials: Trials, at: Mapping[str, str], confidence: float) -> _AtPoint:
    """Evaluate all checks and stated numbers of a claim at one point."""
    found = _AtPoint()
    where = point_words(at) if len(claim.at) > 1 else ""
    for check in claim.check:
        try:
            chain = parse(check)
        except ExpressionError as error:
            found.reasons.append(f"{check}: {error}")
            continue
        parts = []
        for statement in (chain,) if chain.everywhere else chain.links:
            try:
                evaluator = Evaluator(trials, statement, at, pooled=claim.pooled)
                parts.append(replace(compared(statement, evaluator, confidence), at=where))
            except EvaluationError as error:
                found.reasons.append(f"{statement.text}: {error}")
        found.comparisons.append(parts)
    for stated in claim.numbers:
        try:
            found.sizes.append(size_of(stated, trials, at, pooled=claim.pooled))
        except (ExpressionError, EvaluationError) as error:
            found.reasons.append(f"{stated.of}: {error}")
    return found
