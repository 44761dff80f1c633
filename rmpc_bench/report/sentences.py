"""Comparisons in words: the verdict with its numbers, and one sentence per comparison that can be quoted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.verdict import Verdict
from rmpc_bench.types import MetricInfo

AVERAGES = {"geometric": "geometric mean of the paired ratios", "mean": "ratio of the means"}
"""What a change in per cent is an average of."""

MOST_RUNS = 1e6
"""Runs beyond which a number of runs that would decide is not given."""


def size_text(row: Mapping[str, Any], info: MetricInfo, average: str = "") -> str:
    """Write the average difference of a comparison with its interval.

    Parameters
    ----------
    row : a row of `comparison.comparisons`
    info : the metric of the row
    average : ``geometric`` or ``mean``; the one that the verdict rests on if empty

    Returns
    -------
    such as "-10.2 % [-11.3, -9.0]", or a difference in the unit of a signed metric; "-" where there is none
    """
    if row["average"] == "difference":
        names, unit = ("difference", "difference_low", "difference_high"), info.unit
    elif average:
        names, unit = (f"{average}_pct", f"{average}_low", f"{average}_high"), "%"
    else:
        names, unit = ("change_pct", "ci_low", "ci_high"), "%"
    return interval_text(*(float(row[name]) for name in names), unit=unit)


def contradicting(row: Mapping[str, Any]) -> bool:
    """Whether geometric mean and ratio of the means have opposite signs."""
    return float(row["geometric_pct"]) * float(row["mean_pct"]) < 0


def verdict_text(row: Mapping[str, Any], margin: str) -> str:
    """Write a verdict in words, with the numbers that it needs.

    Parameters
    ----------
    row : a row of `comparison.comparisons`
    margin : the smallest relevant difference as text, such as "1 %"

    Returns
    -------
    such as "equivalent (within 1 %)"; empty where there is no verdict
    """
    word = str(row["verdict"])
    if word == Verdict.FAILS_MORE:
        alone = row["failed_only"]
        return f"fails more (alone in {alone} runs, {row['baseline']} alone in {row['baseline_failed_only']})"
    if word == Verdict.EQUIVALENT:
        return f"equivalent (within {margin})"
    if word == Verdict.INCONCLUSIVE:
        return _inconclusive(row)
    return {
        str(Verdict.BETTER_SIZE_UNCERTAIN): "better, size uncertain",
        str(Verdict.WORSE_SIZE_UNCERTAIN): "worse, size uncertain",
        str(Verdict.DEPENDS_ON_AVERAGE): "depends on the average",
    }.get(word, word)


def _inconclusive(row: Mapping[str, Any]) -> str:
    """Name about how many runs would decide, for each word."""
    numbers = [
        (row["runs_for_direction"], "better or worse"),
        (row["runs_for_equivalence"], "equivalent"),
    ]
    known = [f"{_about(n)} for {word}" for n, word in numbers if not pd.isna(n)]
    return f"inconclusive (runs needed: {', '.join(known)})" if known else "inconclusive"


def _about(runs: float) -> str:
    """Write a number of runs with two digits, as it is an estimate."""
    number = float(runs)
    if number >= MOST_RUNS:
        return f"more than {MOST_RUNS:.0f}"
    digits = max(0, math.floor(math.log10(max(number, 1))) - 1)
    return f"about {math.ceil(number / 10**digits) * 10**digits:.0f}"


def margin_text(trials: Trials, info: MetricInfo, row: Mapping[str, Any] | None = None) -> str:
    """Write the smallest relevant difference of a metric: in per cent, or in the unit of a signed metric."""
    signed = row is not None and row["average"] == "difference"
    if signed:
        return f"{trials.relevant_of(info.name, default=0.0):g} {info.unit}".strip()
    return f"{100 * trials.relevant_of(info.name):g} %"


def sentence(row: Mapping[str, Any], info: MetricInfo, trials: Trials) -> str:
    """Say one comparison in one sentence that can be pasted into a paper.

    Parameters
    ----------
    row : a row of `comparison.comparisons`
    info : the metric of the row
    trials : the table that was compared

    Returns
    -------
    such as "R-MPC1 lowers mse by 10.9 % [9.7, 12.1] against S-MPC (geometric mean of the ratios, 200 paired
    runs, 95 % interval; won 162, lost 0, tied 38): better."
    """
    method, baseline, name = row["method"], row["baseline"], name_of_distance(info)
    word = verdict_text(row, margin_text(trials, info, row))
    counts = f"won {row['won']}, lost {row['lost']}, tied {row['tied']}"
    n = int(row["n_pairs"])
    pairs = f"{n} paired {'run' if n == 1 else 'runs'}"
    changed = _changed(row, info)
    if not changed:
        text = f"{method} against {baseline} in {name} ({pairs}; {counts})"
    else:
        simultaneous = "simultaneous " if word and row["ci_level"] > trials.confidence else ""
        level = f"{simultaneous}{100 * trials.confidence:g} % interval"
        text = f"{method} {changed} against {baseline} ({_average(row)}, {pairs}, {level}; {counts})"
    if word and contradicting(row):
        other = "mean" if row["average"] == "geometric" else "geometric"
        text += f"; the {AVERAGES[other]} changes by {size_text(row, info, other)}"
    failed = _failed(row)
    return f"{text}{failed}{': ' + word if word else ''}."


def _changed(row: Mapping[str, Any], info: MetricInfo) -> str:
    """Write verb, metric and size; empty where there is no size."""
    size = size_text(row, info)
    if size == "-":
        return ""
    name = name_of_distance(info)
    value = float(row["difference"] if row["average"] == "difference" else row["change_pct"])
    if "[" not in size:
        return f"changes {name} by {size}, without an interval"
    low, high = ("difference_low", "difference_high") if row["average"] == "difference" else ("ci_low", "ci_high")
    if row[low] <= 0 <= row[high] or value == 0:
        return f"changes {name} by {size}"
    if value > 0:
        return f"raises {name} by {size.replace('+', '')}"
    return f"lowers {name} by {_mirrored(row, info)}"


def _mirrored(row: Mapping[str, Any], info: MetricInfo) -> str:
    """Write a reduction as a positive number, the ends of its interval in order."""
    signed = row["average"] == "difference"
    names = ("difference", "difference_high", "difference_low") if signed else ("change_pct", "ci_high", "ci_low")
    value, low, high = (-float(row[name]) for name in names)
    return interval_text(value, low, high, unit=info.unit if signed else "%", sign=False)


def _average(row: Mapping[str, Any]) -> str:
    return {"geometric": "geometric mean of the ratios", "mean": "ratio of the means", "difference": "mean difference"}[
        str(row["average"])
    ]


def _failed(row: Mapping[str, Any]) -> str:
    """Say in which runs one of the two failed; empty where none did."""
    counts = ((row["method"], row["failed_only"]), (row["baseline"], row["baseline_failed_only"]))
    texts = [f"{name} alone failed in {n}" for name, n in counts if n]
    return f"; {', '.join(texts)}" if texts else ""


def explanation(trials: Trials) -> str:
    """Say how the columns of a comparison are computed."""
    return (
        f"Runs are paired with those of {trials.baseline}; a failed run is worse than any finished one, and averages "
        f"rest on the runs that both finished. Change: {AVERAGES[trials.headline]}. Tied: within "
        f"{100 * trials.relevant:g} %. Superiority: share of the runs in which the method is better, tied ones half. "
        "p: Wilcoxon signed-rank, after Holm. Verdicts: for the primary metric only, from simultaneous "
        "intervals for all methods and points."
    )
