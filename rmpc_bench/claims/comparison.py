"""One comparison of a claim on the trials: both sides, whether it holds, how certain that is, and up to which rounding.

The difference of two numbers near 30 is known to about 1e-15 only: a difference of 6e-15 is 0 up to rounding, although
6e-15 is far above the smallest float.  The magnitude of ``a - b`` is therefore ``|a| + |b|``; of a product it is the
product, of a determinant the sum of its terms, and functions that are linear or that pick entries keep it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rmpc_bench.analysis.intervals import Interval, difference
from rmpc_bench.analysis.rounding import NEGLIGIBLE, negligible, without_noise
from rmpc_bench.claims import decision, grammar
from rmpc_bench.claims.decision import Change, entry_by_entry
from rmpc_bench.claims.estimates import CornerSpread
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.spread import Spread, spread_of
from rmpc_bench.claims.values import EvaluationError, Value, aligned, applied, combine, compare, listed
from rmpc_bench.expressions.arithmetic import Call, Negation, Node, Operation, Percent
from rmpc_bench.types import Array

_EXACT = Value(np.array(0.0))
_KEEPING = "abs last at since upto entry diag trace mean median min max quantile".split()


@dataclass(frozen=True)
class ComparisonResult:
    """A comparison with its numbers.

    Parameters
    ----------
    text : as written in the check
    left, right : the two sides; of columns, series and matrices the entries with the smallest margin, or with the
        largest violation
    scales : magnitudes of the numbers that the two sides were computed from; 0 for a number that the check gives
    holds : None when the interval of the difference contains the border, so that the runs do not decide
    interval : of left - right, None where there is none; its ends may be infinite
    n : runs that all methods of the comparison finished; 0 when it uses no runs
    n_excluded : runs that one of them failed
    at : the point of a sweep in words, where the claim is checked at several
    operator : of the comparison
    k, entry : where in a series, vector or matrix the given entries stand; None where there is no such place
    n_entries : how many were compared
    n_equal : how many of those that hold were not considered for `left` and `right`, because their sides are equal up
        to rounding
    change : where the outcome changes if a threshold, factor or margin of the check does; None where it has none
    n_deciding : about how many runs would decide, if the numbers stay as they are; None where that is not known
    exceptions : largest share of exceptions among all runs that fits a statement about every run, which holds in these
    below_margin : the margin of relevance in words, where the comparison holds and its whole interval is below that
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
    change: Change | None = None
    n_deciding: int | None = None
    exceptions: float | None = None
    below_margin: str = ""

    def rounded(self) -> ComparisonResult:
        """Return the comparison with the digits that another CPU reproduces, for what is written."""
        left = _settled(self.left, self.scales[0], self.right)
        right = _settled(self.right, self.scales[1], self.left)
        change = None if self.change is None else self.change.rounded(sum(self.scales))
        if self.interval is None:
            return replace(self, left=left, right=right, change=change)
        low, high = (without_noise(end, sum(self.scales)) for end in self.interval)
        return replace(self, left=left, right=right, interval=(low, high), change=change)


def _settled(value: float, scale: float, other: float) -> float:
    """Write 0 for a result that is nothing but rounding; a number that the check itself gives stays."""
    if scale > 0 and negligible(value, abs(other)):
        return 0.0
    return without_noise(value, scale)


def compared(statement: grammar.Link | grammar.Chain, evaluator: Evaluator, confidence: float) -> ComparisonResult:
    """Evaluate a link, or an ``all(...)`` as one; raises EvaluationError where the stored results have no answer."""
    if isinstance(statement, grammar.Link):
        return _compared(statement, evaluator, statement.text, confidence)
    parts = [_compared(link, evaluator, statement.text, confidence) for link in statement.links]
    # The part that decides: one that fails, else one that is inconclusive.
    order = {False: 0, None: 1, True: 2}
    return min(parts, key=lambda part: order[part.holds])


