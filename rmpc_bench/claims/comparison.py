"""One comparison of a claim: its two numbers, the interval of their difference, and whether it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rmpc_bench.analysis.intervals import Interval, difference, geometric, quantile, student, wilson
from rmpc_bench.claims import tree
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.values import Value, compare
from rmpc_bench.expressions.arithmetic import Call, Node
from rmpc_bench.types import Array

_RESAMPLES = 1000
_FEWEST = 10  # runs below which resampling says nothing
_ALIKE = 1e-12  # relative; sides that are closer cannot be told apart in what is written of them


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
    operator : of the comparison
    k, entry : where in a series, vector or matrix the shown entries stand; None where there is no such place
    entries : how many were compared
    equal : how many of those that hold were passed over for the shown one, because their sides are equal up to rounding
    """

    text: str
    left: float
    right: float
    holds: bool | None
    interval: Interval | None
    n: int
    left_out: int
    at: str = ""
    operator: str = ""
    k: int | None = None
    entry: tuple[int, ...] | None = None
    entries: int = 1
    equal: int = 0


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
    value, right, tolerance = evaluator.sides(link)
    left = value.array
    held = bool(compare(link.operator, left, right, tolerance).all())
    gap = difference(left, right)
    far = {"<": gap, "<=": gap, ">": -gap, ">=": -gap, "==": np.abs(gap), "~": difference(np.abs(gap), tolerance)}[
        link.operator
    ]
    alike = _alike(link, left, right) if held else np.zeros(gap.shape, dtype=bool)
    candidates = np.flatnonzero(~alike) if not alike.all() else np.arange(gap.size)
    worst = np.unravel_index(candidates[np.argmax(far.reshape(-1)[candidates])], far.shape)
    interval = _interval(link, evaluator) if not gap.ndim else None
    k, entry = _place(value, tuple(int(i) for i in worst))
    return Compared(
        text=text,
        left=float(left[worst]),
        right=float(right[worst]),
        holds=held if interval is None else _decided(link.operator, held, interval),
        interval=interval,
        n=evaluator.n,
        left_out=evaluator.left_out,
        operator=link.operator,
        k=k,
        entry=entry,
        entries=gap.size,
        equal=int(alike.sum()) if gap.ndim else 0,
    )


def _alike(link: tree.Link, left: Array, right: Array) -> Array:
    """Which entries to pass over: those that are equal up to rounding, as a bound may start, or all of them."""
    alike = np.asarray(np.isclose(left, right, rtol=_ALIKE, atol=0.0))
    says_nothing = link.operator in ("<=", ">=") or (link.operator in ("~", "==") and alike.all())
    return alike if says_nothing else np.zeros_like(alike)


def _place(value: Value, index: tuple[int, ...]) -> tuple[int | None, tuple[int, ...] | None]:
    """Sample and entry of a place in an array; no sample where all are the same one, or for runs."""
    entry = index[1:] if value.axis else index
    changes = value.axis == "k" and not value.constant
    return value.span[0] + index[0] if changes else None, entry or None


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
    names = tree.functions(link)
    sides = [side for side in (link.left, link.right) if not tree.terms(side)]
    every_or_none = "share" in names and any(evaluator.number(side) in (0.0, 1.0) for side in sides)
    extreme = any(  # of runs; that of a series is a number like others
        call.function in ("min", "max") and not tree.terms(call).isdisjoint(evaluator.columns)
        for call in tree.calls(link)
    )
    return not evaluator.columns or every_or_none or extreme or "n_failed" in names


def _of_means(link: tree.Link, evaluator: Evaluator) -> Interval | None:
    """Student interval of the difference of two means of one metric, paired, or of a mean and a level."""
    columns = [_mean_of(side, evaluator) for side in (link.left, link.right)]
    if columns[0] is None or columns[1] is None:
        return None
    gap = difference(columns[0], columns[1])
    return student(gap, evaluator.trials.confidence) if gap.ndim and np.isfinite(gap).all() else None


def _mean_of(side: Node, evaluator: Evaluator) -> Array | None:
    """The column whose mean a side is, or the number that it is."""
    if not tree.terms(side):
        return np.array(evaluator.number(side))
    if isinstance(side, Call) and side.function == "mean" and isinstance(side.arguments[0], tree.Term):
        return evaluator.column(side.arguments[0])
    return None


def _bootstrap(link: tree.Link, evaluator: Evaluator) -> Interval | None:
    """Percentile interval of left - right over resampled runs, whole rows, so that pairs stay pairs."""
    if len(evaluator.runs) < _FEWEST:
        return -math.inf, math.inf
    rng, confidence = np.random.default_rng(evaluator.trials.seed), evaluator.trials.confidence
    gaps = []
    for _ in range(_RESAMPLES):
        left, right, _ = evaluator.resampled(rng).sides(link)
        gaps.append(float(difference(left.array, right)))
    low, high = (float(quantile(np.array(gaps), p)) for p in ((1 - confidence) / 2, (1 + confidence) / 2))
    return low, high


def _against_level(estimate: Node, level: Node, evaluator: Evaluator) -> Interval | None:
    """Interval of a share (Wilson), or of a ratio (Student on the logs), minus a fixed level."""
    if not isinstance(estimate, Call) or tree.terms(level):
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
