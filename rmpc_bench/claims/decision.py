"""What an interval decides, at which value of a threshold the decision changes, and how many runs would decide.

Comparisons entry by entry, over k or over states, have a simultaneous band over all entries.  Its ends are quantiles of
the largest t and of the largest -t over all entries when groups of runs are drawn again (bootstrap-t with equal tails),
so that the band covers all entries together with the probability of one interval.  For the variance at 30 correlated
samples of 50 and 200 runs it covers 0.95 of the time at 95 %; random signs of the groups, which lose the skewness, 0.72
and 0.86.  With fewer than `FEW_GROUPS` groups too few resamples differ, and the width is that of Bonferroni.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import difference, t_quantile
from rmpc_bench.analysis.rounding import significant, without_noise
from rmpc_bench.claims import grammar
from rmpc_bench.claims.estimates import (
    ORDER,
    CornerSpread,
    estimates,
    level_spread,
    pseudo_values,
    unseen,
)
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.spread import UNKNOWN, BandSpread, Spread
from rmpc_bench.claims.values import Value
from rmpc_bench.expressions.arithmetic import Call, Node, Operation
from rmpc_bench.types import Array

MAX_RUNS = 10_000_000
"""Largest number of runs that is given."""


class Change(NamedTuple):
    """Where the outcome of a comparison changes with a number of its check: inconclusive from `low` to `high`."""

    kind: Literal["threshold", "factor", "margin", "relative margin"]
    low: float
    high: float
    per_unit: float = 1.0  # change of `low` and `high` per unit of the sides of the comparison

    def rounded(self, scale: float) -> Change:
        """Round to the digits that sides computed from numbers of this scale support."""
        low, high = (without_noise(end, scale * self.per_unit) for end in (self.low, self.high))
        return self._replace(low=low, high=high)


def decided(operator: str, spread: Spread) -> bool | None:
    """Decide by intervals: a comparison holds, or fails, only when its whole interval does; None where it is open.

    Equality up to a tolerance holds when the interval lies inside that.
    """
    low, high = spread.gap()
    if operator == "==":
        return True if low == high == 0 else None if low <= 0 <= high else False
    if operator == "~":
        above, below = spread.gap(-1), spread.gap(1)
        if above[1] <= 0 <= below[0]:
            return True
        return False if above[0] > 0 or below[1] < 0 else None
    if operator in (">", ">="):
        low, high = -high, -low
    strict = operator in ("<", ">")
    if high < 0 or (high == 0 and not strict):
        return True
    return False if low > 0 or (low == 0 and strict) else None


def n_deciding(
    link: grammar.Link,
    evaluator: Evaluator,
    spread: Spread | None,
    estimate: tuple[float, float, float],
    confidence: float,
) -> int | None:
    """Estimate how many runs would decide an inconclusive comparison, if `estimate` is right.

    It has the left side, the right side and the tolerance.  A share, quantile or geometric mean gets the interval that
    so many runs would have; any other one becomes narrower with the root of their number.  Two significant digits; None
    where no number can be named.
    """
    n = len(evaluator.runs) or evaluator.n
    if spread is None or link.operator == "==" or n < 2:
        # Runs can contradict equality, not prove it.
        return None
    if isinstance(spread, CornerSpread):
        return _n_of_level(link, evaluator, confidence, n)
    needed = 0.0
    for shift in (-1, 1) if link.operator == "~" else (0,):
        low, high = spread.gap(shift)
        if not low <= 0 <= high:
            continue
        centre = estimate[0] - estimate[1] + (shift * estimate[2] if shift else 0.0)
        reach = high - centre if centre < 0 else centre - low
        if not math.isfinite(reach) or abs(centre) * math.sqrt(MAX_RUNS) <= reach * math.sqrt(n):
            return None
        needed = max(needed, n * (reach / centre) ** 2)
    return math.ceil(significant(needed, 2)) if needed else None


def _n_of_level(link: grammar.Link, evaluator: Evaluator, confidence: float, n: int) -> int | None:
    def decides(runs: int) -> bool:
        spread = level_spread(link, evaluator, confidence, runs / n)
        return spread is not None and decided(link.operator, spread) is not None

    high = n
    while not decides(high):
        high *= 2
        if high > MAX_RUNS:
            return None
    low = high // 2
    while high - low > max(1, high // 200):
        middle = (low + high) // 2
        low, high = (low, middle) if decides(middle) else (middle, high)
    return math.ceil(significant(high, 2))


def change(link: grammar.Link, evaluator: Evaluator, spread: Spread | None) -> Change | None:
    """Find where the outcome changes with the tolerance, factor or threshold that the check gives.

    None where the check gives no such number, or only 0 or 1, which are borders and no thresholds.
    """
    if link.operator == "~":
        return _margin(link, evaluator, spread)
    for side, other in ((link.left, link.right), (link.right, link.left)):
        parts = _factored(side)
        if parts is not None and grammar.terms(other):
            factor, rest = parts
            return _factor(link, evaluator, spread, evaluator.number(factor), rest)
    return None if spread is None else _threshold(link, evaluator, spread)


def _margin(link: grammar.Link, evaluator: Evaluator, spread: Spread | None) -> Change | None:
    """Smallest tolerance within which both sides are equivalent, and the largest at which they certainly are not."""
    left, right, _ = evaluator.sides(link)
    scale = float(np.abs(right).min()) if link.relative else 1.0
    if spread is None:
        gaps = np.abs(difference(left.array, right))
        if link.relative:
            with np.errstate(all="ignore"):
                gaps = np.where(gaps == 0, 0.0, gaps / np.abs(right))
        largest = float(gaps.max())
        low, high = largest, largest
    else:
        ends = spread.gap()
        if link.relative:
            ends = (spread.ratio()[0] - 1, spread.ratio()[1] - 1)
        low = 0.0 if ends[0] <= 0 <= ends[1] else min(abs(end) for end in ends)
        high = max(abs(end) for end in ends)
    return (
        Change("relative margin" if link.relative else "margin", low, high, 1 / scale if scale else 0.0)
        if math.isfinite(high)
        else None
    )


def _threshold(link: grammar.Link, evaluator: Evaluator, spread: Spread) -> Change | None:
    """Interval of the side beside a fixed number; 0, 1 and inf are borders of what can be, no thresholds."""
    low, high = spread.gap()
    for side, sign in ((link.right, 1), (link.left, -1)):
        if grammar.terms(side):
            continue
        level = evaluator.number(side)
        ends = sorted((level + sign * low, level + sign * high))
        if level in (0.0, 1.0) or not all(map(math.isfinite, (level, *ends))):
            return None
        return Change("threshold", *ends)
    return None


def _factored(side: Node) -> tuple[Node, Node] | None:
    """Split ``factor * rest``, in any order."""
    if not (isinstance(side, Operation) and len(side.rest) == 1 and side.rest[0].operator == "*"):
        return None
    for factor, rest in ((side.first, side.rest[0].node), (side.rest[0].node, side.first)):
        if not grammar.terms(factor) and grammar.terms(rest) and not isinstance(factor, grammar.Listing):
            return factor, rest
    return None


def _factor(
    link: grammar.Link, evaluator: Evaluator, spread: Spread | None, factor: float, rest: Node
) -> Change | None:
    """Interval of the other side divided by the rest; of exact entries the ratio of the tightest one."""
    on_right = isinstance(link.right, Operation) and rest in (link.right.first, link.right.rest[0].node)
    left, right, _ = evaluator.sides(link)
    other, side = (left.array, right) if on_right else (right, left.array)
    smallest = float(np.abs(side).min())
    if not smallest:
        return None
    if spread is None:
        ratios = other / side
        if not (np.isfinite(ratios).all() and (side * factor > 0).all()):
            return None
        upper = on_right == (link.operator in ("<", "<="))
        low = high = float(ratios.max() if upper else ratios.min())
    else:
        low, high = spread.ratio() if on_right else spread.ratio()[::-1]
        if not 0 < min(low, high) <= max(low, high) < math.inf:
            return None
        low, high = (low, high) if on_right else (1 / low, 1 / high)
    return Change("factor", factor * low, factor * high, abs(factor) / smallest)


def below_margin(link: grammar.Link, evaluator: Evaluator, spread: Spread | None) -> str:
    """Return the margin of relevance in words, if two averages of one metric certainly differ by less than that."""
    names = {term.quantity for term in grammar.terms(link)}
    infos = [info for info in evaluator.trials.metrics if info.name in names]
    averages = {_average(side) for side in (link.left, link.right)}
    if link.operator not in ("<", ">") or len(names) != 1 or not infos or len(averages) != 1 or "" in averages:
        return ""
    signed = infos[0].direction in ("zero", "one") or any((column < 0).any() for column in evaluator.columns.values())
    margin = evaluator.trials.relevant_of(infos[0].name, default=0.0 if signed else None)
    if spread is None:
        left, right, _ = evaluator.sides(link)
        with np.errstate(all="ignore"):
            changes = difference(left.array, right) if signed else left.array / right
        low, high = float(np.min(changes)), float(np.max(changes))
    else:
        low, high = spread.gap() if signed else spread.ratio()
    below = -margin <= low <= high <= margin if signed else 1 / (1 + margin) <= low <= high <= 1 + margin
    return (f"{margin:g} {infos[0].unit}".rstrip() if signed else f"{100 * margin:g} %") if below else ""


def _average(side: Node) -> str:
    """Name the average over the runs that a side is, ``each`` for the runs themselves; empty for any other side."""
    if isinstance(side, grammar.Term):
        return "each"
    if isinstance(side, Call) and side.function in ("mean", "median") and isinstance(side.arguments[0], grammar.Term):
        return side.function
    return ""


def exceptions(link: grammar.Link, value: Value, evaluator: Evaluator, confidence: float) -> float | None:
    """Bound the share of exceptions, one-sided and exact, to a statement about every run; None for other statements."""
    n = len(evaluator.runs) or (len(evaluator.trials.runs) if "n_failed" in grammar.functions(link) else 0)
    if n < 2 or not _about_every_run(link, value, evaluator):
        return None
    return float(1 - (1 - confidence) ** (1 / n))


def _about_every_run(link: grammar.Link, value: Value, evaluator: Evaluator) -> bool:
    if value.axis == "runs":
        return True
    if value.array.ndim:
        return False
    for side, level, bounds in ((link.left, link.right, ("<", "<=")), (link.right, link.left, (">", ">="))):
        if grammar.terms(level):
            continue
        number = evaluator.number(level)
        if isinstance(side, grammar.Term):
            return side.quantity in grammar.COUNTS and number == 0 and link.operator in ("==", *bounds)
        if not isinstance(side, Call):
            continue
        if side.function == "share":
            return number in (0.0, 1.0)
        upward = link.operator in bounds
        if side.function in ("max", "min") and not grammar.terms(side).isdisjoint(evaluator.columns):
            return link.operator == "==" or upward == (side.function == "max")
    return False


_RESAMPLES = 1999
_CHUNK = 100
FEW_GROUPS = 10
"""Groups below which the width is that of Bonferroni: sample variances of few groups are nearly 0 too often."""


class Band(NamedTuple):
    """Simultaneous interval of every entry."""

    low: Array
    high: Array


def entry_by_entry(
    link: grammar.Link, evaluator: Evaluator, confidence: float, place: tuple[int, ...], *, about_runs: bool
) -> tuple[Spread | None, tuple[int, ...]]:
    """Find how uncertain the entry is that decides a comparison of series, vectors or matrices, and its place.

    No spread where no entry is estimated, or where the entries are runs (`about_runs`).
    """
    if about_runs or not evaluator.is_estimated(link):
        return None, place
    # Leaving groups of runs out says nothing of quantiles, nor of what was not seen.
    of_order = any(isinstance(node, Call) and node.function in ORDER for node in estimates(link, evaluator))
    values = None if of_order or unseen(link, evaluator, confidence) else pseudo_values(link, evaluator)
    if values is None:
        return UNKNOWN, place
    gap, seed = difference(values.left, values.right), evaluator.trials.seed
    bands = {shift: band(gap + shift * values.tolerance if shift else gap, confidence, seed) for shift in (-1, 0, 1)}

    def at(entry: tuple[int, ...]) -> BandSpread:
        return BandSpread({shift: (float(band.low[entry]), float(band.high[entry])) for shift, band in bands.items()})

    # A failing entry decides, else an inconclusive one; the tightest entry, if it is one of these.
    order = {False: 0, None: 1, True: 2}
    entries = [place, *np.ndindex(bands[0].low.shape)]
    ranks = [order[decided(link.operator, at(entry))] for entry in entries]
    worst = entries[ranks.index(min(ranks))]
    return at(worst), worst


def band(values: Array, confidence: float, seed: int) -> Band:
    """Compute the simultaneous band of the mean of pseudo-values (groups, ...)."""
    from scipy import special

    n, shape = len(values), values.shape[1:]
    flat = values.reshape(n, -1)
    centre = flat.mean(axis=0)
    deviation = flat - centre
    squares = (deviation**2).sum(axis=0)
    varying = squares > 0
    # The band is never narrower than the interval of one entry.
    factors = np.full(2, t_quantile(n - 1, confidence))
    if n < FEW_GROUPS:
        factors[:] = special.stdtrit(n - 1, 1 - (1 - confidence) / (2 * max(int(varying.sum()), 1)))
    elif varying.any():
        largest = _largest_t(deviation[:, varying] / np.sqrt(squares[varying]), seed)
        rank = min(_RESAMPLES, math.ceil((_RESAMPLES + 1) * (1 + confidence) / 2)) - 1
        factors = np.maximum(np.sort(largest, axis=1)[:, rank], factors)
    below, above = (np.where(varying, factor * np.sqrt(squares / (n * (n - 1))), 0.0) for factor in factors)
    return Band((centre - below).reshape(shape), (centre + above).reshape(shape))


def _largest_t(deviation: Array, seed: int) -> Array:
    """Draw groups again and return the largest t and the largest -t over all entries, (2, _RESAMPLES)."""
    # It is inf where an entry has no spread in a resample.
    n = len(deviation)
    rng = np.random.Generator(np.random.PCG64(seed))
    counts = rng.multinomial(n, np.full(n, 1 / n), _RESAMPLES).astype(float)
    found = []
    for first in range(0, _RESAMPLES, _CHUNK):
        part = counts[first : first + _CHUNK]
        mean = part @ deviation / n
        variance = np.maximum(part @ deviation**2 - n * mean**2, 0.0) / (n * (n - 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(mean == 0, 0.0, mean / np.sqrt(variance))
        found.append(np.stack([t.max(axis=1), -t.min(axis=1)]))
    return np.concatenate(found, axis=1)
