"""One record per method, metric and point, from which page, screen, figures, Markdown and LaTeX are written.

A verdict has five words here; comparisons.csv keeps its codes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from rmpc_bench.analysis.columns import Rows
from rmpc_bench.analysis.comparison_text import AVERAGE_WORDS, UNPAIRED, change_of, margin_of, plain_change_of
from rmpc_bench.analysis.intervals import quantiles
from rmpc_bench.analysis.pairs import distance_from_best, name_of_distance
from rmpc_bench.analysis.shown_numbers import (
    Estimate,
    change_texts,
    difference_texts,
    is_per_cent,
    mean_text,
    number,
    short,
)
from rmpc_bench.analysis.statistics import NUMBERS
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.verdict import Verdict
from rmpc_bench.types import MetricInfo

__all__ = ["WORDS", "ResultRow", "ResultTable", "in_one_form", "result_table"]

WORDS = {
    Verdict.BETTER: "better",
    Verdict.BETTER_SIZE_UNCERTAIN: "better",
    Verdict.WORSE: "worse",
    Verdict.WORSE_SIZE_UNCERTAIN: "worse",
    Verdict.EQUIVALENT: "equivalent",
    Verdict.INCONCLUSIVE: "inconclusive",
    Verdict.DEPENDS_ON_AVERAGE: "inconclusive",
    Verdict.FAILS_MORE: "fails more",
}
"""Verdict -> the word that a reader sees."""
BETTER, WORSE, EQUIVALENT, INCONCLUSIVE, FAILS_MORE = "better", "worse", "equivalent", "inconclusive", "fails more"
BASELINE, NOT_COMPUTED = "baseline", "not computed"
MARKS = {INCONCLUSIVE: "?", EQUIVALENT: "\u2248", FAILS_MORE: "!"}
"""Word -> its mark in a cell of a matrix."""
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of the runs that are drawn."""
MOST_UNSORTED = 6
"""Methods up to which rows keep the order of the configuration; more are sorted by their change."""
Form = Literal["ratio", "difference", "share", "alone"]
"""What compares the rows of a table: changes in per cent, differences in a unit, shares of the runs, or nothing."""


class ResultRow(NamedTuple):
    """A method in one metric."""

    method: str
    """Its key, which is its name everywhere."""
    label: str
    """Its label, empty where it is the key."""
    is_baseline: bool
    is_oracle: bool
    """An oracle is never the best and in no count."""
    n: int
    """Runs that have a value; those without the event count."""
    n_failed: int
    mean: Estimate
    quantiles: tuple[float, ...]
    """5 %, quartiles and 95 % of the finished runs; inf where the event did not occur, empty without runs."""
    n_occurred: int
    """Runs with a finite value."""
    worst: float
    change: Estimate
    """Change against the baseline in per cent, or difference in the unit of the metric."""
    superiority: Estimate
    """Share of the runs in which the method is better, ties half, in per cent."""
    word: str
    """Verdict in a word; ``baseline``, ``not computed``, or empty without a verdict."""
    remark: str
    """Stands behind the word: what is uncertain, or how many runs failed."""
    compared: Mapping[str, Any]
    """The row of comparisons.csv; empty for the baseline."""
    described: Mapping[str, Any]
    """The row of summary.csv, from which a column takes any number of `statistics.SUMMARY`."""

    @property
    def is_sized(self) -> bool:
        """Whether the interval of the change excludes 0, or there is none; a verdict by counts does not rest on it."""
        return not _contains_0(self.change)

    @property
    def plain(self) -> Estimate:
        """The change without an adjustment; NaN where there is none."""
        return plain_change_of(self.compared)

    @property
    def is_adjusted(self) -> bool:
        """Whether the change is adjusted for draws of known law."""
        return not math.isnan(self.plain.value)

    @property
    def counts(self) -> str:
        """Runs won, lost and tied; empty for the baseline, and without pairs."""
        return "{won}/{lost}/{tied}".format(**self.compared) if self.compared.get("n_pairs") is not None else ""


