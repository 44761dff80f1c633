"""Difference of two paired improvements: a method against its baseline in one experiment, minus the same in another.

Method  L_i is the log ratio of method and baseline in run i.  Both experiments draw the run from the same streams, so
        the differences D_i = L_i(A) - L_i(B) are one sample: exp(mean of D) is the ratio of ratios, and its interval
        is that of a mean of paired logs.  The difference of the two improvements, which is
        exp(mean L(B)) - exp(mean L(A)) where low values are best, has the interval of its linearisation (delta
        method), run by run.  For the ratio of the means the numbers L_i are those of the jackknife
        (`pairs.Pairs.averages`), for a signed metric they are differences in its unit.  Where the draws have known laws
        they are those of `adjustment`, each experiment with its own laws.
Unpaired  With different seeds the runs have nothing in common: Welch's intervals.
Verdict  As for a method against its baseline, of the ratio of ratios: with `better` the improvement is larger in A.
Limit   A baseline that is the same in all runs of both: the paired comparison of the method in A and in B.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rmpc_bench.analysis.adjustment import Basis, Values
from rmpc_bench.analysis.intervals import FEW, NONE, Interval, welch
from rmpc_bench.analysis.levels import held_level, unplanned_level
from rmpc_bench.analysis.pairs import (
    Pairs,
    Samples,
    asked_for,
    few_differ,
    is_signed,
    pairs_of,
    relative_change,
    worst_finished,
)
from rmpc_bench.analysis.shown_numbers import Estimate
from rmpc_bench.analysis.superiority import (
    independent_shares,
    runs_for_direction,
    runs_for_equivalence,
    shares_interval,
)
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.verdict import Evidence, Failures, Verdict, verdict
from rmpc_bench.types import Array, MetricInfo

_Both = tuple[Array, Array]
"""Numbers of the runs of A and of B."""


@dataclass(frozen=True)
class AverageDifference:
    """The difference of two improvements in one average.

    Parameters
    ----------
    average : ``geometric`` mean of the paired ratios, ratio of the ``mean`` values, or mean ``difference``
    in_a, in_b : change against the baseline in either experiment, in per cent or in the unit of a signed metric
    difference : improvement in A minus improvement in B, in percentage points or in the unit of a signed metric; an
        improvement is a change towards the best value
    ratio : ratio of method and baseline in A over that in B; none for a signed metric
    """

    average: str
    in_a: Estimate
    in_b: Estimate
    difference: Estimate
    ratio: Estimate = Estimate()


@dataclass(frozen=True)
class ImprovementDifference:
    """A method against its baseline in two experiments, at one point.

    Parameters
    ----------
    point : the point of the sweep in words; empty without a sweep
    method, baseline, metric : names
    paired : whether the runs of the two experiments are paired
    n_a, n_b : runs of either experiment that averages rest on, finished by both methods; equal where they are paired
    failed_a, failed_b : runs in which the method failed, of those that are compared
    alone_a, alone_b : runs of these in which the baseline finished, which count against the gain
    averages : the averages that were asked for and exist, the one that the verdict rests on first
    superiority_a, superiority_b : P(better than the baseline) + P(tied)/2 in either experiment
    superiority : their difference
    verdict : word for the improvement in A against that in B; empty but for the primary metric
    level : level of the intervals of the difference
    runs_for_direction, runs_for_equivalence : about how many runs would decide; NaN where it is decided
    """

    point: str
    method: str
    baseline: str
    metric: str
    paired: bool
    n_a: int
    n_b: int
    failed_a: int
    failed_b: int
    alone_a: int
    alone_b: int
    averages: tuple[AverageDifference, ...]
    superiority_a: float
    superiority_b: float
    superiority: Estimate
    verdict: str
    level: float
    runs_for_direction: float = math.nan
    runs_for_equivalence: float = math.nan


@dataclass(frozen=True, eq=False)
class _Sample:
    """The pairs of method and baseline in both experiments, of the runs that are compared."""

    trials: Trials
    other: Trials
    a: Pairs
    b: Pairs
    paired: bool
    counted: tuple[Pairs, Pairs]
    """The same with every failed run counted: it is the worst finished one, and worse than its partner."""

    @property
    def n_finished(self) -> tuple[int, int]:
        """Runs of A and of B that averages rest on."""
        a, b = self.a.both, self.b.both
        if self.paired:
            a = b = a & b
        return int(a.sum()), int(b.sum())

    @cached_property
    def plain(self) -> dict[str, _Both]:
        """Average -> numbers whose means are the improvements in A and in B, of the runs that all finished."""
        a, b = self.a, self.b
        if self.paired:
            finished = a.runs[a.both & b.both]
            a, b = _of_runs(a, finished), _of_runs(b, finished)
        in_a, in_b = a.averages(), b.averages()
        return asked_for({name: (in_a[name], in_b[name]) for name in in_a if name in in_b}, self.trials)

    @cached_property
    def values(self) -> dict[str, tuple[Values, Values]]:
        """The same, adjusted for the draws of either experiment where they can be.

        In pairs they are adjusted over all common runs, with the terms that each experiment has.
        """
        names = self.plain
        runs = [each.runs[each.both] for each in (self.a, self.b)]
        runs = [np.intersect1d(runs[0], runs[1])] * 2 if self.paired else runs
        found = {name: (self.a.values_of(a, runs[0]), self.b.values_of(b, runs[1])) for name, (a, b) in names.items()}
        if self.trials.adjust == "none" or (self.paired and any(few_differ(*each) for each in names.values())):
            return found
        adjustments = [table.adjustment for table in (self.trials, self.other)]
        bases: list[Basis | None] = [None, None]
        if self.paired:
            common = np.intersect1d(self.trials.runs, self.other.runs)
            adjustments = [each.of_runs(common) for each in adjustments]
            bases = [each.basis(len(runs[0])) for each in adjustments]
            if bases == [None, None]:
                return found
            bases = [each or Basis("", (), np.zeros((len(common), 0))) for each in bases]
        pairs = [_of_runs(each, own) for each, own in zip((self.a, self.b), runs, strict=True)]
        in_a, in_b = (
            each.adjusted(own.runs, own.a, own.b, names, basis)
            for each, own, basis in zip(adjustments, pairs, bases, strict=True)
        )
        if self.paired:
            # Both have all common runs, or both the finished ones.
            return found | {name: (in_a[name], in_b[name]) for name in names if name in in_a and name in in_b}
        return {name: (in_a.get(name, first), in_b.get(name, second)) for name, (first, second) in found.items()}


def improvement_differences(
    points: Sequence[tuple[Trials, Trials]], method: str, info: MetricInfo, *, paired: bool, is_primary: bool
) -> list[ImprovementDifference]:
    """Compare the improvement of a method in A and in B at their common points, with the settings of A."""
    samples = [_sample(a, b, method, info, paired=paired) for a, b in points]
    plain = points[0][0].confidence
    if not is_primary:
        return [_compared(sample, method, info, plain, with_verdict=False) for sample in samples]
    whole = unplanned_level(plain, max(table.look for pair in points for table in pair))
    held = _simultaneous(samples, whole)
    return [_compared(sample, method, info, held, with_verdict=True) for sample in samples]


def _simultaneous(samples: Sequence[_Sample], confidence: float) -> float:
    """Return the level of each interval of the points such that all hold together."""
    if len(samples) == 1:
        return confidence
    if not samples[0].paired:
        return 1 - (1 - confidence) / len(samples)
    runs = np.unique(np.concatenate([sample.trials.runs for sample in samples]))
    columns = np.full((len(runs), len(samples)), np.nan)
    for number, sample in enumerate(samples):
        if sample.values:
            first, second = next(iter(sample.values.values()))
            columns[np.searchsorted(runs, first.runs), number] = first.values - second.values
    return held_level(columns, confidence, samples[0].trials.seed)


def _sample(a: Trials, b: Trials, method: str, info: MetricInfo, *, paired: bool) -> _Sample:
    found = [_pairs(table, method, info, a, signed=is_signed(a, info) or is_signed(b, info)) for table in (a, b)]
    (one, counted_one), (other, counted_other) = found
    if paired:
        common = np.intersect1d(one.runs, other.runs)
        one, counted_one, other, counted_other = (
            _of_runs(pairs, common) for pairs in (one, counted_one, other, counted_other)
        )
        alone = _alone(one), _alone(other)
        counted_one = _behind(counted_one, counted_other, *alone)
        counted_other = _behind(counted_other, counted_one, *alone[::-1])
    return _Sample(a, b, one, other, paired, (counted_one, counted_other))


def _pairs(table: Trials, method: str, info: MetricInfo, settings: Trials, *, signed: bool) -> tuple[Pairs, Pairs]:
    """Pair method and baseline, with failed runs left out and counted; one margin and one kind of difference."""
    margin = settings.relevant_of(info.name, default=0.0 if signed else None)
    margin = margin if signed else round(math.log1p(margin), 9)
    pairs = replace(pairs_of(table, method, info), signed=signed, margin=margin)
    return pairs, pairs.counted(worst_finished(table, info))


def _behind(pairs: Pairs, other: Pairs, alone: Array, other_alone: Array) -> Pairs:
    """Make the gain of a run in which only the method failed smaller than in the other experiment.

    It is equal where the method failed in both.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        equal = pairs.b + (other.a - other.b) if pairs.signed else pairs.b * (other.a / other.b)
        limit = np.where(other_alone, equal, pairs.worse(equal))
    return replace(pairs, a=np.where(alone, (np.fmin if pairs.higher else np.fmax)(pairs.a, limit), pairs.a))


