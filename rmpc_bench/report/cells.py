"""Cells of the tables of one metric, for the screen and for Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from rmpc_bench.analysis.comparison_text import margin_text, size_text, verdict_text
from rmpc_bench.analysis.number_text import decimals, median_text, with_error
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import marked
from rmpc_bench.types import MetricInfo


class Line(NamedTuple):
    """A method in the table of one metric, with its row of the summary and, but for the baseline, of comparisons."""

    method: str
    shown: str
    described: Mapping[str, Any]
    compared: Mapping[str, Any] | None


class MetricTable(NamedTuple):
    """The rows of one metric, and which columns they need."""

    trials: Trials
    info: MetricInfo
    lines: Sequence[Line]
    may_not_occur: bool
    with_comparisons: bool
    with_failed: bool


def metric_table(trials: Trials, summary: pd.DataFrame, comparisons: pd.DataFrame, info: MetricInfo) -> MetricTable:
    """Collect the rows of one metric from tables of `analysis.statistics` and `analysis.comparison`."""
    described = {row["method"]: row for row in summary[summary["metric"] == info.name].to_dict("records")}
    compared = {row["method"]: row for row in comparisons[comparisons["metric"] == info.name].to_dict("records")}
    return MetricTable(
        trials,
        info,
        [Line(method, marked(trials, method), described[method], compared.get(method)) for method in trials.methods],
        info.may_not_occur or any(row["did_not_occur"] for row in described.values()),
        bool(compared),
        any(row["n_failed"] for row in described.values()),
    )


def means(table: MetricTable) -> list[str]:
    """Mean with its standard error, or the share of runs without the event."""
    return [_mean(line.described, table.may_not_occur) for line in table.lines]


def _mean(row: Mapping[str, Any], may_not_occur: bool) -> str:
    if not may_not_occur:
        return with_error(float(row["mean"]), float(row["se"]))
    return f"{row['did_not_occur']}/{row['n']} ({100 * row['did_not_occur'] / row['n']:.3g} %)" if row["n"] else "-"


def medians(table: MetricTable) -> list[str]:
    """Median and quartiles."""
    rows = [line.described for line in table.lines]
    return [median_text(row["median"], row["q25"], row["q75"], int(row["n"])) for row in rows]


def average_of(table: MetricTable) -> str:
    """Name the average that the column of changes has: that of the first comparison with one; empty without."""
    found = (str(line.compared["average"]) for line in table.lines if line.compared)
    return next((average for average in found if average), "")


def changes(table: MetricTable, average: str = "") -> list[str]:
    """Average difference from the baseline with its interval; that of the verdict if no average is named."""
    return [size_text(line.compared, table.info, average) if line.compared else "-" for line in table.lines]


def other_average(table: MetricTable) -> str:
    """Name the second average that was computed; empty where there is none."""
    other = {"geometric": "mean", "mean": "geometric"}.get(average_of(table), "")
    rows = [line.compared for line in table.lines if line.compared]
    return other if other and any(not math.isnan(row[f"{other}_pct"]) for row in rows) else ""


def counts(table: MetricTable) -> list[str]:
    """Runs won, lost and tied."""
    rows = [line.compared for line in table.lines]
    return [f"{row['won']}/{row['lost']}/{row['tied']}" if row else "-" for row in rows]


def superiorities(table: MetricTable) -> list[str]:
    """Share of the runs in which the method is better, with its interval."""
    return [_superiority(line.compared) for line in table.lines]


def _superiority(row: Mapping[str, Any] | None) -> str:
    if row is None or math.isnan(row["superiority"]):
        return "-"
    share, low, high = (100 * float(row[name]) for name in ("superiority", "superiority_low", "superiority_high"))
    places = decimals((high - low) / 2)
    return f"{share:.{places}f} % [{low:.{places}f}, {high:.{places}f}]"


def p_values(table: MetricTable) -> list[str]:
    """Signed-rank p after Holm."""
    return [(line.compared["p_wilcoxon_holm"] if line.compared else "") or "-" for line in table.lines]


def verdicts(table: MetricTable) -> list[str]:
    """Verdicts in words; empty for the baseline and where there is none."""
    found = []
    for line in table.lines:
        row = line.compared
        found.append(verdict_text(row, margin_text(table.trials, table.info, row)) if row else "")
    return found


def sizes(table: MetricTable) -> list[str]:
    """Runs finished and failed."""
    return [f"{line.described['n']}/{line.described['n_failed']}" for line in table.lines]


def pairs(table: MetricTable) -> list[str]:
    """Runs that a comparison rests on."""
    return [str(line.compared["n_pairs"]) if line.compared else "-" for line in table.lines]
