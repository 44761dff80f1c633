"""One comparison of a claim: its two numbers, the interval of their difference, and whether it holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rmpc_bench.analysis.intervals import Interval, difference, geometric, quantile, student, wilson
from rmpc_bench.analysis.rounding import NEGLIGIBLE, negligible, without_noise
from rmpc_bench.claims import magnitudes, tree
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.values import Value, compare
from rmpc_bench.expressions.arithmetic import Call, Node
from rmpc_bench.types import Array

_RESAMPLES = 1000
_MIN_RUNS = 10
"""Runs below which resampling gives no interval."""


@dataclass(frozen=True)
class ComparisonResult:
    """A comparison with its numbers.

    Parameters
    ----------
    text : as written in the check
    left, right : the two sides; of columns, series and matrices the entries with the smallest margin, or with the
        largest violation
    scales : magnitudes of the numbers that the two sides were computed from; 0 for a number that the check gives
    holds : None when the interval of the difference contains 0, so that the runs do not decide
    interval : of left - right, None where there is none; its ends may be infinite
    n : runs that all methods of the comparison finished; 0 when it uses no runs
    n_excluded : runs that one of them failed or has not computed
    at : the point of a sweep in words, where the claim is checked at several
    operator : of the comparison
    k, entry : where in a series, vector or matrix the given entries stand; None where there is no such place
    n_entries : how many were compared
    n_equal : how many of those that hold were not considered for `left` and `right`, because their sides are equal up
        to rounding
    """

    text: str
    left: float
    right: float
    holds: bool | None
    interval: Interval | None
    n: int
    n_excluded: int
    at: str = ""
    operator: str = ""
    k: int | None = None
    entry: tuple[int, ...] | None = None
    n_entries: int = 1
    n_equal: int = 0
    scales: tuple[float, float] = (0.0, 0.0)

    def rounded(self) -> ComparisonResult:
        """Return the comparison with the digits that another CPU reproduces, for what is written."""
        left = _settled(self.left, self.scales[0], self.right)
        right = _settled(self.right, self.scales[1], self.left)
        if self.interval is None:
            return replace(self, left=left, right=right)
        low, high = (without_noise(end, sum(self.scales)) for end in self.interval)
        return replace(self, left=left, right=right, interval=(low, high))


def _settled(value: float, scale: float, other: float) -> float:
    """Write 0 for a result that is nothing but rounding; a number that the check itself gives stays."""
    if scale > 0 and negligible(value, abs(other)):
        return 0.0
    return without_noise(value, scale)


def compared(statement: tree.Link | tree.Chain, evaluator: Evaluator) -> ComparisonResult:
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


def _compared(link: tree.Link, evaluator: Evaluator, text: str) -> ComparisonResult:
    value, right_sides, tolerance = evaluator.sides(link)
    held = bool(compare(link.operator, value.array, right_sides, tolerance).all())
    sizes = magnitudes.of_sides(link, evaluator, value)
    left, right = _without_noise((value.array, right_sides), sizes)
    alike = _alike(link, left, right) if held else np.zeros(left.shape, dtype=bool)
    place = _decisive(_violation(link.operator, left, right, tolerance), alike, sizes)
    interval = _interval(link, evaluator) if not left.ndim else None
    k, entry = _place(value, place)
    return ComparisonResult(
        text=text,
        left=float(value.array[place]),
        right=float(right_sides[place]),
        scales=(float(sizes[0][place]), float(sizes[1][place])),
        holds=held if interval is None else _decided(link.operator, held, interval),
        interval=interval,
        n=evaluator.n,
        n_excluded=evaluator.n_excluded,
        operator=link.operator,
        k=k,
        entry=entry,
        n_entries=left.size,
        n_equal=int(alike.sum()) if left.ndim else 0,
    )


def _without_noise(sides: tuple[Array, Array], sizes: tuple[Array, Array]) -> list[Array]:
    """Replace what is nothing but rounding by 0, beside the numbers it comes from and beside the other side."""
    found = []
    for side, other, size in zip(sides, sides[::-1], sizes, strict=True):
        scale = np.fmax(np.where(np.isfinite(size), size, 0.0), np.where(np.isfinite(other), np.abs(other), 0.0))
        found.append(np.where((np.abs(side) < NEGLIGIBLE * scale) & (size > 0), 0.0, side))
    return found


def _violation(operator: str, left: Array, right: Array, tolerance: Array) -> Array:
    """How far each entry is from holding: negative where it holds with a margin."""
    gap = difference(left, right)
    if operator in ("<", "<="):
        return gap
    if operator in (">", ">="):
        return -gap
    return difference(np.abs(gap), tolerance) if operator == "~" else np.abs(gap)


def _decisive(violation: Array, ignored: Array, sizes: tuple[Array, Array]) -> tuple[int, ...]:
    """Place of the entry that comes closest to failing, or fails most.

    Of several that differ by rounding only it is the first, so that another CPU finds the same one.
    """
    violation, shape = violation.reshape(-1), violation.shape
    candidates = np.flatnonzero(~ignored) if not ignored.all() else np.arange(violation.size)
    size = (sizes[0] + sizes[1]).reshape(-1)
    noise = NEGLIGIBLE * np.where(np.isfinite(size), size, 0.0)
    worst = candidates[np.argmax(violation[candidates])]
    ties = violation[candidates] >= violation[worst] - np.maximum(noise[candidates], noise[worst])
    return tuple(int(i) for i in np.unravel_index(candidates[np.argmax(ties)], shape))


def _alike(link: tree.Link, left: Array, right: Array) -> Array:
    """Which entries decide nothing: sides equal up to rounding, as at the start of a bound, or all entries."""
    alike = np.asarray(np.isclose(left, right, rtol=NEGLIGIBLE, atol=0.0))
    decides_nothing = link.operator in ("<=", ">=") or (link.operator in ("~", "==") and alike.all())
    return alike if decides_nothing else np.zeros_like(alike)


def _place(value: Value, index: tuple[int, ...]) -> tuple[int | None, tuple[int, ...] | None]:
    """Sample and entry of a place in an array; no sample where all are the same one, or for runs."""
    entry = index[1:] if value.axis else index
    changes = value.axis == "k" and not value.constant
    return value.span[0] + index[0] if changes else None, entry or None


def _decided(operator: str, held: bool, interval: Interval) -> bool | None:
    """Decide by the interval: an order holds, or fails, only when the whole interval lies on that side of 0."""
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
        # A single run, or a statement about the runs at hand: the two numbers decide.
        return None
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
    if len(evaluator.runs) < _MIN_RUNS:
        return -math.inf, math.inf
    rng, confidence = np.random.Generator(np.random.PCG64(evaluator.trials.seed)), evaluator.trials.confidence
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