def _compared(link: grammar.Link, evaluator: Evaluator, text: str, confidence: float) -> ComparisonResult:
    value, right_sides, tolerance = evaluator.sides(link)
    held = bool(compare(link.operator, value.array, right_sides, tolerance).all())
    sizes = _magnitudes_of_sides(link, evaluator, value)
    left, right = _without_noise((value.array, right_sides), sizes)
    alike = _alike(link, left, right) if held else np.zeros(left.shape, dtype=bool)
    place = _decisive(_violation(link.operator, left, right, tolerance), alike, sizes)
    spread: Spread | None
    if left.ndim:
        spread, place = entry_by_entry(link, evaluator, confidence, place, about_runs=value.axis == "runs")
    else:
        spread = spread_of(link, evaluator, confidence)
    interval = None if spread is None else spread.gap()
    k, entry = _place(value, place)
    holds = held if spread is None else decision.decided(link.operator, spread)
    # Runs can contradict an equality.  They prove it of what is known exactly, and of equal columns that are no counts.
    if link.operator == "==" and holds and spread is not None and link.left != link.right:
        holds = True if evaluator.sampled or isinstance(spread, CornerSpread) else None
    # A statement about every run is refuted by one of them, and never proved by some.
    if value.axis == "runs" and evaluator.is_estimated(link) and (held or len(evaluator.runs) < 2):
        holds = None
    inconclusive = spread is not None and holds is None
    open_or_exact = held and (holds is None or spread is None)
    estimate = (float(value.array[place]), float(right_sides[place]), float(tolerance[place]))
    return ComparisonResult(
        text=text,
        left=float(value.array[place]),
        right=float(right_sides[place]),
        scales=(float(sizes[0][place]), float(sizes[1][place])),
        holds=holds,
        interval=interval,
        n=evaluator.n,
        n_excluded=evaluator.n_excluded,
        operator=link.operator,
        k=k,
        entry=entry,
        n_entries=left.size,
        n_equal=int(alike.sum()) if left.ndim else 0,
        change=decision.change(link, evaluator, spread) if spread is None or not left.ndim else None,
        n_deciding=decision.n_deciding(link, evaluator, spread, estimate, confidence) if inconclusive else None,
        exceptions=decision.exceptions(link, value, evaluator, confidence) if open_or_exact else None,
        below_margin=decision.below_margin(link, evaluator, spread) if holds else "",
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
    """Place of the entry that comes closest to failing, or fails most."""
    # Of several that differ by rounding only it is the first, so that another CPU finds the same one.
    violation, shape = violation.reshape(-1), violation.shape
    candidates = np.flatnonzero(~ignored) if not ignored.all() else np.arange(violation.size)
    size = (sizes[0] + sizes[1]).reshape(-1)
    noise = NEGLIGIBLE * np.where(np.isfinite(size), size, 0.0)
    worst = candidates[np.argmax(violation[candidates])]
    ties = violation[candidates] >= violation[worst] - np.maximum(noise[candidates], noise[worst])
    return tuple(int(i) for i in np.unravel_index(candidates[np.argmax(ties)], shape))


def _alike(link: grammar.Link, left: Array, right: Array) -> Array:
    """Which entries decide nothing: sides equal up to rounding, as at the start of a bound, or all entries."""
    alike = np.asarray(np.isclose(left, right, rtol=NEGLIGIBLE, atol=0.0))
    decides_nothing = link.operator in ("<=", ">=") or (link.operator in ("~", "==") and alike.all())
    return alike if decides_nothing else np.zeros_like(alike)


def _place(value: Value, index: tuple[int, ...]) -> tuple[int | None, tuple[int, ...] | None]:
    """Sample and entry of a place in an array; no sample where all are the same one, or for runs."""
    entry = index[1:] if value.axis else index
    changes = value.axis == "k" and not value.constant
    return value.span[0] + index[0] if changes else None, entry or None


def magnitude(node: Node, evaluator: Evaluator) -> Value:
    """Compute the magnitude of every entry of an expression, none below its absolute value."""
    value = evaluator.value(node)
    size = value.of(np.abs(value.array))
    found = _of_parts(node, evaluator)
    return size if found is None else combine(np.fmax, found, size)


def _magnitudes_of_sides(link: grammar.Link, evaluator: Evaluator, left: Value) -> tuple[Array, Array]:
    """Compute the magnitudes of both sides of a comparison, in the shape of `left`; 0 for a side without terms."""
    found = [magnitude(node, evaluator) if grammar.terms(node) else _EXACT for node in (link.left, link.right)]
    parts = aligned(*found, left)
    first, second = (np.broadcast_to(part.array, left.array.shape) for part in parts[:2])
    return first, second


def _of_parts(node: Node, evaluator: Evaluator) -> Value | None:
    """Magnitude that comes from the parts of an expression; None where only its value is known."""
    match node:
        case Negation():
            return magnitude(node.operand, evaluator)
        case Percent():
            return combine(np.divide, magnitude(node.operand, evaluator), Value(np.array(100.0)))
        case grammar.Listing():
            return listed([magnitude(item, evaluator) for item in node.items])
        case Operation():
            return _of_operation(node, evaluator)
        case Call(function="mean", arguments=(grammar.Term() as term,)) if evaluator.is_signal(term):
            return _of_mean(node, term, evaluator)
        case Call(function="det", arguments=(matrix,)):
            # The product of the row sums bounds all terms of the determinant together.
            found = magnitude(matrix, evaluator)
            return found.of(found.array.sum(axis=-1).prod(axis=-1)) if found.entry else found
        case Call() if node.function in _KEEPING:
            first, *others = node.arguments
            return applied(node.function, [magnitude(first, evaluator), *map(evaluator.value, others)])
    return None


def _of_operation(node: Operation, evaluator: Evaluator) -> Value:
    found = magnitude(node.first, evaluator)
    for operand in node.rest:
        if operand.operator == "/":
            divisor = evaluator.value(operand.node)
            found = combine(np.divide, found, divisor.of(np.abs(divisor.array)))
        else:
            function = np.multiply if operand.operator == "*" else np.add
            found = combine(function, found, magnitude(operand.node, evaluator))
    return found


def _of_mean(node: Call, term: grammar.Term, evaluator: Evaluator) -> Value | None:
    """Magnitude of the mean of a signal: its rounding error is that of the signal, hence of its spread, too."""
    try:
        deviation = evaluator.value(Call("std", (term,)))
    except EvaluationError:
        return None
    mean = evaluator.value(node)
    return combine(np.add, mean.of(np.abs(mean.array)), deviation)
