"""Paired comparison of every method with the baseline: averages with intervals, counts, superiority and verdict.

The unit is the run, paired with the baseline's run of the same index.  The verdict is given for the primary metric
only.  Its intervals are simultaneous for all methods and all points of a sweep, see `levels`; those of other metrics
have the level of the experiment one by one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.adjustment import Values
from rmpc_bench.analysis.columns import Rows
from rmpc_bench.analysis.intervals import FEW, NONE, Interval, holm, signed_rank_p
from rmpc_bench.analysis.levels import held_level, unplanned_level
from rmpc_bench.analysis.pairs import Pairs, asked_for, pairs_of, two_way, worst_finished
from rmpc_bench.analysis.rounding import NEGLIGIBLE, significant, without_noise
from rmpc_bench.analysis.superiority import (
    independent_shares,
    runs_for_count,
    runs_for_direction,
    runs_for_equivalence,
    shares_interval,
    superiority,
    superiority_interval,
)
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.verdict import FACTOR, Evidence, Failures, Verdict, counts_decide, largest_share, verdict
from rmpc_bench.types import Array, MetricInfo

COLUMNS = (
    "method baseline metric change_pct ci_low ci_high won lost tied superiority p_wilcoxon_holm n_pairs verdict "
    "average ci_level geometric_pct geometric_low geometric_high mean_pct mean_low mean_high difference "
    "difference_low difference_high superiority_low superiority_high failed_only baseline_failed_only failed_low "
    "failed_high far_worse_runs far_worse_upper baseline_far_worse_runs baseline_far_worse_upper runs_for_direction "
    "runs_for_equivalence look"
).split()
"""Columns of comparisons.csv, a row of which is a method against the baseline in one metric.

method, baseline, metric : names
change_pct, ci_low, ci_high : change from the baseline in per cent with its interval, in the average that `average`
    names; NaN for a signed metric, and where an event did not occur.  The interval of an average is NaN where most
    pairs are equal and fewer than 20 differ
won, lost, tied : all runs of both; tied within the relevant difference; a failed run loses against a finished one
superiority : P(better) + P(tied)/2 by the same rule
p_wilcoxon_holm : signed-rank p after Holm as text, at most ``< 0.001``; empty without pairs
n_pairs : runs that both finished; averages rest on them
verdict : see `rmpc_bench.analysis.verdict`; empty but for the primary metric
average : ``geometric`` mean of the ratios, ratio of the ``mean`` values, mean ``difference``, or empty
ci_level : level of each interval of the row
geometric_pct, geometric_low, geometric_high : geometric mean of the ratios - 1 [%]; NaN where it is not asked for
mean_pct, mean_low, mean_high : ratio of the means - 1 [%]; NaN where it is not asked for
difference, difference_low, difference_high : mean difference in the unit of a signed metric
superiority_low, superiority_high : interval of `superiority`
failed_only, baseline_failed_only : runs in which one of the two failed and the other did not; without pairs, see
    `pairs.Samples`, its failed runs
failed_low, failed_high : interval of the difference of the shares of failed runs
far_worse_runs, far_worse_upper : runs that failed or are worse than their partner by a factor, that of
    `statistics.lost` or 10, and the exact 95 % bound of their share; failed ones only for a signed metric, none
    without a verdict
baseline_far_worse_runs, baseline_far_worse_upper : the same of the baseline
runs_for_direction : about how many runs would decide for better or worse, where the verdict is inconclusive
runs_for_equivalence : about how many runs would show equivalence if there were no difference
look : number of the look at the growing number of runs
"""
ADJUSTED = (
    "rests_on geometric_adjusted_pct geometric_adjusted_low geometric_adjusted_high mean_adjusted_pct "
    "mean_adjusted_low mean_adjusted_high difference_adjusted difference_adjusted_low difference_adjusted_high "
    "adjusted_form adjusted_for width_ratio"
).split()
"""Columns of an adjustment; tables of experiments in which nothing is adjusted do not have them.

rests_on : ``adjusted`` or ``plain`` average, or ``counts``: what the verdict rests on, and `change_pct` with its
    interval, which counts leave as they are; empty with `adjust: none`
geometric_adjusted_pct, .., mean_adjusted_pct, .., difference_adjusted, .. : averages adjusted for draws of known
    law, see `rmpc_bench.analysis.adjustment`; NaN where there is none
adjusted_form, adjusted_for : form of the adjustment, and names of its quantities with blanks between them
width_ratio : width of the plain interval over that of the adjusted one, of the average that `average` names; inf
    where the draws explain all differences
