"""A number that a paper gives beside the computed one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from rmpc_bench.analysis.intervals import Interval
from rmpc_bench.analysis.rounding import negligible, without_noise
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims import tree
from rmpc_bench.claims.claim import Finding, Stated
from rmpc_bench.claims.evaluator import EvaluationError, Evaluator
from rmpc_bench.claims.exact import closeness
from rmpc_bench.claims.grammar import parse_expression
from rmpc_bench.claims.spread import spread_of
from rmpc_bench.expressions.arithmetic import Call, Node, Number, Operation


@dataclass(frozen=True)
class Size:
    """A computed number in comparison with the stated one.

    Parameters
    ----------
    stated : the number of the paper
    value : the computed one
    finding : equal, close or different for a number without Monte Carlo error; else as `effect`
    effect : of a statement that holds: confirmed, or smaller or larger where the interval of the computed number lies
        outside the tolerance, or where a number without Monte Carlo error is different
    relative : difference relative to the stated number, for a number without Monte Carlo error
    interval : of the computed number; None where it has none
    """

    stated: Stated
    value: float
    finding: Finding
    effect: Finding
    relative: float | None = None
    interval: Interval | None = None

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
    link = tree.Link(node, "~", Number(stated.value), Number(stated.tolerance), stated.of)
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
        names = {term.quantity for term in tree.terms(part)}
        if isinstance(part, Call) and part.function == "ratio":
            sides = [{term.quantity for term in tree.terms(side)} for side in part.arguments]
            above, below = above | sides[operator == "/"], below | sides[operator == "*"]
        elif names:
            above, below = (above | names, below) if operator == "*" else (above, below | names)
        else:
            factor *= evaluator.number(part) ** (1 if operator == "*" else -1)
    return factor if above and above == below and factor > 0 else None