class ResultTable(NamedTuple):
    """The rows of one metric at one point, in the order of the configuration."""

    trials: Trials
    info: MetricInfo
    rows: Sequence[ResultRow]
    form: Form
    may_not_occur: bool  # whether the metric measures an event that did not occur in some run, or could

    @property
    def baseline(self) -> str:
        """Name of the baseline."""
        return self.trials.baseline

    @property
    def margin(self) -> float:
        """Smallest difference that matters: relative, or in the unit of the metric."""
        default = 0.0 if self.form == "difference" else None
        return self.trials.relevant_of(self.info.name, default=default)

    @property
    def margin_text(self) -> str:
        """The margin with its unit."""
        return margin_of(self.trials, self.info, signed=self.form == "difference")

    @property
    def average(self) -> str:
        """What a change is an average of, in words; empty where nothing is averaged."""
        return (UNPAIRED if self.trials.unpaired else AVERAGE_WORDS).get(self.average_key, "")

    @property
    def average_key(self) -> str:
        """The same as comparisons.csv names it, such as ``geometric``."""
        return next((str(row.compared["average"]) for row in self.rows if row.compared and row.compared["average"]), "")

    @property
    def quantity(self) -> str:
        """What is compared, in words, such as ``|settling time|``."""
        return name_of_distance(self.info, self.info.words)

    @property
    def quantity_with_unit(self) -> str:
        """The same with the unit in brackets."""
        return f"{self.quantity} [{self.info.unit}]" if self.info.unit else self.quantity

    @property
    def mean_word(self) -> str:
        """What stands for a method at a point of a sweep: its mean, or in how many runs the event occurred."""
        return "occurred" if self.may_not_occur else "mean"

    @property
    def ordered(self) -> list[ResultRow]:
        """Rows as they are shown: up to 6 methods as configured, more by their change; an oracle is last."""
        if len(self.rows) <= MOST_UNSORTED:
            return sorted(self.rows, key=lambda row: row.is_oracle)
        return sorted(self.rows, key=lambda row: (row.is_oracle, math.isnan(self.rank(row)), self.rank(row)))

    @property
    def compared(self) -> list[ResultRow]:
        """Rows that count: all but baseline and oracles."""
        return [row for row in self.rows if not (row.is_baseline or row.is_oracle)]

    @property
    def best(self) -> ResultRow | None:
        """The compared row with the best change; None without one."""
        rows = [row for row in self.compared if not math.isnan(self.rank(row))]
        return min(rows, key=self.rank, default=None)

    def row_of(self, method: str) -> ResultRow | None:
        """Return the row of a method."""
        return next((row for row in self.rows if row.method == method), None)

    def rank(self, row: ResultRow) -> float:
        """Return the number by which rows are sorted, a better one first; that of the baseline is no change."""
        if self.form == "share":
            return 50.0 if row.is_baseline else 100 - row.superiority.value
        if row.is_baseline:
            return 0.0
        return -row.change.value if self.info.direction == "higher" else row.change.value

    def mean_text(self, row: ResultRow) -> str:
        """Write the mean with half its interval, or in how many runs the event occurred and its median."""
        if not row.n:
            return ""
        if not self.may_not_occur:
            return mean_text(row.mean)
        median = f"; {short(row.quantiles[2]) if math.isfinite(row.quantiles[2]) else '-'}" if row.n_occurred else ""
        return f"{row.n_occurred} of {row.n}{median}"

    def change_texts(self, row: ResultRow, *, mirrored: bool = False) -> tuple[str, str]:
        """Write the change, or what takes its place, and its interval; empty for the baseline."""
        if row.is_baseline:
            return "", ""
        if self.form == "share":
            value, low, high = (number(each, 0) for each in row.superiority)
            return (f"{value} %", f"[{low}, {high}]") if row.compared else ("", "")
        if self.form == "difference":
            return difference_texts(row.change, self.info.unit, mirrored=mirrored)
        return change_texts(row.change, mirrored=mirrored)

    def short_change(self, row: ResultRow) -> str:
        """Write the change of a cell: in whole per cent or as a factor, with a mark where it is not better or worse.

        A row without a finished run is ``failed``, or empty if it is not computed; one without a change has its word.
        """
        if not row.n:
            return "failed" if row.n_failed else ""
        text = self.change_texts(row)[0]
        if not text:
            return row.word
        if self.form == "ratio" and not math.isnan(row.change.value) and is_per_cent(row.change):
            text = f"{number(row.change.value, 0, sign=True)} %"
        return f"{text} {MARKS.get(row.word, '')}".strip()

    def change_text(self, row: ResultRow) -> str:
        """Write the change with its interval in one text."""
        return " ".join(filter(None, self.change_texts(row)))