def _of_runs(pairs: Pairs, runs: Array) -> Pairs:
    places = np.flatnonzero(np.isin(pairs.runs, runs))
    return replace(pairs, a=pairs.a[places], b=pairs.b[places], runs=pairs.runs[places])


@np.errstate(over="ignore", invalid="ignore")
def _compared(
    sample: _Sample, method: str, info: MetricInfo, level: float, *, with_verdict: bool
) -> ImprovementDifference:
    n_a, n_b = sample.n_finished
    word, planning = "", {}
    if with_verdict:
        found = _verdict(sample, level)
        word, planning = str(found), _planning(sample, found, level)
    scores = (1 + sample.a.scores) / 2, (1 + sample.b.scores) / 2
    means = [float(each.mean()) if len(each) else math.nan for each in scores]
    ends = _interval(scores, sample, "mean", level)
    return ImprovementDifference(
        point=sample.trials.title,
        method=method,
        baseline=sample.trials.baseline,
        metric=info.name,
        paired=sample.paired,
        n_a=n_a,
        n_b=n_b,
        failed_a=int(np.isnan(sample.a.a).sum()),
        failed_b=int(np.isnan(sample.b.a).sum()),
        alone_a=sample.a.failed[0],
        alone_b=sample.b.failed[0],
        averages=tuple(_average(sample, name, level) for name in sample.values),
        superiority_a=means[0],
        superiority_b=means[1],
        # Runs without spread have no interval, which is not certainty.
        superiority=Estimate(means[0] - means[1], *(ends if ends[0] < ends[1] else NONE)),
        verdict=word,
        level=level,
        **planning,
    )


