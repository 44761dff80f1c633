"""The finding of a claim: its checks evaluated on the stored trials, its stated numbers beside the computed ones.

A finding refers to our interpretation of the statement and to the configured experiment.  It is no rating of a paper.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from rmpc_bench.analysis.intervals import Interval
from rmpc_bench.analysis.rounding import negligible, without_noise
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims import grammar
from rmpc_bench.claims.claim import Claim, Finding, HoldsFor, Stated, closeness, point_words
from rmpc_bench.claims.comparison import ComparisonResult, compared
from rmpc_bench.claims.evaluator import EvaluationError, Evaluator
from rmpc_bench.claims.grammar import ExpressionError, parse, parse_expression
from rmpc_bench.claims.spread import spread_of
from rmpc_bench.expressions.arithmetic import Call, Node, Number, Operation

Outcome = bool | None
"""Whether a comparison holds; None where the runs do not decide."""


def all_of(parts: Sequence[Outcome]) -> Outcome:
    """Whether all parts of one case hold: not if one fails, else inconclusive if one is."""
    if False in parts:
        return False
    return None if None in parts else True


def over_list(parts: Sequence[Outcome]) -> Finding:
    """Join the parts of a statement that says all of them.

    >>> [over_list(parts).value for parts in ([True, None], [True, False], [None, False])]
    ['inconclusive', 'partially-confirmed', 'not-confirmed']
    """
    if False not in parts:
        return Finding.INCONCLUSIVE if None in parts else Finding.CONFIRMED
    return Finding.PARTIALLY_CONFIRMED if True in parts else Finding.NOT_CONFIRMED


def needed(n_cases: int, holds_for: HoldsFor) -> int:
    """Return the number of cases that must hold."""
    return {HoldsFor.ANY: 1, HoldsFor.MOST: n_cases // 2 + 1}.get(holds_for, n_cases)


def over_cases(cases: Sequence[Outcome], holds_for: HoldsFor) -> Finding:
    """Join the cases of a statement: ``any`` for "can", ``most`` for "usually", which is more than half of them.

    >>> [over_cases(cases, HoldsFor.MOST).value for cases in ([True, True, None], [True, None], [False, None])]
    ['confirmed', 'inconclusive', 'not-confirmed']
    """
    least = needed(len(cases), holds_for)
    if cases.count(True) >= least:
        return Finding.CONFIRMED
    possible = len(cases) - cases.count(False)
    return Finding.INCONCLUSIVE if possible >= least else Finding.NOT_CONFIRMED


def over_numbers(findings: Sequence[Finding]) -> Finding:
    """Join numbers without Monte Carlo error, each equal, close or different."""
    if len(set(findings)) == 1:
        return findings[0]
    return Finding.PARTIALLY_CONFIRMED if Finding.DIFFERENT in findings else Finding.CLOSE


def over_interpretations(findings: Sequence[Finding]) -> Finding:
    """Join the findings under all interpretations; the first is ours.

    Those that are not testable count only if all are.  A statement depends on what the paper leaves open only if at
    least one interpretation confirms it and the runs show that another one does not.

    >>> over_interpretations([Finding.CONFIRMED, Finding.CONFIRMED_SMALLER]).value
    'confirmed'
    >>> over_interpretations([Finding.INCONCLUSIVE, Finding.NOT_CONFIRMED]).value
    'not-confirmed'
    >>> over_interpretations([Finding.INCONCLUSIVE, Finding.PARTIALLY_CONFIRMED]).value
    'inconclusive'
    """
    tested: list[Finding] = [finding for finding in findings if finding is not Finding.NOT_TESTABLE]
    tested = tested or [*findings]
    # Under other interpretations the size may differ: the statement holds all the same.
    if len(set(tested)) == 1 or all(finding.is_confirmed for finding in tested):
        return tested[0]
    if Finding.DEPENDS_ON_ASSUMPTIONS in tested:
        return Finding.DEPENDS_ON_ASSUMPTIONS
    if any(finding.is_confirmed for finding in tested):
        others = {finding for finding in tested if not finding.is_confirmed}
        return Finding.INCONCLUSIVE if others == {Finding.INCONCLUSIVE} else Finding.DEPENDS_ON_ASSUMPTIONS
    failed = {Finding.NOT_CONFIRMED, Finding.DIFFERENT}.intersection(tested)
    return Finding.NOT_CONFIRMED if failed else Finding.INCONCLUSIVE


@dataclass(frozen=True)
class Size:
    """A computed number in comparison with the stated one."""

    stated: Stated  # the number of the paper
    value: float  # the computed one
    finding: Finding  # equal, close or different for a number without Monte Carlo error; else as `effect`
    # of a statement that holds: confirmed, or smaller or larger where the interval of the computed number lies
    # outside the tolerance, or where a number without Monte Carlo error is different
    effect: Finding
    relative: float | None = None  # difference relative to the stated number, for a number without Monte Carlo error
    interval: Interval | None = None  # of the computed number; None where it has none

    @property
    def is_exact(self) -> bool:
        """Whether the printed digits are compared."""
        return self.stated.tolerance is None

    def rounded(self) -> Size:
        """Return the numbers with the digits that another CPU reproduces, for what is written."""
        scale = max(abs(self.stated.value), self.stated.tolerance or 0.0)
        value = 0.0 if negligible(self.value, scale) else self.value
        if self.interval is None:
            return replace(self, value=value)
        low, high = (without_noise(end, scale) for end in self.interval)
        return replace(self, value=value, interval=(low, high))


def size_of(stated: Stated, trials: Trials, at: Mapping[str, str], *, pooled: bool) -> Size:
    """Compute a stated number; raises ExpressionError or EvaluationError where it has no value."""
    node = parse_expression(stated.of)
    evaluator = Evaluator(trials, node, at, pooled=pooled)
    value = evaluator.number(node)
    neutral = _neutral(node, evaluator)
    if stated.tolerance is None:
        if evaluator.is_estimated(node):
            raise EvaluationError("is estimated from runs, and has no tolerance")
        close = closeness(value, stated)
        alike = Finding.CONFIRMED if close.finding is not Finding.DIFFERENT else _changed(stated, value, neutral)
        return Size(stated, value, close.finding, alike, close.relative)
    link = grammar.Link(node, "~", Number(stated.value), Number(stated.tolerance), stated.of)
    spread = spread_of(link, evaluator, trials.confidence)
    interval = None if spread is None else spread.gap()
    if interval is not None:
        interval = (interval[0] + stated.value, interval[1] + stated.value)
    effect = _effect(stated, value, interval, neutral)
    return Size(stated, value, effect, effect, interval=interval)


def _effect(stated: Stated, value: float, interval: Interval | None, neutral: float | None) -> Finding:
    """Compare the size of an effect with the stated one."""
    tolerance = stated.tolerance or 0.0
    low, high = interval if interval is not None else (value, value)
    if math.isnan(low) or (low <= stated.value + tolerance and high >= stated.value - tolerance):
        return Finding.CONFIRMED
    return _changed(stated, value, neutral)


def _changed(stated: Stated, value: float, neutral: float | None) -> Finding:
    """Compare sizes of effects: the absolute log of a ratio, else the distance from 0 in the stated direction."""
    if neutral is not None and min(value / neutral, stated.value / neutral) > 0:
        effect, said = math.log(value / neutral), math.log(stated.value / neutral)
    else:
        effect, said = value, stated.value
    # A reduction of -8 % is smaller than one of -10 %.
    grows = effect * math.copysign(1, said) > abs(said) if said else effect != 0
    return Finding.CONFIRMED_LARGER if grows else Finding.CONFIRMED_SMALLER


def _neutral(node: Node, evaluator: Evaluator) -> float | None:
    """Value of a ratio of equal sides, such as 100 for ``100 * mean(mse[A]) / mean(mse[B])``; None for no ratio."""
    above, below, factor = set[str](), set[str](), 1.0
    parts = [("*", node)]
    if isinstance(node, Operation) and node.rest[0].operator in "*/":
        parts = [("*", node.first), *((each.operator, each.node) for each in node.rest)]
    for operator, part in parts:
        names = {term.quantity for term in grammar.terms(part)}
        if isinstance(part, Call) and part.function == "ratio":
            sides = [{term.quantity for term in grammar.terms(side)} for side in part.arguments]
            above, below = above | sides[operator == "/"], below | sides[operator == "*"]
        elif names:
            above, below = (above | names, below) if operator == "*" else (above, below | names)
        else:
            factor *= evaluator.number(part) ** (1 if operator == "*" else -1)
    return factor if above and above == below and factor > 0 else None


class Interpretation(NamedTuple):
    """The finding at one of several points that a claim is checked at."""

    at: str  # the point in words
    finding: Finding


@dataclass(frozen=True, repr=False)
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
    cases: tuple[Outcome, ...] = ()
    level: float | None = None
    confidence: float = 0.95

    def __repr__(self) -> str:
        return f"<ClaimVerdict {self.claim.says[:60]!r}: {self.finding.sentence}>"

    @property
    def joined(self) -> Finding:
        """The finding over this and all other configurations with the same statement."""
        if not self.claim.elsewhere:
            return self.finding
        return over_interpretations([self.finding, *self.claim.elsewhere.values()])

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

    comparisons: list[list[ComparisonResult]] = field(default_factory=list)  # for every check its comparisons
    reasons: list[str] = field(default_factory=list)
    sizes: list[Size] = field(default_factory=list)

    @property
    def cases(self) -> list[Outcome]:
        """Whether each check holds."""
        return [all_of([each.holds for each in check]) for check in self.comparisons]

    def finding(self, claim: Claim) -> Finding:
        if self.reasons:
            return Finding.INCONCLUSIVE
        if not claim.check:
            return over_numbers([size.finding for size in self.sizes if size.is_exact])
        return self.with_sizes(over_list(self.cases))

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
    failing = n_cases - needed(n_cases, claim.holds_for) + 1
    level = (1 - trials.confidence) / (2 * failing) if hedged and n_cases else None
    confidence = trials.confidence if level is None else 1 - 2 * level
    points = [_evaluated(claim, trials, where, confidence) for where in at]
    reasons = dict.fromkeys(reason for point in points for reason in point.reasons)
    cases = [case for point in points for case in point.cases] if hedged else []
    findings = [point.finding(claim) for point in points] if claim.is_testable else [Finding.NOT_TESTABLE]
    overall = over_interpretations(findings)
    if hedged and claim.check:
        overall = points[0].with_sizes(over_cases(cases, claim.holds_for))
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
