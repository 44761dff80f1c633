"""Uncertainty of the two sides of a comparison: intervals of their difference and of their ratio.

In the order of preference: the interval of a single estimate beside numbers (`levels`), Student's t where both sides
are linear in means over the runs, and a bootstrap of whole runs for everything else.  For moments over the runs, at
every k or of columns, groups of runs are left out one by one (`jackknife`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from rmpc_bench.analysis.intervals import Interval, difference, quantile
from rmpc_bench.analysis.rounding import NEGLIGIBLE
from rmpc_bench.analysis.superiority import shares_interval
from rmpc_bench.claims import grammar
from rmpc_bench.claims.estimates import (
    ORDER,
    UNBOUNDED,
    Ends,
    at_ends,
    average_interval,
    column,
    estimates,
    hides_values,
    is_binary,
    level_spread,
    pseudo_values,
    ratio_interval,
    unseen,
)
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.values import NoValue, Value
from rmpc_bench.expressions.arithmetic import Call, Node, Number
from rmpc_bench.types import Array

_RESAMPLES = 1000
_IN_THE_TAIL = 25
"""Resamples beyond each end of an interval; at a high level there are more of them."""
MOST_DRAWN = 10_000
"""Largest number of runs of a resample, so that time does not grow with the number of runs."""
_TOGETHER = 1_000_000
"""Numbers of resamples that are taken together; they take 16 MB."""
_ALONG_RUNS = ("mean", "median", "std", "var", "min", "max", "quantile", "share", "ratio", "abs")
MIN_RUNS = 10
"""Runs below which resampling gives no interval."""


class Spread(Protocol):
    """Intervals of a comparison of `left` with `right`, at one level."""

    def gap(self, shift: int = 0) -> Interval:
        """Interval of left - right + shift * tolerance."""

    def ratio(self) -> Interval:
        """Interval of left / right."""


@dataclass(frozen=True, eq=False)
class StudentSpread:
    """Sides that are means over the runs: arrays over the runs, or numbers, whose means are the sides."""

    left: Array
    right: Array
    tolerance: Array
    confidence: float
    seed: int
    hidden: bool | None = False
    """Whether values hide what most runs do not show; None where that is bounded, as for shares."""
    is_share: bool = False
    """Whether the difference is a share, or that of two of them: -1, 0 or 1 in every run, apart from numbers."""
    _found: dict[int, Interval] = field(default_factory=dict, init=False)
    """Shift -> interval: a decision asks for the same one several times."""

    def gap(self, shift: int = 0) -> Interval:
        """Student interval of the paired differences; that of bootstrap-t, too, where they are skewed and few."""
        if shift not in self._found:
            self._found[shift] = self._gap(shift)
        return self._found[shift]

    def _gap(self, shift: int) -> Interval:
        gaps = self.left - self.right + shift * self.tolerance
        scale = float(max(np.abs(self.left).max(), np.abs(self.right).max()))
        found = average_interval(gaps, self.confidence, self.seed, scale=scale, hidden=self.hidden)
        if self.is_share:
            # Pairs that differ may be rare, or not seen at all.
            columns = [side if side.ndim else np.zeros(()) for side in (self.left, self.right)]
            apart, constant = columns[0] - columns[1], (self.left - columns[0]) - (self.right - columns[1])
            moved = float((constant + shift * self.tolerance).mean())
            one, other = int((apart > 0).sum()), int((apart < 0).sum())
            low, high = shares_interval(one, other, len(apart), self.confidence)
            found = _hull(found, (low + moved, high + moved))
        return found

    def ratio(self) -> Interval:
        """Fieller interval: it excludes a factor where the Student interval of left - factor * right excludes 0."""
        if self.hidden:
            return UNBOUNDED
        left, right = np.broadcast_arrays(self.left, self.right)
        return ratio_interval(left, right, self.confidence, self.seed)


@dataclass(frozen=True, eq=False)
class ResampledSpread:
    """Both sides and the tolerance, computed from runs that are drawn again."""

    left: Array
    right: Array
    tolerance: Array
    confidence: float

    def gap(self, shift: int = 0) -> Interval:
        """Percentile interval; an end at the border itself, where shares tie, is one step beyond it."""
        gaps = difference(self.left, self.right) + (shift * self.tolerance if shift else 0.0)
        low, high = self._percentiles(gaps)
        step = float(np.abs(gaps[gaps != 0]).min()) if low * high == 0 and gaps.any() else 0.0
        return (-step if low == 0 else low), (step if high == 0 else high)

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
class WiderSpread:
    """Two spreads of one comparison, taken together."""

    first: Spread
    second: Spread

    def gap(self, shift: int = 0) -> Interval:
        """Interval that contains both."""
        return _hull(self.first.gap(shift), self.second.gap(shift))

    def ratio(self) -> Interval:
        """Interval that contains both."""
        return _hull(self.first.ratio(), self.second.ratio())


def _hull(one: Interval, other: Interval) -> Interval:
    ends = (*one, *other)
    return UNBOUNDED if any(map(math.isnan, ends)) else (min(ends), max(ends))


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


def spread_of(link: grammar.Link, evaluator: Evaluator, confidence: float) -> Spread | None:
    """Find how uncertain both sides of a comparison of two numbers are.

    None where nothing is estimated: then the two numbers decide.  Fewer than two runs or groups of them decide nothing.
    """
    if not evaluator.is_estimated(link):
        return None
    values = pseudo_values(link, evaluator) if evaluator.sampled else None
    if (evaluator.columns and len(evaluator.runs) < 2) or (evaluator.sampled and values is None):
        return UNKNOWN
    alone = level_spread(link, evaluator, confidence) if values is None else None
    if alone is not None:
        return alone
    chosen = _of_selections(link, evaluator, confidence) if values is None else None
    if chosen is not None:
        return chosen
    beyond = unseen(link, evaluator, confidence)
    corners = at_ends(link, evaluator, beyond) if beyond else None
    if beyond and (corners is None or corners.gap() == UNBOUNDED):
        return UNKNOWN
    if values is not None:
        found: Spread = StudentSpread(*values, confidence, evaluator.trials.seed, hidden=None)
    else:
        means = _of_means(link, evaluator, confidence)
        if means is None and _hides_in_means(link, evaluator):
            return UNKNOWN
        found = means or _resampled(link, evaluator, confidence)
        if means and any("share" in grammar.functions(side) for side in (link.left, link.right)):
            # Differences of shares are few steps wide, of which resamples alone miss some.
            found = WiderSpread(means, _resampled(link, evaluator, confidence))
        smooth = None if means else _of_pseudo_values(link, evaluator, confidence)
        found = found if smooth is None else WiderSpread(found, smooth)
        low, high = found.gap()
        size = NEGLIGIBLE * float(max(np.abs(evaluator.value(side).array).max() for side in (link.left, link.right)))
        if corners is None and link.left != link.right and high - low <= size and math.isfinite(low):
            # All runs have the same values: others may have others.
            return UNKNOWN
    return found if corners is None else WiderSpread(found, corners)


def _of_selections(link: grammar.Link, evaluator: Evaluator, confidence: float) -> Spread | None:
    """Spread where one of several estimates, or the absolute value of one, is taken; None where none is."""
    # The estimates have simultaneous intervals, as the one that is taken is the one that chance favours. Resamples of
    # an absolute value lie beside 0 even where the estimate itself may be 0.
    calls = [call for call in grammar.calls(link) if _takes_one(call, evaluator)]
    if not calls:
        return None
    whole = [node for side in grammar.children(link) for node in _without(side, calls)]
    items = [item for call in calls for item in _items(call)]
    parts = dict.fromkeys(node for node in (*items, *whole) if evaluator.is_estimated(node))
    # An absolute value is large on either side.
    level = 1 - (1 - confidence) / (len(parts) + sum(call.function == "abs" for call in calls))
    ends: dict[Node, Ends] = {}
    for node in parts:
        if evaluator.value(node).array.ndim:
            return UNKNOWN
        spread = spread_of(grammar.Link(node, "<", Number(0.0), None, ""), evaluator, level)
        low, high = UNBOUNDED if spread is None else spread.gap()
        ends[node] = (np.array(low), np.array(high))
    # The functions grow with every item.
    at_items = [evaluator.with_values({item: Value(ends[item][i]) for item in items if item in ends}) for i in (0, 1)]
    found: dict[Node, Ends] = {call: (at_items[0].value(call).array, at_items[1].value(call).array) for call in calls}
    found |= {call: _folded(*found[call], *ends[call.arguments[0]]) for call in calls if call.function == "abs"}
    return at_ends(link, evaluator, found | {node: ends[node] for node in whole if node in ends}) or UNKNOWN


def _takes_one(call: Call, evaluator: Evaluator) -> bool:
    """Whether a call takes one of several numbers that are estimated, or the absolute value of one."""
    first = call.arguments[0]
    if not evaluator.is_estimated(first):
        return False
    of_one = call.function == "abs" and not isinstance(first, grammar.Listing) and not evaluator.value(first).array.ndim
    return of_one or (call.function in ORDER and isinstance(first, grammar.Listing))


def _items(call: Call) -> tuple[Node, ...]:
    return (call.arguments[0],) if call.function == "abs" else tuple(grammar.children(call.arguments[0]))


def _folded(one: Array, other: Array, low: Array, high: Array) -> Ends:
    """Ends of an absolute value from those of the number and their absolute values."""
    return (np.zeros(()) if low <= 0 <= high else np.minimum(one, other)), np.maximum(one, other)


def _without(node: Node, calls: list[Call]) -> list[Node]:
    """Collect the largest parts of a node that contain none of the calls."""
    if node in calls or not grammar.terms(node):
        return []
    if not any(each in calls for each in grammar.walk(node)):
        return [node]
    return [part for child in grammar.children(node) for part in _without(child, calls)]


def _of_means(link: grammar.Link, evaluator: Evaluator, confidence: float) -> StudentSpread | None:
    sides = [column(side, evaluator) for side in (link.left, link.right)]
    left, right = sides
    if left is None or right is None or not (left.ndim or right.ndim):
        return None
    tolerance: Array | None = np.array(0.0)
    if link.tolerance is not None:
        tolerance = column(link.tolerance, evaluator)
        if tolerance is not None and link.relative:
            tolerance = tolerance * right * np.sign(right.mean())
    if tolerance is None or not all(np.isfinite(part).all() for part in (left, right, tolerance)):
        return None
    means = [call for call in grammar.calls(link) if call.function == "mean"]
    bounded = all(is_binary(evaluator.value(call.arguments[0]).array) for call in means)
    hidden = None if bounded or link.left == link.right else hides_values(left, right)
    apart = (left if left.ndim else 0.0) - (right if right.ndim else 0.0)
    is_share = bounded and bool(np.isin(apart, (-1, 0, 1)).all())
    return StudentSpread(left, right, tolerance, confidence, evaluator.trials.seed, hidden, is_share)


def _hides_in_means(link: grammar.Link, evaluator: Evaluator) -> bool:
    """Whether a mean or spread that is drawn again is one of values that hide others."""
    calls = [call for call in grammar.calls(link) if call.function in ("mean", "std", "var")]
    values = [evaluator.value(call.arguments[0]) for call in calls if evaluator.is_estimated(call)]
    columns = [value.array for value in values if value.axis == "runs" and value.array.ndim == 1]
    return any(hides_values(column, np.array(0.0)) for column in columns if np.isfinite(column).all())


def _of_pseudo_values(link: grammar.Link, evaluator: Evaluator, confidence: float) -> StudentSpread | None:
    """Spread of variances and other smooth functions, which the percentiles of few resampled runs underestimate."""
    if len(evaluator.runs) < MIN_RUNS or estimates(link, evaluator):
        return None
    try:
        values = pseudo_values(link, evaluator)
    except NoValue:
        return None
    if values is None or not all(np.isfinite(part).all() for part in values):
        return None
    # A number has no law of its own, although it repeats.
    sides = [
        each if evaluator.is_estimated(side) else each[0]
        for side, each in zip((link.left, link.right), values, strict=False)
    ]
    return StudentSpread(*values, confidence, evaluator.trials.seed, hides_values(*sides))


def _resampled(link: grammar.Link, evaluator: Evaluator, confidence: float) -> ResampledSpread:
    """Both sides on runs drawn again, whole rows, so that pairs stay pairs; nothing below `MIN_RUNS` runs."""
    # Of more than `MOST_DRAWN` runs a resample has so many (m out of n bootstrap): its deviations are scaled to all
    # runs.
    rng = np.random.Generator(np.random.PCG64(evaluator.trials.seed))
    n_runs = len(evaluator.runs)
    n = max(_RESAMPLES, math.ceil(2 * _IN_THE_TAIL / (1 - confidence))) if n_runs >= MIN_RUNS else 0
    rows = np.empty((3, n))
    together = max(1, _TOGETHER // min(n_runs, MOST_DRAWN)) if _is_by_columns(link, evaluator) else 0
    for i in range(0, n, together or 1):
        drawn = evaluator.resampled(rng, MOST_DRAWN, min(together, n - i))
        try:
            rows[:, i : i + (together or 1)] = np.stack(drawn.side_arrays(link)).reshape(3, -1)
        except NoValue:
            # Such as a divisor that is 0 in these runs: nothing bounds the sides.
            rows = rows[:, :0]
            break
    if n_runs > MOST_DRAWN:
        centre = np.stack(evaluator.side_arrays(link))[:, None]
        # Where an event did not occur in half of the runs there is no size to scale.
        finite = np.isfinite(centre).all() and np.isfinite(rows).all()
        rows = centre + (rows - centre) * math.sqrt(MOST_DRAWN / n_runs) if finite else rows
    return ResampledSpread(rows[0], rows[1], rows[2], confidence)


def _is_by_columns(link: grammar.Link, evaluator: Evaluator) -> bool:
    """Whether each part is computed along axis 0 of columns, so that resamples may stand side by side."""
    if evaluator.pooled or not grammar.terms(link) <= evaluator.columns.keys():
        return False
    calls = grammar.calls(link)
    known = all(call.function in _ALONG_RUNS for call in calls)
    levels = [call.arguments[1] for call in calls if call.function == "quantile"]
    is_plain = not any(isinstance(node, grammar.Listing) for node in grammar.walk(link))
    return known and is_plain and not any(map(grammar.terms, levels))