def _average(sample: _Sample, name: str, level: float) -> AverageDifference:
    both = sample.values[name]
    (a, b), df = (each.values for each in both), (both[0].df, both[1].df)
    gap = Estimate(float(a.mean() - b.mean()), *_interval((a, b), sample, name, level, df))
    in_a, in_b = (_mean(each, name, sample) for each in both)
    if name == "difference":
        return AverageDifference(name, in_a, in_b, _gain(gap, sample))
    # The derivative of exp(mean L) with respect to the mean.
    slope_a, slope_b = math.exp(in_a.value), math.exp(in_b.value)
    points = slope_a - slope_b
    linear = slope_a * (a - a.mean()), slope_b * (b - b.mean())
    low, high = _interval(linear, sample, name, level, df)
    # The linearised numbers have mean 0.
    difference = Estimate(100 * points, 100 * (points + low), 100 * (points + high))
    ratio = Estimate(*map(math.exp, gap))
    return AverageDifference(name, _per_cent(in_a), _per_cent(in_b), _gain(difference, sample), ratio)


def _gain(change: Estimate, sample: _Sample) -> Estimate:
    """Turn a difference of changes into one of improvements."""
    return change if sample.a.higher else Estimate(-change.value, -change.high, -change.low)


def _mean(each: Values, average: str, sample: _Sample) -> Estimate:
    """Return an improvement with its interval, which is the same as in the comparison of this experiment alone."""
    return Estimate(float(each.values.mean()), *each.interval(average, sample.trials.confidence, sample.trials.seed))


