"""Uncertainty of the two sides of a comparison: intervals of their difference and of their ratio.

In the order of preference: by Student's t where both sides are linear in means over the runs, by the formula of a share
or a geometric mean beside a fixed number, and by a bootstrap of whole runs for everything else.  For moments over the
runs at every k groups of runs are left out one by one (`jackknife`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rmpc_bench.analysis.intervals import Interval, difference, fieller, geometric, quantile, student, wilson
from rmpc_bench.claims import tree
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.jackknife import pseudo_values
from rmpc_bench.expressions.arithmetic import Call, Negation, Node, Operation
from rmpc_bench.types import Array

_RESAMPLES = 1000
_IN_THE_TAIL = 25
"""Resamples beyond each end of an interval; at a high level there are more of them."""
MOST_DRAWN = 10_000
"""Largest number of runs of a resample, so that time does not grow with the number of runs."""
_TOGETHER = 1_000_000
"""Numbers of resamples that are sorted together; they take 16 MB."""
MIN_RUNS = 10
"""Runs below which resampling gives no interval."""
UNBOUNDED: Interval = (-math.inf, math.inf)


class Spread(Protocol):
    """Intervals of a comparison of `left` with `right`, at one level."""

    def gap(self, shift: int = 0) -> Interval:
        """Interval of left - right + shift * tolerance."""
        ...

    def ratio(self) -> Interval:
        """Interval of left / right."""
        ...


@dataclass(frozen=True, eq=False)
class StudentSpread:
    """Sides that are means over the runs: arrays over the runs, or numbers, whose means are the sides."""

    left: Array
    right: Array
    tolerance: Array
    confidence: float

    def gap(self, shift: int = 0) -> Interval:
        """Student interval of the paired differences."""
        return student(self.left - self.right + shift * self.tolerance, self.confidence)

    def ratio(self) -> Interval:
        """Fieller interval: it excludes a factor where the Student interval of left - factor * right excludes 0."""
        left, right = np.broadcast_arrays(self.left, self.right)
        return fieller(left, right, self.confidence)


@dataclass(frozen=True)
class LevelSpread:
    """One side with an interval of its own, the other a number."""

    left: Interval
    right: Interval
    tolerance: float

    def gap(self, shift: int = 0) -> Interval:
        """Shift the interval by the numbers."""
        moved = shift * self.tolerance if shift else 0.0
        return self.left[0] - self.right[1] + moved, self.left[1] - self.right[0] + moved

    def ratio(self) -> Interval:
        """Divide the ends; unbounded where the divisor reaches 0."""
        if min(self.right) <= 0 <= max(self.right):
            return UNBOUNDED
        ends = [a / b for a in self.left for b in self.right]
        return min(ends), max(ends)


@dataclass(frozen=True, eq=False)
class ResampledSpread:
    """Both sides and the tolerance, computed from runs that are drawn again."""

    left: Array
    right: Array
    tolerance: Array
    confidence: float

    def gap(self, shift: int = 0) -> Interval:
        """Percentile interval."""
        return self._percentiles(difference(self.left, self.right) + (shift * self.tolerance if shift else 0.0))

    def ratio(self) -> Interval:
        """Percentile interval; unbounded where a divisor reaches 0."""
        if not len(self.right) or self.right.min() <= 0 <= self.right.max():
            return UNBOUNDED
        with np.errstate(all="ignore"):
            ratios = self.left / self.right
        return UNBOUNDED if np.isnan(ratios).any() else self._percentiles(ratios)

    def _percentiles(self, values: Array) -> Interval:
        if not len(values):
            return UNBOUNDED
        tail = (1 - self.confidence) / 2
        return float(quantile(values, tail)), float(quantile(values, 1 - tail))


@dataclass(frozen=True)
class BandSpread:
    """An entry of a simultaneous band: shift -> interval."""

    gaps: Mapping[int, Interval]

    def gap(self, shift: int = 0) -> Interval:
        """Look up the interval."""
        return self.gaps[shift]

    def ratio(self) -> Interval:
        """Return no bounds: the band is one of differences."""
        return UNBOUNDED


UNKNOWN = BandSpread(dict.fromkeys((-1, 0, 1), UNBOUNDED))
"""No part of the runs can be left out, so that nothing is known of the error."""


def spread_of(link: tree.Link, evaluator: Evaluator, confidence: float) -> Spread | None:
    """Find how uncertain both sides of a comparison are.

    Parameters
    ----------
    link : a comparison of two numbers
    evaluator : made for it
    confidence : level of its intervals

    Returns
    -------
    the spread; None for a single run, or where the statement is about the runs at hand: then the two numbers decide
    """
    if evaluator.sampled:
        values = pseudo_values(link, evaluator)
        if values is None:
            return UNKNOWN
        return StudentSpread(values.left, values.right, values.tolerance, confidence)
    if len(evaluator.runs) < 2 or about_these_runs(link, evaluator):
        return None
    found: Spread | None = None
    if not evaluator.pooled:
        found = _of_means(link, evaluator, confidence) or _of_level(link, evaluator, confidence)
    return found or _resampled(link, evaluator, confidence)


def about_these_runs(link: tree.Link, evaluator: Evaluator) -> bool:
    """Whether nothing is estimated: no run enters, an extreme or a count does, or a share is every run or none."""
    names = tree.functions(link)
    sides = [side for side in (link.left, link.right) if not tree.terms(side)]
    every_or_none = "share" in names and any(evaluator.number(side) in (0.0, 1.0) for side in sides)
    return not evaluator.columns or every_or_none or bool(_extremes(link, evaluator)) or "n_failed" in names


def _extremes(link: tree.Link, evaluator: Evaluator) -> list[Call]:
    """Smallest and largest values over the runs; those of a series are numbers like others."""
    return [
        call
        for call in tree.calls(link)
        if call.function in ("min", "max") and not tree.terms(call).isdisjoint(evaluator.columns)
    ]


def _of_means(link: tree.Link, evaluator: Evaluator, confidence: float) -> StudentSpread | None:
    sides = [_column(side, evaluator) for side in (link.left, link.right)]
    left, right = sides
    if left is None or right is None or not (left.ndim or right.ndim):
        return None
    tolerance: Array | None = np.array(0.0)
    if link.tolerance is not None:
        tolerance = _column(link.tolerance, evaluator)
        if tolerance is not None and link.relative:
            tolerance = tolerance * right * np.sign(right.mean())
    if tolerance is None or not all(np.isfinite(part).all() for part in (left, right, tolerance)):
        return None
    return StudentSpread(left, right, tolerance, confidence)


def _column(node: Node, evaluator: Evaluator) -> Array | None:
    """Array over the runs whose mean is the value of a node, or the number that it is; None where there is none."""
    if tree.terms(node).isdisjoint(evaluator.columns):
        value = evaluator.value(node)
        return None if value.array.ndim else value.array
    if isinstance(node, Call) and node.function == "mean":
        value = evaluator.value(node.arguments[0])
        return value.array if value.axis == "runs" and value.array.ndim == 1 else None
    if isinstance(node, Negation):
        inner = _column(node.operand, evaluator)
        return None if inner is None else -inner
    return _combined(node, evaluator) if isinstance(node, Operation) else None


def _combined(node: Operation, evaluator: Evaluator) -> Array | None:
    """Sum of columns, or a column times or divided by numbers."""
    found = _column(node.first, evaluator)
    for operand in node.rest:
        other = _column(operand.node, evaluator)
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


def _of_level(link: tree.Link, evaluator: Evaluator, confidence: float) -> LevelSpread | None:
    """Interval of a share (Wilson), or of a ratio of columns (Student on the logs), beside a number."""
    if link.tolerance is not None and not tree.terms(link.tolerance).isdisjoint(evaluator.columns):
        return None
    ends = []
    for side in (link.left, link.right):
        if tree.terms(side):
            interval = _of_estimate(side, evaluator, confidence)
        else:
            number = evaluator.number(side)
            interval = (number, number)
        if interval is None:
            return None
        ends.append(interval)
    if all(tree.terms(side) for side in (link.left, link.right)):
        return None
    tolerance = 0.0 if link.tolerance is None else evaluator.number(link.tolerance)
    if link.relative:
        tolerance *= abs(evaluator.number(link.right))
    return LevelSpread(ends[0], ends[1], tolerance)


def _of_estimate(node: Node, evaluator: Evaluator, confidence: float) -> Interval | None:
    if not isinstance(node, Call):
        return None
    (a, *others) = node.arguments
    if isinstance(a, tree.Chain):
        holds = evaluator.holds(a.links)
        return wilson(int(holds.array.sum()), len(holds.array), confidence) if holds.axis == "runs" else None
    if node.function == "ratio" and isinstance(a, tree.Term) and isinstance(others[0], tree.Term):
        first, second = evaluator.column(a), evaluator.column(others[0])
        if first is not None and second is not None:
            # Evaluating the node reports values that have no logarithm.
            evaluator.value(node)
            return geometric(first, second, confidence)[1]
    return None


def _resampled(link: tree.Link, evaluator: Evaluator, confidence: float) -> ResampledSpread:
    """Both sides on runs drawn again, whole rows, so that pairs stay pairs; nothing below `MIN_RUNS` runs.

    Of more than `MOST_DRAWN` runs a resample has so many (m out of n bootstrap): its deviations are scaled to all runs.
    """
    rng = np.random.Generator(np.random.PCG64(evaluator.trials.seed))
    n_runs = len(evaluator.runs)
    n = max(_RESAMPLES, math.ceil(2 * _IN_THE_TAIL / (1 - confidence))) if n_runs >= MIN_RUNS else 0
    rows = np.empty((3, n))
    # The order statistics of many resamples are found together; the sums of means would be rounded in another way.
    together = max(1, _TOGETHER // min(n_runs, MOST_DRAWN)) if _only_order_statistics(link, evaluator) else 0
    for i in range(0, n, together or 1):
        drawn = evaluator.resampled(rng, MOST_DRAWN, min(together, n - i))
        rows[:, i : i + (together or 1)] = _numbers(link, drawn).reshape(3, -1)
    if n_runs > MOST_DRAWN:
        centre = _numbers(link, evaluator)[:, None]
        # Where an event did not occur in half of the runs there is no size to scale.
        finite = np.isfinite(centre).all() and np.isfinite(rows).all()
        rows = centre + (rows - centre) * math.sqrt(MOST_DRAWN / n_runs) if finite else rows
    return ResampledSpread(rows[0], rows[1], rows[2], confidence)


def _numbers(link: tree.Link, evaluator: Evaluator) -> Array:
    """(3, ...) left and right side and tolerance of a comparison of two numbers, by resample if there are several."""
    left, right, tolerance = evaluator.sides(link)
    return np.stack([left.array, right, tolerance])


def _only_order_statistics(link: tree.Link, evaluator: Evaluator) -> bool:
    """Whether the runs enter by medians and quantiles of single columns, beside numbers."""
    if evaluator.pooled or not set(tree.terms(link)) <= set(evaluator.columns):
        return False
    calls = list(tree.calls(link))
    plain = all(call.function in ("median", "quantile") and isinstance(call.arguments[0], tree.Term) for call in calls)
    return plain and len(tree.terms(link)) > 0 and not any(isinstance(node, tree.Listing) for node in tree.walk(link))
