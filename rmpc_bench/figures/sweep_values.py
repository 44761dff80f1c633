"""Values of a metric at the points of a sweep, or its paired changes against the baseline, with their spreads."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

from rmpc_bench.analysis.comparison_text import AVERAGE_WORDS
from rmpc_bench.figures.paired import band_of, changes_of
from rmpc_bench.types import DesignError, MetricInfo

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

Content: TypeAlias = Literal["value", "change"]
SpreadKind: TypeAlias = Literal["quartiles", "se", "interval"]
COLUMNS = {"quartiles": ("q25", "median", "q75"), "interval": ("ci_low", "mean", "ci_high")}
"""Spread -> its columns in summary.csv."""


class PointValue(NamedTuple):
    """A number of a method at a point of the sweep; all NaN where there is none."""

    low: float
    middle: float
    high: float
    n: int
    """Runs, or pairs of runs, that it rests on."""
    n_failed: int
    """Runs that are left out: the method failed, or of a change one of the two failed or is not computed."""

    @property
    def has_zero(self) -> bool:
        """Whether its interval contains 0, or is not known."""
        return not (self.low > 0 or self.high < 0)


NO_VALUE = PointValue(math.nan, math.nan, math.nan, 0, 0)


class SweepValues(NamedTuple):
    """Values of all points that a figure shows."""

    rows: Sequence[Mapping[str, PointValue]]
    """Of every point: method -> value."""
    methods: tuple[str, ...]
    kind: str
    """Average of a change, see `AVERAGE_WORDS`; empty for values of the metric."""
    unit: str
    margin: tuple[float, float]
    """Ends of the margin of relevance, in `unit`; both 0 without one."""
    simultaneous: bool
    """Whether the intervals hold all together."""


def values_of(points: Sequence[Trials], info: MetricInfo, methods: Sequence[str], spread: SpreadKind) -> SweepValues:
    """Describe a metric at every point, with the numbers of summary.csv.

    Spreads are quartiles about the median, or a standard error or the interval of the experiment about the mean.
    """
    from rmpc_bench.analysis.statistics import summary

    rows = []
    for point in points:
        table = summary(replace(point, metrics=(info,))).set_index("method")
        found = {}
        for name in methods:
            if name not in table.index:
                continue
            row = table.loc[name]
            if spread == "se":
                low, middle, high = row["mean"] - row["se"], row["mean"], row["mean"] + row["se"]
            else:
                low, middle, high = (row[column] for column in COLUMNS[spread])
            found[name] = PointValue(float(low), float(middle), float(high), int(row["n"]), int(row["n_failed"]))
        rows.append(found)
    return SweepValues(rows, tuple(methods), "", info.unit, (0.0, 0.0), simultaneous=False)


def changes_at(results: Trials, points: Sequence[Trials], info: MetricInfo, order: Sequence[str] | None) -> SweepValues:
    """Compare methods with the baseline at every point, with the numbers of comparisons.csv.

    The levels of simultaneous intervals follow from the results of the whole sweep.  Raises a DesignError when no
    method is left to compare, or the metric has no average change at any point.
    """
    from rmpc_bench.analysis.comparison import levels

    methods = [name for name in order or results.methods if name != results.baseline]
    if not methods:
        raise DesignError(f"must name a method besides the baseline '{results.baseline}'", "order")
    of = levels(results)
    found = []
    for point in points:
        there = [name for name in methods if name in point.methods and results.baseline in point.methods]
        found.append((point, changes_of(point, info, there, of) if there else []))
    firsts = [each.averages[0] for _, changes in found for each in changes if each.averages]
    if not firsts:
        text = f"{info.name} has no average change, since it does not occur in some runs: show its value, or `paired`"
        raise DesignError(text, "metric")
    kind = "difference" if any(each.kind == "difference" for each in firsts) else firsts[0].kind
    rows = []
    for point, changes in found:
        row = {}
        for each in changes:
            average = next((one for one in each.averages if one.kind == kind), None)
            n_left_out = len(point.runs) - each.n_pairs
            row[each.method] = NO_VALUE._replace(n=each.n_pairs, n_failed=n_left_out)
            if average is not None:
                row[each.method] = PointValue(average.low, average.value, average.high, each.n_pairs, n_left_out)
        rows.append(row)
    unit, margin = info.unit if kind == "difference" else "%", band_of(points[0], info, kind)
    together = any(each.simultaneous for _, changes in found for each in changes)
    return SweepValues(rows, tuple(methods), kind, unit, margin, together)


def change_label(trials: Trials, info: MetricInfo, kind: str) -> str:
    """Name a change, such as ``change of MSE against S-MPC``, without its unit."""
    from rmpc_bench.analysis.pairs import name_of_distance

    word, link = ("difference", "from") if kind == "difference" else ("change", "against")
    return (
        f"{word} of {name_of_distance(info, info.words)} {link} {trials.labels.get(trials.baseline, trials.baseline)}"
    )


def interval_words(trials: Trials, values: SweepValues) -> str:
    """Name the intervals of changes, such as ``simultaneous 95 % intervals``."""
    return f"{'simultaneous ' * values.simultaneous}{100 * trials.confidence:g} % intervals"


def average_words(kind: str) -> str:
    """Name an average of changes."""
    return AVERAGE_WORDS[kind]


def runs_words(values: SweepValues, noun: str = "run") -> str:
    """Count the runs of every value, as a range where they differ, and those that are left out in total."""
    counts = [value.n for row in values.rows for value in row.values()]
    least, most = min(counts, default=0), max(counts, default=0)
    text = f"{least} to {most} {noun}s" if least < most else f"{most} {noun}{'s' * (most != 1)}"
    failed = sum(value.n_failed for row in values.rows for value in row.values())
    # A pair is left out where a run of the two is missing, and a failed run of the baseline in every comparison.
    return f"{text}, {failed} {'left out' if values.kind else 'failed'} in total" if failed else text