"""
COLUMNS += ADJUSTED
TEXTS = ("p_wilcoxon_holm", "verdict", "average", "rests_on", "adjusted_form", "adjusted_for")
"""Columns that are empty, and not NaN, where there is nothing to say."""
WHOLE = ["far_worse_runs", "baseline_far_worse_runs", "runs_for_direction", "runs_for_equivalence"]
"""Whole numbers that may be missing: None in the row."""
IN_PAIRS: dict[str, Any] = dict.fromkeys(("won", "lost", "tied", "n_pairs")) | {"p_wilcoxon_holm": ""}
IN_PAIRS |= dict.fromkeys(("superiority", "superiority_low", "superiority_high"), math.nan)
"""Columns that runs without pairs do not have, with the cells that they have then."""
MANY = 1e15
"""Numbers of runs from which on none is given: the average differs from 0 by rounding only."""


class Levels(NamedTuple):
    """Levels of the intervals of an experiment."""

    plain: float
    """Of the metrics that have no verdict."""
    held: float
    """Of each interval of the primary metric: simultaneously they have the level of the experiment."""
    failures: float
    """Of each interval of the difference of the shares of failed runs, as above."""


# Tables and every figure ask for them; the two tables are the trials and their rounded values.
@lru_cache(maxsize=2)
@np.errstate(over="ignore", invalid="ignore")
def levels(trials: Trials) -> Levels:
    """Find levels at which the intervals of the primary metric hold together; those of later looks are higher.

    Without pairs it is that of Bonferroni, which holds although the comparisons share the runs of the baseline.
    """
    whole = unplanned_level(trials.confidence, trials.look)
    runs = np.unique(np.concatenate([point.runs for point in trials.each]))
    columns, n_failing = [], 0
    for point in trials.each:
        info = point.primary_info
        for method in point.methods:
            if method == point.baseline or info is None:
                continue
            pairs = pairs_of(point, method, info)
            n_failing += any(pairs.failed)
            column = np.full(len(runs), np.nan)
            if not trials.unpaired:
                chosen, values = _deciding(point, pairs)
                column[np.searchsorted(runs, chosen)] = values
            columns.append(column)
        if info is not None and (grid := two_way(point, info)) is not None:
            for values in grid.effects.values():
                columns.append(np.full(len(runs), np.nan))
                columns[-1][np.searchsorted(runs, grid.runs)] = values
    held = 1 - (1 - whole) / max(len(columns), 1)
    if columns and not trials.unpaired:
        held = held_level(np.stack(columns, axis=1), whole, trials.seed)
    return Levels(trials.confidence, held, 1 - (1 - whole) / max(n_failing, 1))


def _deciding(point: Trials, pairs: Pairs) -> tuple[Array, Array]:
    """Return runs and the numbers whose mean decides: those of the average, or the scores where counts decide."""
    averages, scores = averages_of(point, pairs), pairs.scores
    if averages and np.count_nonzero(scores[pairs.both]) >= FEW:
        first = next(iter(averages.values()))
        return first.runs, first.values
    return pairs.runs, scores


def averages_of(point: Trials, pairs: Pairs) -> dict[str, Values]:
    """Return the averages that are asked for, adjusted where they can be; the verdict rests on the first one."""
    plain = _averages(point, pairs)
    return plain | _adjusted(point, pairs, plain)


def _adjusted(point: Trials, pairs: Pairs, plain: Mapping[str, Values]) -> dict[str, Values]:
    # Where few pairs differ counts come first, as without an adjustment.
    return {} if pairs.rarely_differ else point.adjustment.adjusted(pairs.runs, pairs.a, pairs.b, plain)


def _averages(point: Trials, pairs: Pairs) -> dict[str, Values]:
    """Return the plain averages that are asked for, the one that the verdict rests on first."""
    found, runs = asked_for(pairs.averages(), point), pairs.runs[pairs.both]
    return {name: pairs.values_of(values, runs) for name, values in found.items()}


@np.errstate(over="ignore", invalid="ignore")
def comparisons(trials: Trials, of: Levels | None = None) -> Rows:
    """Compare every method with the baseline, run by run: a row of `COLUMNS` per metric and method."""
    of = of or levels(trials)
    rows: list[dict[str, Any]] = []
    for info in trials.metrics:
        family = compared(trials, info, of)
        adjusted = holm([signed_rank_p(pairs.ranked()) for pairs, _ in family])
        rows += [row | {"p_wilcoxon_holm": p_text(p)} for (_, row), p in zip(family, adjusted, strict=True)]
    rows = [row | {name: None if math.isnan(row[name]) else int(row[name]) for name in WHOLE} for row in rows]
    return [row | IN_PAIRS for row in rows] if trials.unpaired else rows


@np.errstate(over="ignore", invalid="ignore")
def compared(trials: Trials, info: MetricInfo, of: Levels) -> list[tuple[Pairs, dict[str, Any]]]:
    """Compare every method with the baseline in one metric, without the signed-rank test."""
    methods = [method for method in trials.methods if method != trials.baseline]
    family = [(method, pairs_of(trials, method, info)) for method in methods]
    return [(pairs, _compare(trials, method, info, pairs, of)) for method, pairs in family]


def _compare(trials: Trials, method: str, info: MetricInfo, pairs: Pairs, of: Levels) -> dict[str, Any]:
    is_primary = info == trials.primary_info and trials.with_verdicts
    level = of.held if is_primary else of.plain
    plain, scores = _averages(trials, pairs), pairs.scores
    averages = plain | _adjusted(trials, pairs, plain)
    counts = counts_of(scores)
    of_plain = _intervals(trials, plain, level)
    intervals = of_plain | _intervals(
        trials, {name: averages[name] for name in averages if averages[name].basis}, level
    )
    n, of_failures = len(scores), of.failures if is_primary else of.plain
    failed = shares_interval(*pairs.failed, n, of_failures)
    if trials.unpaired:
        failed = independent_shares(pairs.failed, (n, n), of_failures)
    word, planning, evidence = "", {}, _evidence(pairs, intervals, scores, level)
    if is_primary:
        failures = None
        if any(pairs.failed):
            counted = pairs.counted(worst_finished(trials, info))
            of_counted = _intervals(trials, averages_of(trials, counted), level)
            failures = Failures(*pairs.failed, failed, _evidence(counted, of_counted, scores, level))
        word = verdict(evidence, failures)
        if word == Verdict.FAILS_MORE or word == verdict(evidence):
            first = next((each.values for each in averages.values()), scores)
            planning = _planning(first, pairs, averages, word, level)
        planning |= {} if trials.unpaired else _far_worse_columns(pairs, trials.lost or FACTOR)
    return {
        **dict.fromkeys(COLUMNS, math.nan),
        **dict.fromkeys(TEXTS, ""),
        "method": method,
        "baseline": trials.baseline,
        "metric": info.name,
        **_named(("won", "lost", "tied"), counts),
        "superiority": superiority(*counts),
        "n_pairs": int(pairs.both.sum()),
        "verdict": str(word),
        "average": next(iter(averages), ""),
        "ci_level": level,
        **_named(("superiority_low", "superiority_high"), superiority_interval(*counts, level)),
        **_named(("failed_only", "baseline_failed_only"), pairs.failed),
        **_named(("failed_low", "failed_high"), failed),
        "look": trials.look,
        **_sizes(plain, {} if pairs.rarely_differ else of_plain, pairs.scale(), adjusted=False),
        **_adjusted_columns(pairs, averages, intervals, of_plain),
        "rests_on": _rests_on(trials, pairs, averages, evidence),
        **planning,
    }


def _named(names: Sequence[str], cells: Iterable[Any]) -> dict[str, Any]:
    return dict(zip(names, cells, strict=True))


def _far_worse_columns(pairs: Pairs, factor: float) -> dict[str, float]:
    """Return the runs of method and baseline that failed or are far worse, and the bounds of their shares."""
    found: dict[str, float] = {}
    for name, k in zip(("far_worse", "baseline_far_worse"), pairs.far_worse(factor), strict=True):
        found |= {f"{name}_runs": k, f"{name}_upper": largest_share(k, len(pairs.a))}
    return found


def _intervals(trials: Trials, averages: Mapping[str, Values], level: float) -> dict[str, Interval]:
    return {name: each.interval(name, level, trials.seed) for name, each in averages.items()}


def _rests_on(trials: Trials, pairs: Pairs, averages: Mapping[str, Values], evidence: Evidence) -> str:
    if trials.adjust == "none":
        return ""
    if not averages or pairs.rarely_differ or counts_decide(evidence):
        return "counts"
    return "plain" if next(iter(averages.values())).basis is None else "adjusted"


def _adjusted_columns(
    pairs: Pairs, averages: Mapping[str, Values], intervals: Mapping[str, Interval], plain: Mapping[str, Interval]
) -> dict[str, Any]:
    """Return the adjusted averages and, where the first one is adjusted, form, quantities and gain."""
    found: dict[str, Any] = _sizes(averages, intervals, pairs.scale(), adjusted=True)
    name, first = next(iter(averages.items()), ("", None))
    if first is None or first.basis is None:
        return found
    width, of_plain = (float(np.ptp(ends[name])) for ends in (intervals, plain))
    ratio = of_plain / width if width > NEGLIGIBLE * of_plain else math.inf if of_plain else 1.0
    quantities = " ".join(quantity.name for quantity in first.basis.quantities)
    return found | _named(ADJUSTED[-3:], (first.basis.form, quantities, significant(ratio, 3)))


def _evidence(pairs: Pairs, intervals: Mapping[str, tuple[float, float]], scores: Array, level: float) -> Evidence:
    """Collect the numbers from which the verdict follows, where negative differences are better."""
    scale = pairs.scale()
    # Digits that another CPU does not reproduce must not decide.
    found = [(without_noise(low, scale), without_noise(high, scale)) for low, high in intervals.values()]
    ends = [(-high, -low) if pairs.higher else (low, high) for low, high in found]
    return Evidence(
        interval=ends[0] if ends else NONE,
        margin=pairs.margin,
        n_pairs=int(pairs.both.sum()),
        n_untied=int(np.count_nonzero(pairs.scores[pairs.both])),
        superiority=superiority_interval(*counts_of(scores), level),
        other=ends[1] if len(ends) > 1 else NONE,
    )


def counts_of(scores: Array) -> tuple[int, int, int]:
    """Count the runs won, lost and tied."""
    won, lost = int(np.count_nonzero(scores > 0)), int(np.count_nonzero(scores < 0))
    return won, lost, len(scores) - won - lost


def _sizes(
    averages: Mapping[str, Values], intervals: Mapping[str, Interval], scale: float, *, adjusted: bool
) -> dict[str, Any]:
    """Return the averages, or the adjusted ones, with intervals: in per cent, or in the unit of a signed metric."""
    found: dict[str, Any] = {}
    for n, (name, each) in enumerate(averages.items()):
        if adjusted and each.basis is None:
            continue
        ends, stem = (float(each.values.mean()), *intervals.get(name, NONE)), f"{name}{'_adjusted' * adjusted}"
        if name == "difference":
            names = (stem, f"{stem}_low", f"{stem}_high")
            found |= _named(names, (without_noise(end, scale) for end in ends))
            continue
        per_cent = [float(100 * np.expm1(end)) for end in ends]
        found |= _named((f"{stem}_pct", f"{stem}_low", f"{stem}_high"), per_cent)
        if n == 0:
            found |= _named(("change_pct", "ci_low", "ci_high"), per_cent)
    return found


def _planning(
    values: Array, pairs: Pairs, averages: Mapping[str, Values], word: Verdict, level: float
) -> dict[str, float]:
    """Return about how many runs would decide, from the numbers whose mean decides now."""
    sd, n_runs = float(np.std(values, ddof=1)) if len(values) > 1 else math.nan, len(pairs.runs)
    if averages and next(iter(averages.values())).unpaired:
        # The values are those of the runs of both methods.
        sd *= math.sqrt(n_runs / len(values))
    found = {"runs_for_equivalence": runs_for_equivalence(sd, pairs.margin, level) if averages else math.nan}
    if word != Verdict.INCONCLUSIVE:
        return found
    found["runs_for_direction"] = runs_for_direction(float(values.mean()), sd, level) if len(values) else math.nan
    untied = int(np.count_nonzero(pairs.scores[pairs.both]))
    if untied < FEW:
        # Fewer runs may decide by count; an average decides from `FEW` untied runs on, equivalence needs `FEW` pairs.
        least = math.ceil(FEW * n_runs / untied) if averages and untied else 0
        found["runs_for_equivalence"] = float(np.maximum(found["runs_for_equivalence"], FEW))
        found["runs_for_direction"] = float(np.maximum(found["runs_for_direction"], least))
        if not math.isnan(by_count := runs_for_count(*counts_of(pairs.scores), level)):
            found = {"runs_for_equivalence": math.nan, "runs_for_direction": by_count}
    # The runs at hand did not decide, for another reason than the spread; no such number of runs is given.
    return {name: n if n_runs < n < MANY else math.nan for name, n in found.items()}


def p_text(p: float) -> str:
    """Write a p value with three decimals, at most ``< 0.001``; empty for NaN."""
    if math.isnan(p):
        return ""
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