def result_table(trials: Trials, described: Rows, compared: Rows, info: MetricInfo) -> ResultTable:
    """Collect the rows of one metric at one point, from those of `statistics.summary` and `comparison.comparisons`."""
    of_summary = {row["method"]: row for row in described if row["metric"] == info.name}
    of_pairs = {row["method"]: row for row in compared if row["metric"] == info.name}
    may_not_occur = info.may_not_occur or any(row["did_not_occur"] for row in of_summary.values())
    rows = [_row(trials, info, name, of_summary.get(name, _NONE), of_pairs.get(name, {})) for name in _names(trials)]
    # Without pairs there is no share of the runs.
    return ResultTable(trials, info, rows, _form(of_pairs, "alone" if trials.unpaired else "share"), may_not_occur)


def in_one_form(tables: Sequence[ResultTable]) -> list[ResultTable]:
    """Give the points of a sweep one form: that of all with two methods, else shares of the runs, which always exist.

    A point whose baseline, or whose other methods, have no finished run has no changes and no say.
    """
    known = [t for t in tables if t.form != "alone" and {True, False} <= {row.is_baseline for row in t.rows if row.n}]
    forms: set[Form] = {table.form for table in known} or {table.form for table in tables} - {"alone"}
    form: Form = forms.pop() if len(forms) == 1 else "share"
    return [table if table.form == "alone" else table._replace(form=form) for table in tables]


_NONE = {"n": 0, "n_failed": 0, "did_not_occur": 0, **dict.fromkeys(NUMBERS, math.nan)}
"""Row of summary.csv of a method that is not computed."""


def _names(trials: Trials) -> list[str]:
    """Return the methods of a table, with those that are not computed unless it shows some of the methods only."""
    if not len(trials.runs) or not {*trials.columns["method"].tolist()} <= {*trials.methods}:
        return [*trials.methods]
    known = [name for name in trials.all_methods if name in trials.methods]
    if known == [*trials.methods]:
        return [*trials.all_methods]
    return [*trials.methods, *(name for name in trials.all_methods if name not in trials.methods)]


def _form(compared: Mapping[str, Mapping[str, Any]], without_average: Form) -> Form:
    averages = {str(row["average"]) for row in compared.values()}
    if not averages:
        return "alone"
    if averages == {""}:
        return without_average
    return "difference" if "difference" in averages else "ratio"


def _row(
    trials: Trials, info: MetricInfo, method: str, described: Mapping[str, Any], compared: Mapping[str, Any]
) -> ResultRow:
    values = trials.column(info.name, method)
    values = values[~np.isnan(values)]
    finite = values[np.isfinite(values)]
    label = trials.labels.get(method, method)
    word, remark = _word(trials, info, method, described, compared)
    far = distance_from_best(-values if info.direction == "higher" else values, info.direction)
    worst = values[far.argmax()] if len(values) else math.nan
    return ResultRow(
        method=method,
        label="" if label == method else label,
        is_baseline=method == trials.baseline,
        is_oracle=method in trials.oracles,
        n=len(values),
        n_failed=int(described["n_failed"]),
        mean=Estimate(described["mean"], described["ci_low"], described["ci_high"]),
        quantiles=tuple(map(float, quantiles(values, [*LEVELS]))) if len(values) else (),
        n_occurred=len(finite),
        worst=float(worst),
        change=change_of(compared) if compared else Estimate(),
        superiority=Estimate(*(100 * float(compared[name]) for name in _SUPERIORITY)) if compared else Estimate(),
        word=word,
        remark=remark,
        compared=compared,
        described=described,
    )


_SUPERIORITY = ("superiority", "superiority_low", "superiority_high")


def _contains_0(change: Estimate) -> bool:
    """Whether the interval of a change contains 0."""
    return change.low <= 0 <= change.high


def _word(
    trials: Trials, info: MetricInfo, method: str, described: Mapping[str, Any], compared: Mapping[str, Any]
) -> tuple[str, str]:
    """Return the word of a row and the remark behind it."""
    n_failed = int(described["n_failed"])
    n = int(described["n"]) + n_failed
    if not n:
        return NOT_COMPUTED, ""
    lost = f"{n_failed} of {n} failed" if n_failed else ""
    if not trials.with_verdicts:
        return ("failed" if n_failed else "ran"), lost
    if method == trials.baseline:
        return BASELINE, lost
    code = str(compared.get("verdict", ""))
    if not code:
        return "", lost
    remark = ""
    if code.endswith("size-uncertain"):
        remark = f"perhaps by less than {margin_of(trials, info, signed=compared['average'] == 'difference')}"
    elif code in (Verdict.BETTER, Verdict.WORSE) and _contains_0(change_of(compared)):
        remark = "by counts of the runs"
    elif code == Verdict.DEPENDS_ON_AVERAGE:
        remark = "averages disagree"
    return WORDS[Verdict(code)], ", ".join(filter(None, [remark, lost]))
