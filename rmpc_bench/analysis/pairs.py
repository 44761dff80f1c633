"""Runs of methods in pairs: won, lost and tied against a baseline, averages of differences, effects of two axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from rmpc_bench.analysis.adjustment import Values
from rmpc_bench.analysis.intervals import FEW, difference
from rmpc_bench.analysis.rounding import NEGLIGIBLE, STABLE
from rmpc_bench.analysis.verdict import FACTOR, far_worse
from rmpc_bench.types import Array, MetricInfo

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

Average = TypeVar("Average")
_LARGEST_LOG = 700.0
"""Logarithm from which on `relative_change` has no finite value."""


def relative_change(log_ratio: float) -> float:
    """Return the change, such as 0.1 for 10 %, that the logarithm of a ratio means; inf where it is too large."""
    return math.inf if log_ratio >= _LARGEST_LOG else math.expm1(log_ratio)


def distance_from_best(values: Array, direction: str) -> Array:
    """Return what is compared: the value, its size if 0 is best, max(value, 1/value) if 1 is best."""
    if direction == "zero":
        return np.abs(values)
    if direction == "one":
        with np.errstate(divide="ignore"):
            return np.maximum(values, np.where(values >= 0, 1 / np.abs(values), np.inf))
    return values


def name_of_distance(info: MetricInfo, words: str = "") -> str:
    """Name the quantity that `distance_from_best` returns, with `words` for the metric if there are any."""
    words = words or info.label or info.name
    return {"zero": f"|{words}|", "one": f"max({words}, 1/{words})"}.get(info.direction, words)


def is_signed(trials: Trials, info: MetricInfo) -> bool:
    """Whether the differences of a metric have its unit instead of per cent: 0 is best, or some values are negative."""
    if info.direction == "zero":
        return True
    return info.direction != "one" and trials.has_negative(info.name)


@dataclass(frozen=True, eq=False)
class Pairs:
    """The runs in which both methods either have a value or failed.

    Parameters
    ----------
    a, b : (n,) distances from the best value of the method and of the baseline; inf where an event did not occur, NaN
        where the run failed.  Values that differ by rounding errors only are equal
    runs : (n,) run indices
    higher : whether higher values are better
    signed : whether differences have the unit of the metric; otherwise they are ratios
    with_average : whether the metric has a mean; one of an event that may not occur has none
    margin : differences up to this size are tied: on logs, or in the unit of a signed metric
    """

    a: Array
    b: Array
    runs: Array
    higher: bool
    signed: bool
    with_average: bool
    margin: float

    @property
    def both(self) -> Array:
        """(n,) whether both methods finished."""
        return ~(np.isnan(self.a) | np.isnan(self.b))

    @property
    def failed(self) -> tuple[int, int]:
        """Runs in which only the method failed, and runs in which only the baseline did."""
        a, b = np.isnan(self.a), np.isnan(self.b)
        return int((a & ~b).sum()), int((b & ~a).sum())

    @property
    def rarely_differ(self) -> bool:
        """Whether most pairs are equal and fewer than `FEW` differ: their mean has no reliable interval.

        If one pair in fifty differs, a third of all experiments contain no difference and have an interval of width 0.
        """
        return few_differ(self.a[self.both], self.b[self.both])

    @property
    def scores(self) -> Array:
        """(n,) 1 where the method is better, -1 where it is worse, 0 where the difference is within the margin.

        A failed run is worse than any finished one; both failed are tied.
        """
        failed_a, failed_b = np.isnan(self.a), np.isnan(self.b)
        with np.errstate(divide="ignore", invalid="ignore"):
            gap = difference(self.a, self.b) if self.signed else difference(np.log(self.a), np.log(self.b))
        # A difference equal to the margin is tied, whatever the last digit of its logarithm is.
        untied = np.abs(gap) > self.margin * (1 + NEGLIGIBLE)
        score = np.where(untied, np.sign(gap if self.higher else -gap), 0.0)
        return np.where(failed_a | failed_b, failed_b.astype(float) - failed_a, score)

    def worse(self, values: Array) -> Array:
        """Return numbers that are worse: by a factor of `FACTOR`, or by twice the largest distance if signed."""
        size = _mean_size(self.a, self.b) or 1.0
        with np.errstate(invalid="ignore"):
            if self.signed:
                sizes = np.abs([self.a, self.b])
                step = np.asarray(2 * max(self.margin, float(sizes[np.isfinite(sizes)].max(initial=0.0))) or size)
            else:
                step = np.where(values > 0, values * (1 - 1 / FACTOR if self.higher else FACTOR - 1), size)
            return np.asarray(values - step if self.higher else values + step)

    def far_worse(self, factor: float) -> tuple[int, int]:
        """Count the runs of the method and of the baseline that failed, or are worse than the other by the factor.

        Unlike `lost_runs`, only runs of both count, and for a signed metric only failed ones.
        """
        one, other = (self.b, self.a) if self.higher else (self.a, self.b)
        far = np.array([far_worse(one, other, factor), far_worse(other, one, factor)]) & (not self.signed)
        method, baseline = (far | np.isnan([self.a, self.b])).sum(axis=1)
        return int(method), int(baseline)

    def counted(self, worst: float) -> Pairs:
        """Let a failed run count as the worst finished one, and as worse than its partner; both failed are tied."""
        pick = np.fmin if self.higher else np.fmax
        a, b = (
            np.where(np.isnan(own), pick(self.worse(other), worst), own)
            for own, other in ((self.a, self.b), (self.b, self.a))
        )
        return replace(self, a=a, b=b)

    def averages(self) -> dict[str, Array]:
        """Return the averages that exist -> (n_pairs,) numbers whose mean they are, of the runs that both finished.

        ``geometric``: log ratios.  ``mean``: the log of the ratio of the means, distributed over the runs by the
        jackknife, see `_jackknifed`.
        ``difference``: differences in the unit of a signed metric.
        """
        both = self.both
        a, b = self.a[both], self.b[both]
        if not (len(a) and self.with_average and np.isfinite(a).all() and np.isfinite(b).all()):
            return {}
        if self.signed:
            return {"difference": a - b}
        if not (a.any() or b.any()):
            return {"mean": np.zeros(len(a))}
        found = {}
        if (a > 0).all() and (b > 0).all():
            found["geometric"] = np.where(a == b, 0.0, np.log(a) - np.log(b))
        mean_a, mean_b = float(a.mean()), float(b.mean())
        if 0 < mean_a < math.inf and 0 < mean_b < math.inf:
            found["mean"] = _jackknifed(a, b)
        return found

    def values_of(self, values: Array, runs: Array) -> Values:
        """Return the numbers of an average, which belong to these runs, with their degrees of freedom."""
        return Values(values, runs, len(values) - 1)

    def ranked(self) -> Array:
        """(n_pairs,) differences of the runs that both finished, so rounded that equal ones tie on every CPU."""
        both = self.both
        a, b = self.a[both], self.b[both]
        if not self.signed and np.isfinite(a).all() and np.isfinite(b).all() and (a > 0).all() and (b > 0).all():
            return np.where(a == b, 0.0, np.round(np.log(a) - np.log(b), STABLE))
        return np.round(difference(a, b) / (_mean_size(a, b) or 1.0), STABLE)

    def scale(self) -> float:
        """Size of the numbers that differences are computed from: 1 for ratios."""
        return _mean_size(self.a[self.both], self.b[self.both]) if self.signed else 1.0


class Samples(Pairs):
    """Runs of a method and of the baseline that are not paired: row i of both has nothing in common.

    Method  The values of `averages` are the difference theta of two means plus the deviations of both samples, n(1) and
            n(2) of them, those of sample j times +-sqrt(N (N - 1) / (n(j) (n(j) - 1))), N = n(1) + n(2).  Their mean is
            theta, their standard error is that of Welch.
    """

    @property
    def _finished(self) -> tuple[Array, Array]:
        return self.a[~np.isnan(self.a)], self.b[~np.isnan(self.b)]

    @property
    def both(self) -> Array:
        """(n,) as many true entries as there are finished runs of the method that has fewer."""
        return np.arange(len(self.a)) < min(map(len, self._finished))

    @property
    def failed(self) -> tuple[int, int]:
        """Failed runs of the method and of the baseline."""
        return int(np.isnan(self.a).sum()), int(np.isnan(self.b).sum())

    @property
    def rarely_differ(self) -> bool:
        """No two runs belong together."""
        return False

    @property
    def scores(self) -> Array:
        """(n,) NaN: no run is won, lost or tied."""
        return np.full(len(self.a), np.nan)

    def averages(self) -> dict[str, Array]:
        """Return the averages that exist -> numbers whose mean is the difference of the two samples."""
        pair, both = self._finished, np.concatenate(self._finished)
        if not (self.with_average and all(map(len, pair)) and np.isfinite(both).all()):
            return {}
        if self.signed:
            return {"difference": _apart(*pair)}
        found = {"geometric": _apart(*map(np.log, pair))} if (both > 0).all() else {}
        if (both >= 0).all() and all(each.any() for each in pair):
            found["mean"] = _apart(*(_jackknifed(each, np.ones(len(each))) for each in pair))
        return found

    def values_of(self, values: Array, runs: Array) -> Values:
        """Return the numbers of an average with the degrees of freedom of Welch and Satterthwaite."""
        n, squares = len(self._finished[0]), (values - values.mean()) ** 2
        parts = [(float(each.sum()), len(each) - 1) for each in (squares[:n], squares[n:]) if len(each) > 1]
        below = sum(square**2 / df for square, df in parts)
        df = float(squares.sum()) ** 2 / below if below else len(values) - 1
        return Values(values, runs, df, unpaired=True)


def few_differ(a: Array, b: Array) -> bool:
    """Whether most numbers are equal and few differ."""
    n_equal = int(np.count_nonzero(a == b))
    return n_equal > len(a) / 2 and len(a) - n_equal < FEW


def _apart(a: Array, b: Array) -> Array:
    """Return the values of two samples, see `Samples`; the difference alone where one of them has no spread to see."""
    gap, n = float(a.mean() - b.mean()), len(a) + len(b)
    if min(len(a), len(b)) < 2:
        return np.array([gap])
    both = [(each - each.mean()) * math.sqrt(n * (n - 1) / (len(each) * (len(each) - 1))) for each in (a, -b)]
    return gap + np.concatenate(both)


def asked_for(averages: Mapping[str, Average], trials: Trials) -> dict[str, Average]:
    """Return the averages that are asked for, the one that the verdict rests on first."""
    names = [name for name in averages if trials.average == "both" or name in (trials.average, "difference")]
    return {name: averages[name] for name in sorted(names or averages, key=lambda name: name != trials.headline)}


def pairs_of(trials: Trials, method: str, info: MetricInfo) -> Pairs:
    """Pair a method with the baseline of a table, an experiment or a point of its sweep."""
    a, b = (distance_from_best(trials.column(info.name, name), info.direction) for name in (method, trials.baseline))
    known = np.ones(len(a), dtype=bool)
    for values, name in ((a, method), (b, trials.baseline)):
        has_failed = trials.failed(name)
        known &= has_failed | ~np.isnan(values)
        values[has_failed] = math.nan
    a, b = a[known], b[known]
    with np.errstate(invalid="ignore"):
        close = np.isfinite(a - b) & (np.abs(a - b) <= NEGLIGIBLE * np.maximum(np.abs(a), np.abs(b)))
    signed = is_signed(trials, info)
    d = trials.relevant_of(info.name, default=0.0 if signed else None)
    return (Samples if trials.unpaired else Pairs)(
        a=np.where(close, b, a),
        b=b,
        runs=trials.runs[known],
        higher=info.direction == "higher",
        signed=signed,
        with_average=not info.may_not_occur,
        # Rounded to the digits of the intervals with which it is compared.
        margin=d if signed else round(math.log1p(d), 9),
    )


class TwoWay(NamedTuple):
    """Main effects and interactions of two axes of methods, such as estimators and controllers, in one metric.

    Model   With m_ab the metric of the method a+b, and a0+b0 the baseline, or the first method where that is another:
                main effect of a         the mean over all b of ln(m_ab / m_a0b), of b in the same way
                interaction of a and b   ln(m_ab m_a0b0 / (m_ab0 m_a0b))
            For a signed metric differences stand in place of the logarithms of ratios.
    Failed  A run that failed with one of the methods, or has no value there, is left out of all effects.
    Limit   An entry has no main effect if a method of it, or of the entry of the baseline, is left out of the grid.
    """

    axes: Sequence[str]
    entries: tuple[list[str], list[str]]
    """Names on both axes."""
    reference: tuple[int, int]
    """Places of the entries that the others are compared with."""
    values: Array
    """(first, second, runs) logarithms, or distances from the best value if signed; NaN where a method is left out."""
    effects: Mapping[tuple[str, str], Array]
    """Entries of both axes -> interaction of every run; of a main effect the entry of the other axis is empty."""
    runs: Array
    """Indices of the runs that all methods finished."""
    signed: bool
    """Whether differences have the unit of the metric."""
    scale: float
    """Size of the numbers that effects are computed from."""


def two_way(trials: Trials, info: MetricInfo) -> TwoWay | None:
    """Compare a metric at one point of a sweep; None without two axes, and where the metric has no average.

    It has none if its event may not occur, or a value of 0 has no ratio.
    """
    if trials.two_way is None or len(trials.two_way) != 2 or info.may_not_occur:
        return None
    named = {name: name.partition("+")[::2] for name in trials.methods}
    given, signed = [*trials.two_way.values()], is_signed(trials, info)
    cells = {cell: name for name, cell in named.items() if cell[0] in given[0] and cell[1] in given[1]}
    first, second = ([name for name in axis if name in {cell[k] for cell in cells}] for k, axis in enumerate(given))
    if min(len(first), len(second)) < 2:
        return None
    columns = {cell: distance_from_best(trials.column(info.name, name), info.direction) for cell, name in cells.items()}
    has_value = np.isfinite([*columns.values()]).all(axis=0)
    values = np.full((len(first), len(second), int(has_value.sum())), np.nan)
    for (a, b), column in columns.items():
        values[first.index(a), second.index(b)] = column[has_value]
    if not values.shape[-1] or (not signed and (values <= 0).any()):
        return None
    scale, values = (float(np.nanmean(np.abs(values))), values) if signed else (1.0, np.log(values))
    a0, b0 = found if (found := named.get(trials.baseline)) in cells else next(iter(cells))
    i0, j0 = first.index(a0), second.index(b0)
    rows, over = values.mean(axis=1), values - values[:, [j0]]
    effects = {(a, ""): rows[i] - rows[i0] for i, a in enumerate(first) if i != i0}
    for j, b in ((j, b) for j, b in enumerate(second) if j != j0):
        effects |= {("", b): over[:, j].mean(axis=0)}
        effects |= {(a, b): over[i, j] - over[i0, j] for i, a in enumerate(first) if i != i0}
    known = {cell: each for cell, each in effects.items() if not np.isnan(each).any()}
    known = {cell: np.where(np.abs(each) <= NEGLIGIBLE * scale, 0.0, each) for cell, each in known.items()}
    axes, runs = [*trials.two_way], trials.runs[has_value]
    return TwoWay(axes, (first, second), (i0, j0), values, known, runs, signed, scale)


def worst_finished(trials: Trials, info: MetricInfo) -> float:
    """Return the distance from the best value of the worst finished run of all methods; NaN where there is none."""
    columns = [distance_from_best(trials.column(info.name, name), info.direction) for name in trials.methods]
    worst = np.fmin if info.direction == "higher" else np.fmax
    return float(worst.reduce(np.concatenate(columns), initial=math.nan))


def _jackknifed(a: Array, b: Array) -> Array:
    """Return numbers whose mean is the log of the ratio of two means, each from what its run changes in it.

    The spread of the linearised log (delta method) is too small where few runs make up most of a mean: for log-normal
    values and 50 runs its intervals at 95 % cover 0.92 of the time, those of the jackknife 0.945.
    """
    value = math.log(float(a.mean()) / float(b.mean()))
    rest_a, rest_b = a.sum() - a, b.sum() - b
    if not ((rest_a > 0).all() and (rest_b > 0).all()):
        return np.asarray(value + (a / a.mean() - b / b.mean()))
    without = np.log(rest_a / rest_b)
    # The mean of the deviations is 0 except for rounding; methods that are equal in all runs have none.
    return np.asarray(value + (len(a) - 1) * (without.mean() - without)) if (a != b).any() else np.zeros(len(a))


def _mean_size(a: Array, b: Array) -> float:
    """Mean absolute value of the finite numbers; 0 where there is none."""
    sizes = np.abs(np.concatenate([a, b]))
    sizes = sizes[np.isfinite(sizes)]
    return float(sizes.mean()) if len(sizes) else 0.0
