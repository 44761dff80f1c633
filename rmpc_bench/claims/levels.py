"""Intervals of single estimates over the runs (shares, quantiles, extremes, geometric means) and of sides made of them.

A quantile lies between two order statistics, whose ranks are binomial.  Where the runs do not suffice for a rank, as
for every extreme, that end is infinite.  A share has the wider of the interval of Wilson, which is too narrow for rare
events, and the exact one of Clopper and Pearson.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rmpc_bench.analysis.intervals import Interval, difference, exact_share, geometric, order_ranks, wilson
from rmpc_bench.claims import tree
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.values import EvaluationError, NoValue, Value
from rmpc_bench.expressions.arithmetic import Call, Negation, Node, Operand, Operation, Percent
from rmpc_bench.types import Array

ORDER = ("median", "quantile", "min", "max")
_MOST = 6
"""Largest number of estimates whose ends are combined."""
Ends = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class CornerSpread:
    """Sides and tolerance at every combination of the ends of the estimates in them."""

    left: Array
    right: Array
    tolerance: Array

    def gap(self, shift: int = 0) -> Interval:
        """Smallest and largest difference."""
        gaps = difference(self.left, self.right) + (shift * self.tolerance if shift else 0.0)
        return float(gaps.min()), float(gaps.max())

    def ratio(self) -> Interval:
        """Smallest and largest ratio; unbounded where a divisor reaches 0."""
        with np.errstate(all="ignore"):
            ratios = self.left / self.right
        if self.right.min() <= 0 <= self.right.max() or np.isnan(ratios).any():
            return -math.inf, math.inf
        return float(ratios.min()), float(ratios.max())


def level_spread(link: tree.Link, evaluator: Evaluator, confidence: float, times: float = 1.0) -> CornerSpread | None:
    """Spread of sides made of one estimate and numbers, with `times` as many runs; None for any other comparison."""
    calls = estimates(link, evaluator)
    if evaluator.pooled or len(calls) != 1 or not _is_arithmetic(link, evaluator):
        return None
    return at_ends(link, evaluator, {calls[0]: _ends(calls[0], evaluator, confidence, times)})


def unseen(link: tree.Link, evaluator: Evaluator, confidence: float) -> dict[Call, Ends]:
    """Ends of the estimates that no resample of the runs can show: beyond the largest run, or of a share of 0 or 1."""
    found = {}
    for call in estimates(link, evaluator):
        value = evaluator.value(call).array
        low, high = _ends(call, evaluator, confidence)
        if call.function in ORDER:
            low, high = (np.where(np.isinf(end), end, value) for end in (low, high))
        elif call.function == "ratio" or 0 < value < 1:
            continue
        if (low != value).any() or (high != value).any():
            found[call] = (low, high)
    return found


def at_ends(link: tree.Link, evaluator: Evaluator, ends: Mapping[Call, Ends]) -> CornerSpread | None:
    """Evaluate a comparison at every combination of ends; None where a divisor reaches 0, or of too many."""
    rows: list[Sequence[Array]] = []
    divisors: dict[Node, list[Array]] = {}
    if len(ends) > _MOST:
        return None
    for corner in itertools.product(*ends.values()):
        other = evaluator.with_values({call: Value(end) for call, end in zip(ends, corner, strict=True)})
        try:
            left, right, tolerance = other.sides(link)
        except NoValue:
            return None
        rows.append((left.array, right, tolerance))
        for node in _divisors(link, evaluator):
            divisors.setdefault(node, []).append(np.sign(other.value(node).array))
    if any(len(set(map(float, signs))) > 1 for signs in divisors.values()):
        return None
    return CornerSpread(*(np.array(column) for column in zip(*rows, strict=True)))


def estimates(node: Node, evaluator: Evaluator) -> list[Call]:
    """Collect the outermost calls that estimate a share, quantile, extreme or geometric mean over the runs."""
    if isinstance(node, Call) and _is_estimate(node, evaluator):
        return [node]
    return [found for child in tree.children(node) for found in estimates(child, evaluator)]


def _is_estimate(call: Call, evaluator: Evaluator) -> bool:
    first = call.arguments[0]
    if tree.terms(call).isdisjoint(evaluator.columns):
        return False
    if isinstance(first, tree.Chain):
        return evaluator.holds(first.links).axis == "runs"
    try:
        values = [evaluator.value(argument) for argument in call.arguments]
    except EvaluationError:
        return False  # Such as a signal, whose moments alone are known.
    if call.function == "ratio":
        return all(value.axis == "runs" for value in values)
    if call.function == "mean":
        # Zeros and ones say whether something happened: their mean is a share.
        return values[0].axis == "runs" and values[0].array.ndim == 1 and set(np.unique(values[0].array)) <= {0.0, 1.0}
    return call.function in ORDER and values[0].axis == "runs"


def _is_arithmetic(node: Node, evaluator: Evaluator) -> bool:
    """Whether columns enter by estimates of whole columns and the four operations only, so that ends give ends."""
    if tree.terms(node).isdisjoint(evaluator.columns):
        return True
    if isinstance(node, Call) and _is_estimate(node, evaluator):
        inner = [call for argument in node.arguments for call in tree.calls(argument)]
        of_runs = [call for call in inner if not tree.terms(call).isdisjoint(evaluator.columns)]
        return all(evaluator.value(call).axis == "runs" for call in of_runs)
    known = isinstance(node, tree.Link | Operation | Operand | Negation | Percent)
    known = known or (isinstance(node, Call) and node.function == "ratio")
    return known and all(_is_arithmetic(child, evaluator) for child in tree.children(node))


def _divisors(link: tree.Link, evaluator: Evaluator) -> list[Node]:
    """Collect the divisors that depend on the runs, outside of columns."""
    found = [each.node for each in tree.walk(link) if isinstance(each, Operand) and each.operator == "/"]
    found += [call.arguments[1] for call in tree.calls(link) if call.function == "ratio"]
    found = [node for node in found if not tree.terms(node).isdisjoint(evaluator.columns)]
    return [node for node in found if not evaluator.value(node).array.ndim]


def _ends(call: Call, evaluator: Evaluator, confidence: float, times: float = 1.0) -> Ends:
    """Interval of an estimate; runs that are pooled over points count once."""
    first, *others = call.arguments
    n = max(round(len(evaluator.runs) * times), 1)
    value = evaluator.value(call).array
    if call.function in ("share", "mean"):
        near, exact = (law(float(value) * n, n, confidence) for law in (wilson, exact_share))
        return np.array(min(near[0], exact[0])), np.array(max(near[1], exact[1]))
    a = evaluator.value(first).array
    if call.function == "ratio":
        interval = geometric(a, evaluator.value(others[0]).array, confidence)[1]
        low, high = (value * (end / value) ** times**-0.5 for end in interval)
        return np.asarray(low), np.asarray(high)
    q = {"min": 0.0, "median": 0.5, "max": 1.0}.get(call.function)
    ordered = np.sort(a, axis=0)
    low, high = order_ranks(n, float(evaluator.value(others[0]).array) if q is None else q, confidence)
    share = len(ordered) / n
    # With another number of runs the law of a run is the one seen.
    below = ordered[math.ceil(low * share) - 1] if low >= 1 else np.full(value.shape, -np.inf)
    above = ordered[math.ceil(high * share) - 1] if high <= n else np.full(value.shape, np.inf)
    return np.minimum(below, value), np.maximum(above, value)
