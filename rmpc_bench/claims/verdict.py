"""The finding of a claim: its checks evaluated on the stored trials.

A finding refers to our interpretation of the statement and to the configured experiment.  It is no rating of a paper.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from rmpc_bench.analysis.rounding import negligible
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import Claim, Finding, Stated
from rmpc_bench.claims.comparison import ComparisonResult, compared
from rmpc_bench.claims.evaluator import EvaluationError, Evaluator
from rmpc_bench.claims.grammar import ExpressionError, parse, parse_expression


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
    finding : the outcome
    comparisons : one record per comparison that could be evaluated
    seed, n_runs : of the experiment
    reason : why a comparison could not be evaluated; else empty
    size : value of the stated expression, None where none is stated
    interpretations : of a claim that is checked at several points
    """

    claim: Claim
    finding: Finding
    comparisons: tuple[ComparisonResult, ...]
    seed: int
    n_runs: int
    reason: str = ""
    size: float | None = None
    interpretations: tuple[Interpretation, ...] = ()

    @property
    def size_written(self) -> float | None:
        """The size, 0 where it is nothing but rounding beside the stated one."""
        stated, size = self.claim.stated, self.size
        if size is None or not isinstance(stated, Stated):
            return size
        return 0.0 if negligible(size, max(abs(stated.value), stated.tolerance)) else size

    @property
    def differs(self) -> bool:
        """Whether the configuration records another finding."""
        return self.claim.finding is not None and self.finding != self.claim.finding


class _Outcome(NamedTuple):
    """The checks of a claim, evaluated at one point."""

    comparisons: list[ComparisonResult]
    reasons: list[str]
    size: float | None

    def finding(self, claim: Claim) -> Finding:
        if self.reasons:
            return Finding.INCONCLUSIVE
        held = [comparison.holds for comparison in self.comparisons]
        if all(held):
            return _confirmed(claim.stated, self.size)
        if False not in held:
            return Finding.INCONCLUSIVE
        return Finding.PARTIALLY_CONFIRMED if True in held else Finding.NOT_CONFIRMED


def judge(claim: Claim, trials: Trials) -> ClaimVerdict:
    """Compute the finding of a claim.

    Parameters
    ----------
    claim : the claim
    trials : the table of trials

    Returns
    -------
    the verdict; a claim that cannot be evaluated is inconclusive, with the reason
    """
    outcomes = [_evaluated(claim, trials, at) for at in claim.at or ({},)]
    findings = [outcome.finding(claim) for outcome in outcomes]
    reasons = dict.fromkeys(reason for outcome in outcomes for reason in outcome.reasons)
    several = len(claim.at) > 1 and claim.check
    return ClaimVerdict(
        claim=claim,
        finding=_overall(findings) if claim.check else Finding.NOT_TESTABLE,
        comparisons=tuple(comparison for outcome in outcomes for comparison in outcome.comparisons),
        seed=trials.seed,
        n_runs=len(trials.each[0].runs),
        reason="; ".join(reasons),
        size=outcomes[0].size,
        interpretations=tuple(map(Interpretation, map(point_words, claim.at), findings)) if several else (),
    )


def _evaluated(claim: Claim, trials: Trials, at: Mapping[str, str]) -> _Outcome:
    """Evaluate all checks of a claim at one point."""
    comparisons, reasons, size = [], [], None
    where = point_words(at) if len(claim.at) > 1 else ""
    for check in claim.check:
        try:
            chain = parse(check)
        except ExpressionError as error:
            reasons.append(f"{check}: {error}")
            continue
        for statement in (chain,) if chain.everywhere else chain.links:
            try:
                evaluator = Evaluator(trials, statement, at, pooled=claim.pooled)
                comparisons.append(replace(compared(statement, evaluator), at=where))
            except EvaluationError as error:
                reasons.append(f"{statement.text}: {error}")
    if isinstance(claim.stated, Stated):
        try:
            node = parse_expression(claim.stated.of)
            size = Evaluator(trials, node, at, pooled=claim.pooled).number(node)
        except (ExpressionError, EvaluationError) as error:
            reasons.append(f"{claim.stated.of}: {error}")
    return _Outcome(comparisons, reasons, size)


def point_words(at: Mapping[str, str]) -> str:
    """Name a point of a sweep: by its name alone where it has one, else by its values."""
    named = {"name": at["name"]} if "name" in at else {}
    rest = [f"{path}={value}" for path, value in at.items() if path not in named]
    return ", ".join([*named.values(), *rest])


def _overall(findings: Sequence[Finding]) -> Finding:
    """Join the findings of all interpretations: confirmed in some of them only depends on unstated assumptions."""
    if len(set(findings)) == 1:
        return findings[0]
    confirmed = [finding.is_confirmed for finding in findings]
    if all(confirmed):
        # The sizes differ: the first interpretation is ours.
        return findings[0]
    if any(confirmed):
        return Finding.DEPENDS_ON_ASSUMPTIONS
    mixed = (Finding.PARTIALLY_CONFIRMED, Finding.INCONCLUSIVE)
    return next(finding for finding in mixed if finding in findings)


def _confirmed(stated: str | Stated | None, size: float | None) -> Finding:
    """Compare the size of the effect with the stated one."""
    if not isinstance(stated, Stated) or size is None or abs(size - stated.value) <= stated.tolerance:
        return Finding.CONFIRMED
    # A reduction of -8 % is smaller than one of -10 %.
    grows = size > stated.value if stated.value >= 0 else size < stated.value
    return Finding.CONFIRMED_LARGER if grows else Finding.CONFIRMED_SMALLER
