"""Comparisons in words: the verdict with its numbers, and one sentence per comparison that can be quoted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rmpc_bench.analysis.comparison_text import (
    AVERAGE_WORDS,
    contradicting,
    far_worse_bound,
    margin_text,
    seen_text,
    size_text,
)
from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.parameter_text import pair_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import MetricInfo

AVERAGES = {"geometric": "geometric mean of the paired ratios", "mean": "ratio of the means"}
"""What a change in per cent is an average of."""


def sentence(row: Mapping[str, Any], info: MetricInfo, trials: Trials) -> str:
    """Say one row of `comparison.comparisons` in one sentence that can be pasted into a paper.

    It is such as "R-MPC1 lowers mse by 10.9 % [9.7, 12.1] against S-MPC (geometric mean of the ratios, 200 paired runs,
    95 % interval; won 162, lost 0, tied 38; both as published, not tuned): better in these runs; failed or 10
    times worse than the partner: 0 of 200 runs, so at most 1.5 % of all runs (95 % bound)."
    """
    method, baseline, name = row["method"], row["baseline"], name_of_distance(info)
    word = seen_text(row, margin_text(trials, info, row))
    counts = f"won {row['won']}, lost {row['lost']}, tied {row['tied']}"
    origin = pair_text(trials, method, baseline)
    counts += f"; {origin}" if origin else ""
    n = int(row["n_pairs"])
    pairs = f"{n} paired {'run' if n == 1 else 'runs'}"
    changed = _changed(row, info)
    if not changed:
        text = f"{method} against {baseline} in {name} ({pairs}; {counts})"
    else:
        simultaneous = "simultaneous " if word and row["ci_level"] > trials.confidence else ""
        level = f"{simultaneous}{100 * trials.confidence:g} % interval"
        average = AVERAGE_WORDS[str(row["average"])]
        text = f"{method} {changed} against {baseline} ({average}, {pairs}, {level}; {counts})"
    if word and contradicting(row):
        other = "mean" if row["average"] == "geometric" else "geometric"
        text += f"; the {AVERAGES[other]} changes by {size_text(row, info, other)}"
    failed = _failed(row)
    bound = far_worse_bound([row], trials, info)
    return f"{text}{failed}{': ' + word if word else ''}{'; ' + bound if bound else ''}."


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
        f"{100 * trials.relevant:g} %. Superiority: share of the runs in which the method is better; a tied run counts "
        "half. p: p value of the Wilcoxon signed-rank test, adjusted by Holm's method. Verdicts: for the primary "
        "metric only, from simultaneous intervals for all methods and all points of a sweep."
    )
