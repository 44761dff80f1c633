"""One comparison of a claim: its two numbers, the interval of their difference, and whether it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rmpc_bench.analysis import claim_tree as tree
from rmpc_bench.analysis.claim_evaluation import Evaluator, compare
from rmpc_bench.analysis.intervals import Interval, difference, geometric, quantile, student, wilson
from rmpc_bench.types import Array

_RESAMPLES = 1000
_FEWEST = 10  # runs below which resampling says nothing


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
    left_out : runs that one of them failed or has not computed
    at : the point of a sweep in words, where the claim is made at several
    """

    text: str
    left: float
    right: float
    holds: bool | None
    interval: Interval | None
    n: int
    left_out: int
    at: str = ""


def compared(statement: tree.Link | tree.Chain, evaluator: Evaluator) -> Compared:
    """Evaluate one comparison, or an ``all(...)`` as one.

    Parameters
    ----------
    statement : a link of a chain, or a chain that is `everywhere`
    evaluator : made for the statement

    Returns
    -------
    its numbers

    Raises
    ------
    EvaluationError
        when the stored results have no answer
    """
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
    """Interval of left - right: by its formula where there is one, else by resampling the runs."""
    if len(evaluator.runs) < 2 or _about_these_runs(link, evaluator):
        return None  # a single run, or the runs at hand as they are: the two numbers decide
    if evaluator.pooled:
        return _bootstrap(link, evaluator)
    found = _of_means(link, evaluator) or _against_level(link.left, link.right, evaluator)
    if found is None:
        found = _against_level(link.right, link.left, evaluator)
        found = (-found[1], -found[0]) if found is not None else _bootstrap(link, evaluator)
    return found


def _about_these_runs(link: tree.Link, evaluator: Evaluator) -> bool:
    """Whether nothing is estimated: no run enters, an extreme or a count does, or a share is every run or none."""
    calls = tree.functions(link)
    sides = [side for side in (link.left, link.right) if not tree.terms(side)]
    every_or_none = "share" in calls and any(evaluator.number(side) in (0.0, 1.0) for side in sides)
    return not evaluator.columns or every_or_none or bool(calls & {"min", "max", "n_failed"})


def _of_means(link: tree.Link, evaluator: Evaluator) -> Interval | None:
    """Student interval of the difference of two means of one metric, paired, or of a mean and a level."""
    columns = [_mean_of(side, evaluator) for side in (link.left, link.right)]
    if columns[0] is None or columns[1] is None:
        return None
    gap = difference(columns[0], columns[1])
    return student(gap, evaluator.trials.confidence) if gap.ndim and np.isfinite(gap).all() else None


def _mean_of(side: tree.Expression, evaluator: Evaluator) -> Array | None:
    """The column whose mean a side is, or the number that it is."""
    if not tree.terms(side):
        return np.array(evaluator.number(side))
    if isinstance(side, tree.Call) and side.function == "mean" and isinstance(side.arguments[0], tree.Term):
        return evaluator.column(side.arguments[0])
    return None


def _bootstrap(link: tree.Link, evaluator: Evaluator) -> Interval | None:
    """Percentile interval of left - right over resampled runs, whole rows, so that pairs stay pairs."""
    if len(evaluator.runs) < _FEWEST:
        return -math.inf, math.inf
    rng, confidence = np.random.default_rng(evaluator.trials.seed), evaluator.trials.confidence
    gaps = []
    for _ in range(_RESAMPLES):
        left, right, *_ = evaluator.resampled(rng).sides(link)
        gaps.append(float(difference(left, right)))
    low, high = (float(quantile(np.array(gaps), p)) for p in ((1 - confidence) / 2, (1 + confidence) / 2))
    return low, high


def _against_level(estimate: tree.Expression, level: tree.Expression, evaluator: Evaluator) -> Interval | None:
    """Interval of a share (Wilson), or of a ratio (Student on the logs), minus a fixed level."""
    if not isinstance(estimate, tree.Call) or tree.terms(level):
        return None
    fixed, confidence = evaluator.number(level), evaluator.trials.confidence
    (a, *_), low, high = estimate.arguments, math.nan, math.nan
    if isinstance(a, tree.Chain):
        holds = evaluator.holds(a.links)
        if holds.axis == "runs":
            low, high = wilson(int(holds.array.sum()), len(holds.array), confidence)
    elif estimate.function == "ratio":
        b = estimate.arguments[1]
        if isinstance(a, tree.Term) and isinstance(b, tree.Term):
            first, second = evaluator.column(a), evaluator.column(b)
            if first is not None and second is not None:
                low, high = geometric(first, second, confidence)[1]
    return None if math.isnan(low) else (low - fixed, high - fixed)
