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
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.exact import closeness
from rmpc_bench.claims.grammar import parse_expression
from rmpc_bench.claims.spread import spread_of
from rmpc_bench.expressions.arithmetic import Number


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
    """Compute a stated number.

    Parameters
    ----------
    stated : the number of the paper
    trials, at, pooled : as of `Evaluator`

    Raises
    ------
    ExpressionError, EvaluationError
        when the expression cannot be read, or the stored results have no value for it
    """
    node = parse_expression(stated.of)
    evaluator = Evaluator(trials, node, at, pooled=pooled)
    value = evaluator.number(node)
    if stated.tolerance is None:
        close = closeness(value, stated)
        alike = Finding.CONFIRMED if close.finding is not Finding.DIFFERENT else _changed(stated, value)
        return Size(stated, value, close.finding, alike, close.relative)
    link = tree.Link(node, "~", Number(stated.value), Number(stated.tolerance), stated.of)
    spread = spread_of(link, evaluator, trials.confidence)
    interval = None if spread is None else spread.gap()
    if interval is not None:
        interval = (interval[0] + stated.value, interval[1] + stated.value)
    effect = _effect(stated, value, interval)
    return Size(stated, value, effect, effect, interval=interval)


def _effect(stated: Stated, value: float, interval: Interval | None) -> Finding:
    """Compare the size of an effect with the stated one."""
    tolerance = stated.tolerance or 0.0
    low, high = interval if interval is not None else (value, value)
    if math.isnan(low) or (low <= stated.value + tolerance and high >= stated.value - tolerance):
        return Finding.CONFIRMED
    return _changed(stated, value)


def _changed(stated: Stated, value: float) -> Finding:
    # A reduction of -8 % is smaller than one of -10 %.
    grows = value > stated.value if stated.value >= 0 else value < stated.value
    return Finding.CONFIRMED_LARGER if grows else Finding.CONFIRMED_SMALLER
