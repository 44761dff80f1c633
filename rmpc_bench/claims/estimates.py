"""Intervals of single estimates over the runs (shares, quantiles, extremes, ratios) and of sides made of them.

A quantile lies between two order statistics, whose ranks are binomial.  Where the runs do not suffice for a rank, as
for every extreme, that end is infinite.  A share has the wider of the interval of Wilson, which is too narrow for rare
events, and the exact one of Clopper and Pearson.

What is computed from moments over the runs has pseudo-values: a value theta of U groups of runs has
``U theta - (U - 1) theta without a group``; their mean and its standard error give Student intervals.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import (
    FEW,
    Interval,
    difference,
    exact_share,
    fieller,
    mean_interval,
    order_ranks,
    student,
    wilson,
)
from rmpc_bench.analysis.rounding import NEGLIGIBLE
from rmpc_bench.analysis.traces import MAX_GROUPS
from rmpc_bench.claims import grammar
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.values import EvaluationError, NoValue, Value
from rmpc_bench.expressions.arithmetic import Call, Negation, Node, Operand, Operation, Percent
from rmpc_bench.types import Array

UNBOUNDED: Interval = (-math.inf, math.inf)
ORDER = ("median", "quantile", "min", "max")
_FEW_HITS = 10
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
            return UNBOUNDED
        return float(ratios.min()), float(ratios.max())


def level_spread(
    link: grammar.Link, evaluator: Evaluator, confidence: float, times: float = 1.0
) -> CornerSpread | None:
    """Spread of sides made of one estimate and numbers, with `times` as many runs; None for any other comparison."""
    found = estimates(link, evaluator)
    if len(found) != 1 or not _is_arithmetic(link, evaluator):
        return None
    return at_ends(link, evaluator, {found[0]: _ends(found[0], evaluator, confidence, times)})


def unseen(link: grammar.Link, evaluator: Evaluator, confidence: float) -> dict[Node, Ends]:
    """Ends of the estimates that no resample of the runs can show: beyond the largest run, or of a rare event.

    The difference of two shares has an interval that knows rare events, unless they did not occur.
    """
    found: dict[Node, Ends] = {}
    of_shares = all(isinstance(side, Call) for side in (link.left, link.right))
    for call in estimates(link, evaluator):
        if not isinstance(call, Call) or call.function == "ratio":
            continue
        value = evaluator.value(call).array
        low, high = _ends(call, evaluator, confidence)
        if call.function in ORDER:
            low, high = (np.where(np.isinf(end), end, value) for end in (low, high))
        elif _FEW_HITS <= len(evaluator.runs) * min(value, 1 - value) or (of_shares and 0 < value < 1):
            continue
        if (low != value).any() or (high != value).any():
            found[call] = (low, high)
    return found


def at_ends(link: grammar.Link, evaluator: Evaluator, ends: Mapping[Node, Ends]) -> CornerSpread | None:
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


def estimates(node: Node, evaluator: Evaluator) -> list[Call | Operation]:
    """Collect what estimates a share, quantile, extreme or average ratio over the runs: the outermost such parts."""
    if isinstance(node, Call | Operation) and _is_estimate(node, evaluator):
        return [node]
    return [found for child in grammar.children(node) for found in estimates(child, evaluator)]


def _is_estimate(node: Call | Operation, evaluator: Evaluator) -> bool:
    if grammar.terms(node).isdisjoint(evaluator.columns):
        return False
    if isinstance(node, Operation):
        return _quotient(node, evaluator) is not None
    first = node.arguments[0]
    if isinstance(first, grammar.Chain):
        return evaluator.holds(first.links).axis == "runs"
    try:
        values = [evaluator.value(argument) for argument in node.arguments]
    except EvaluationError:
        return False  # Such as a signal, whose moments alone are known.
    if node.function == "ratio":
        of_columns = all(value.axis == "runs" and evaluator.by_run(value.array) is not None for value in values)
        return of_columns or _quotient(node, evaluator) is not None
    if node.function == "mean":
        # Zeros and ones say whether something happened: their mean is a share.
        return values[0].axis == "runs" and values[0].array.ndim == 1 and is_binary(values[0].array)
    return node.function in ORDER and values[0].axis == "runs"


def is_binary(column: Array) -> bool:
    """Whether a column has zeros and ones only, and both: zeros alone may be those of any quantity."""
    return set(np.unique(column)) == {0.0, 1.0}


def _quotient(node: Call | Operation, evaluator: Evaluator) -> tuple[Array, Array] | None:
    """Columns over the runs whose means are divided; None for any other part, and for shares."""
    if isinstance(node, Call):
        above, below = node.arguments
    else:
        of_runs = [each for each in node.rest if not grammar.terms(each.node).isdisjoint(evaluator.columns)]
        divisors = [each for each in of_runs if each.operator == "/"]
        others = tuple(each for each in node.rest if each not in divisors)
        if len(divisors) != 1:
            return None
        above, below = Operation(node.first, others) if others else node.first, divisors[0].node
    a, b = (column(part, evaluator) for part in (above, below))
    if a is None or b is None or not b.ndim or not all(np.isfinite(part).all() for part in (a, b)):
        return None
    return None if is_binary(b) or (a.ndim and is_binary(a)) else (np.broadcast_to(a, b.shape), b)


def _is_arithmetic(node: Node, evaluator: Evaluator) -> bool:
    """Whether columns enter by estimates of whole columns and the four operations only, so that ends give ends."""
    if grammar.terms(node).isdisjoint(evaluator.columns):
        return True
    if isinstance(node, Call | Operation) and _is_estimate(node, evaluator):
        if not isinstance(node, Call) or (node.function == "ratio" and _quotient(node, evaluator)):
            return True
        inner = [call for argument in node.arguments for call in grammar.calls(argument)]
        of_runs = [call for call in inner if not grammar.terms(call).isdisjoint(evaluator.columns)]
        return all(evaluator.value(call).axis == "runs" for call in of_runs)
    known = isinstance(node, grammar.Link | Operation | Operand | Negation | Percent)
    known = known or (isinstance(node, Call) and node.function == "ratio")
    return known and all(_is_arithmetic(child, evaluator) for child in grammar.children(node))


def _divisors(link: grammar.Link, evaluator: Evaluator) -> list[Node]:
    """Collect the divisors that depend on the runs, outside of columns."""
    found = [each.node for each in grammar.walk(link) if isinstance(each, Operand) and each.operator == "/"]
    found += [call.arguments[1] for call in grammar.calls(link) if call.function == "ratio"]
    found = [node for node in found if not grammar.terms(node).isdisjoint(evaluator.columns)]
    return [node for node in found if not evaluator.value(node).array.ndim]


def _ends(node: Call | Operation, evaluator: Evaluator, confidence: float, times: float = 1.0) -> Ends:
    """Interval of an estimate; runs that are pooled over points count once, as if all points of a run were alike."""
    value = evaluator.value(node).array
    if not isinstance(node, Call) or node.function == "ratio":
        return _ends_of_ratio(node, value, evaluator, confidence, times)
    first, *others = node.arguments
    n = max(round(len(evaluator.runs) * times), 1)
    if node.function in ("share", "mean"):
        near, exact = (law(float(value) * n, n, confidence) for law in (wilson, exact_share))
        return np.array(min(near[0], exact[0])), np.array(max(near[1], exact[1]))
    q = {"min": 0.0, "median": 0.5, "max": 1.0}.get(node.function)
    ordered = np.sort(evaluator.value(first).array, axis=0)
    low, high = order_ranks(n, float(evaluator.value(others[0]).array) if q is None else q, confidence)
    share = len(ordered) / n
    # With another number of runs the law of a run is the one seen.
    below = ordered[math.ceil(low * share) - 1] if low >= 1 else np.full(value.shape, -np.inf)
    above = ordered[math.ceil(high * share) - 1] if high <= n else np.full(value.shape, np.inf)
    return np.minimum(below, value), np.maximum(above, value)


def _ends_of_ratio(node: Call | Operation, value: Array, evaluator: Evaluator, confidence: float, times: float) -> Ends:
    parts = _quotient(node, evaluator)
    if parts is not None:
        low, high = UNBOUNDED if hides_values(*parts) else ratio_interval(*parts, confidence, evaluator.trials.seed)
    else:
        assert isinstance(node, Call)
        a, b = (np.log(evaluator.value(argument).array) for argument in node.arguments)
        logs, value = evaluator.by_run(a - b), np.log(value)
        assert logs is not None
        low, high = average_interval(logs, confidence, evaluator.trials.seed, scale=1.0)
    ends = [value + (np.asarray(end) - value) / math.sqrt(times) for end in (low, high)]
    return (ends[0], ends[1]) if parts is not None else (np.exp(ends[0]), np.exp(ends[1]))


def ratio_interval(a: Array, b: Array, confidence: float, seed: int) -> Interval:
    """Fieller interval of mean(a) / mean(b), as much longer as that of the mean of a - c b is where it is skewed."""
    low, high = fieller(a, b, confidence)
    centre = float(b.mean())
    if not (np.isfinite([low, high]).all() and centre):
        return low, high
    gaps = a - float(a.mean()) / centre * b
    plain, longer = student(gaps, confidence), mean_interval(gaps, confidence, seed)
    more = sorted((end - other) / centre for end, other in zip(longer, plain, strict=True))
    return low + more[0], high + more[1]


def hides_values(left: Array, right: Array) -> bool:
    """Whether a side, their difference or their ratio has one value in most runs and others in fewer than `FEW`.

    The rest of its law, which so few runs show, may be anything.  Fewer than `FEW` zeros beside ones are no rest.
    """
    scale = float(max(np.abs(left).max(), np.abs(right).max()))
    parts = [(side, scale) for side in (left, right) if side.ndim and not is_binary(side)]
    if left.ndim and right.ndim:
        parts.append((left - right, scale))
        if right.all():
            parts.append((left / right, float(np.abs(left / right).max())))
    return any(_has_few_others(_sizes_of_values(part, scale)) for part, scale in parts)


def _sizes_of_values(values: Array, scale: float) -> Array:
    """Count how often every value occurs, up to the rounding of numbers of the size `scale`; in ascending order."""
    ordered = np.sort(values)
    steps = np.flatnonzero(np.diff(ordered) > NEGLIGIBLE * scale) + 1
    return np.diff(np.r_[0, steps, len(ordered)])


def _has_few_others(sizes: Array) -> bool:
    """Whether one value is that of most runs, and fewer than `FEW` have another."""
    n, most = int(sizes.sum()), int(sizes.max())
    return n < 2 * most and n - most < FEW


def average_interval(
    values: Array, confidence: float, seed: int, *, scale: float = 0.0, hidden: bool | None = False
) -> Interval:
    """Interval of a mean that knows what few values hide.

    Two values, neither of them 0, that occur at least twice each have the exact interval of a share.  One value in most
    runs beside few others says nothing of the spread, nor do `hidden` values; None if these are bounded.  Numbers of
    the size `scale` were subtracted.
    """
    if hidden is not None and np.isfinite(values).all():
        scale = max(scale, float(np.abs(values).max()))
        sizes = _sizes_of_values(values, scale)
        least, most = float(values.min()), float(values.max())
        if len(sizes) == 2 and sizes.min() > 1 and min(abs(least), abs(most)) > NEGLIGIBLE * scale:
            low, high = exact_share(int(sizes[1]), len(values), confidence)
            return least + (most - least) * low, least + (most - least) * high
        if hidden or _has_few_others(sizes):
            return UNBOUNDED
    return mean_interval(values, confidence, seed)


def column(node: Node, evaluator: Evaluator) -> Array | None:
    """Array over the runs whose mean is the value of a node, or the number that it is; None where there is none."""
    if grammar.terms(node).isdisjoint(evaluator.columns):
        value = evaluator.value(node)
        return None if value.array.ndim else value.array
    if isinstance(node, Call) and node.function == "mean":
        value = evaluator.value(node.arguments[0])
        return evaluator.by_run(value.array) if value.axis == "runs" and value.array.ndim == 1 else None
    if isinstance(node, Call) and node.function == "share" and isinstance(node.arguments[0], grammar.Chain):
        value = evaluator.holds(node.arguments[0].links)
        return evaluator.by_run(value.array.astype(float)) if value.axis == "runs" else None
    if isinstance(node, Negation):
        inner = column(node.operand, evaluator)
        return None if inner is None else -inner
    return _combined(node, evaluator) if isinstance(node, Operation) else None


def _combined(node: Operation, evaluator: Evaluator) -> Array | None:
    """Sum of columns, or a column times or divided by numbers."""
    found = column(node.first, evaluator)
    for operand in node.rest:
        other = column(operand.node, evaluator)
        if found is None or other is None:
            return None
        if operand.operator in "+-":
            found = found + other if operand.operator == "+" else found - other
        elif other.ndim and (found.ndim or operand.operator == "/"):
            # Not linear in the means.
            return None
        else:
            with np.errstate(all="ignore"):
                found = found * other if operand.operator == "*" else found / other
    return found


class PseudoValues(NamedTuple):
    """Both sides of a comparison and its tolerance, axis 0 = group."""

    left: Array
    right: Array
    tolerance: Array


def pseudo_values(link: grammar.Link, evaluator: Evaluator) -> PseudoValues | None:
    """Compute both sides without every group of runs; None for fewer than two groups that can be left out."""
    groups = evaluator.groups
    if not evaluator.sampled:
        groups = np.array_split(evaluator.runs, min(len(evaluator.runs), MAX_GROUPS) or 1)
    if groups is None or len(groups) < 2:
        return None
    whole = evaluator.without(None, ()).side_arrays(link)
    parts = [evaluator.without(number, runs).side_arrays(link) for number, runs in enumerate(groups)]
    n = len(groups)
    stacked = [np.stack(column) for column in zip(*parts, strict=True)]
    with np.errstate(invalid="ignore"):  # A mean may be infinite.
        return PseudoValues(*(n * a - (n - 1) * without for a, without in zip(whole, stacked, strict=True)))