def _per_cent(log_ratio: Estimate) -> Estimate:
    return Estimate(*(100 * relative_change(end) for end in log_ratio))


def _interval(
    values: _Both, sample: _Sample, average: str, level: float, df: tuple[float, float] | None = None
) -> Interval:
    """Interval of the difference of two means; none where most runs are equal and few differ."""
    a, b = values
    df = df or (len(a) - 1, len(b) - 1)
    if not sample.paired:
        return welch(a, b, level, df)
    if few_differ(a, b):
        return NONE
    return Values(a - b, sample.a.runs, min(df)).interval(average, level, sample.trials.seed)


def _verdict(sample: _Sample, level: float) -> Verdict:
    # A run in which both fail says nothing about the gain: its plant may be too hard for any method.
    failed = _alone(sample.a), _alone(sample.b)
    failures = None
    if failed[0].any() or failed[1].any():
        counted = replace(sample, a=sample.counted[0], b=sample.counted[1])
        alone, interval = _failed(failed, sample, level)
        failures = Failures(*alone, interval, _evidence(counted, level))
    return verdict(_evidence(sample, level), failures)


def _alone(pairs: Pairs) -> Array:
    """(n,) whether the method failed and the baseline did not."""
    return np.asarray(np.isnan(pairs.a) & (~np.isnan(pairs.b) | isinstance(pairs, Samples)))


def _failed(failed: _Both, sample: _Sample, level: float) -> tuple[tuple[int, int], Interval]:
    """Return the failures of the method alone that one experiment only has, and the interval of the difference."""
    a, b = failed
    if sample.paired:
        alone = int((a & ~b).sum()), int((b & ~a).sum())
        return alone, shares_interval(*alone, len(a), level)
    alone = int(a.sum()), int(b.sum())
    return alone, independent_shares(alone, (len(a), len(b)), level)


def _evidence(sample: _Sample, level: float) -> Evidence:
    """Collect the numbers from which the verdict follows, where a negative difference is a larger gain in A."""
    higher = sample.a.higher
    ends = []
    for name, (a, b) in sample.values.items():
        low, high = _interval((a.values, b.values), sample, name, level, (a.df, b.df))
        ends.append((-high, -low) if higher else (low, high))
    scores = sample.a.scores / 2, sample.b.scores / 2
    low, high = _interval(scores, sample, "mean", level)
    n = min(sample.n_finished)
    first = next(iter(sample.plain.values()), None)
    with_pairs = sample.paired and first is not None
    n_untied = int(np.count_nonzero(np.abs(first[0] - first[1]) > sample.a.margin)) if with_pairs and first else n
    return Evidence(
        interval=ends[0] if ends else NONE,
        margin=sample.a.margin,
        n_pairs=n,
        n_untied=n_untied,
        superiority=((1 + low) / 2, (1 + high) / 2),
        other=ends[1] if len(ends) > 1 else NONE,
    )


def _planning(sample: _Sample, word: Verdict, level: float) -> dict[str, float]:
    """Return about how many runs would decide an inconclusive difference; only where the runs are paired."""
    first = next(iter(sample.values.values()), None)
    if word != Verdict.INCONCLUSIVE or first is None or not sample.paired or len(first[0].values) < 2:
        return {}
    gap = first[0].values - first[1].values
    sd = float(np.std(gap, ddof=1))
    found = {
        "runs_for_direction": runs_for_direction(float(gap.mean()), sd, level),
        "runs_for_equivalence": runs_for_equivalence(sd, sample.a.margin, level),
    }
    found = {name: float(np.maximum(n, FEW)) for name, n in found.items()}
    return {name: n if n > len(gap) else math.nan for name, n in found.items()}
