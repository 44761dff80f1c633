"""One comparison of a claim: its two numbers, the interval of their difference, and whether it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rmpc_bench.analysis import claim_tree as tree
from rmpc_bench.analysis.claim_evaluation import Evaluator, compare
from rmpc_bench.analysis.intervals import Interval, difference, geometric, median_interval, student, wilson
from rmpc_bench.analysis.trials import Trials


@dataclass(frozen=True)
class Compared:
    """A comparison with its numbers.

    Parameters
    ----------
    text : as written in the check
    left, right : the two sides; of columns, series and matrices the entries that come closest to failing, or fail most
    holds : None when the interval of the difference contains 0, so that the runs do not tell
    interval : of left - right, None where there is none; its ends may be infinite
    n : runs that all methods of the comparison finished; 0 when it uses no runs
    left_out : runs that one of them failed
    """

    text: str
    left: float
    right: float
    holds: bool | None
    interval: Interval | None
    n: int
    left_out: int


def compared(statement: tree.Link | tree.Chain, trials: Trials) -> Compared:
    """Evaluate one comparison, or an ``all(...)`` as one.

    Parameters
    ----------
    statement : a link of a chain, or a chain that is `everywhere`
    trials : the table of trials

    Returns
    -------
    its numbers

    Raises
    ------
    EvaluationError
        when the stored results have no answer
    """
    evaluator = Evaluator(trials, statement)
    if isinstance(statement, tree.Link):
        return _compared(statement, evaluator, statement.text)
    parts = [_compared(link, evaluator, statement.text) for link in statement.links]
    return next((part for part in parts if not part.holds), parts[0])


def _compared(link: tree.Link, evaluator: Evaluator, text: str) -> Compared:
    left, right, tolerance, _ = evaluator.sides(link)
    held = bool(compare(link.operator, left, right, tolerance).all())
    gap = difference(left, right)
    far = {"<": gap, "<=": gap, ">": -gap, ">=": -gap, "==": np.abs(gap), "~": difference(np.abs(gap), tolerance)}[
        link.operator
    ]
    worst = np.unravel_index(int(np.argmax(far)), far.shape)
    interval = _interval(link, evaluator) if not gap.ndim else None
    holds = held if interval is None else _decided(link.operator, held, interval)
    return Compared(
        text, float(left[worst]), float(right[worst]), holds, interval, evaluator.n, evaluator.left_out
    )  # fmt: skip


def _decided(operator: str, held: bool, interval: Interval) -> bool | None:
    """Three-valued truth: an order holds, or fails, only when the whole interval lies on that side of 0."""
    low, high = interval
    if operator in ("==", "~"):
        return True if held else (None if low <= 0 <= high else False)
    if operator in (">", ">="):
        low, high = -high, -low
    strict = operator in ("<", ">")
    below = high < 0 or (high == 0 and not strict)
    above = low > 0 or (low == 0 and strict)
    if held and below:
        return True
    return False if above and not held else None


def _interval(link: tree.Link, evaluator: Evaluator) -> Interval | None:
    """Interval of left - right, where the two sides have one; a single run has none, its two numbers decide."""
    if evaluator.n < 2:
        return None
    found = _paired(link.left, link.right, evaluator) or _against_level(link.left, link.right, evaluator)
    if found is None:
        found = _against_level(link.right, link.left, evaluator)
        found = found and (-found[1], -found[0])
    return found


def _paired(left: tree.Expression, right: tree.Expression, evaluator: Evaluator) -> Interval | None:
    """Interval between the mean, or the median, of one metric of two methods."""
    if not (isinstance(left, tree.Call) and isinstance(right, tree.Call) and left.function == right.function):
        return None
    (a, *_), (b, *_) = left.arguments, right.arguments
    if not (isinstance(a, tree.Term) and isinstance(b, tree.Term) and a.quantity == b.quantity):
        return None
    first, second = evaluator.column(a), evaluator.column(b)
    if first is None or second is None:
        return None
    confidence, gap = evaluator.trials.confidence, difference(first, second)
    if left.function == "median":
        return median_interval(gap, confidence)
    if left.function == "mean" and np.isfinite(first).all() and np.isfinite(second).all():
        return student(gap, confidence)
    return None


def _against_level(estimate: tree.Expression, level: tree.Expression, evaluator: Evaluator) -> Interval | None:
    """Interval of a share, or of a ratio, minus a fixed level."""
    if not isinstance(estimate, tree.Call) or tree.terms(level):
        return None
    fixed, confidence = evaluator.number(level), evaluator.trials.confidence
    (a, *_), low, high = estimate.arguments, math.nan, math.nan
    if isinstance(a, tree.Chain):
        holds = evaluator.holds(a.links)
        # Against 0 or 1 the statement is about the runs at hand, every or none of them, and nothing is estimated.
        if holds.axis == "runs" and 0 < fixed < 1:
            low, high = wilson(int(holds.array.sum()), len(holds.array), confidence)
    elif estimate.function == "ratio":
        b = estimate.arguments[1]
        if isinstance(a, tree.Term) and isinstance(b, tree.Term):
            first, second = evaluator.column(a), evaluator.column(b)
            if first is not None and second is not None:
                low, high = geometric(first, second, confidence)[1]
    return None if math.isnan(low) else (low - fixed, high - fixed)
