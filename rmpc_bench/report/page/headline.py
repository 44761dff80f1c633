"""The summary sentence of a page: how the methods compare with the baseline in the primary metric."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from rmpc_bench.analysis.comparison_text import far_worse_bound, margin_text, seen_text, size_text
from rmpc_bench.analysis.parameter_text import untuned_name
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.point_summary import PointSummary
from rmpc_bench.report.sentences import AVERAGES
from rmpc_bench.report.summary import Summary
from rmpc_bench.types import MetricInfo

MOST_NAMED = 6
"""Methods that the sentence names one by one."""
SMOKE = "This is a smoke run: it is too short for verdicts, and its numbers mean nothing."


def headline(tables: Summary) -> str:
    """Say in one sentence how the methods compare with the baseline, and in another what its numbers are."""
    first = tables.points[0]
    info = shown_metric(first.trials)
    if not first.trials.with_verdicts:
        return SMOKE
    if info is None or not len(first.trials.frame):
        return "Ensemble moments were computed without single runs; the table has bias and variance of the error."
    rows = [_rows(point, info) for point in tables.points]
    if not any(rows):
        return _described(tables.pooled or first, info)
    quantity = f"{info.words} [{info.unit}]" if info.unit else info.words
    if len(rows) == 1:
        return _one_point(first.trials, info, quantity, rows[0])
    return _several_points(first.trials, quantity, rows)


def shown_metric(trials: Trials) -> MetricInfo | None:
    """Return the primary metric, or the first one where tables do not show it; None without metrics."""
    return trials.primary_info or next(iter(trials.metrics), None)


def _rows(point: PointSummary, info: MetricInfo) -> list[Mapping[Any, Any]]:
    compared = point.compared
    if not len(compared):
        return []
    rows = compared[(compared["metric"] == info.name) & compared["method"].isin(point.trials.methods)]
    return [*rows.to_dict("records")]


def _described(point: PointSummary, info: MetricInfo) -> str:
    """Name the medians where nothing is compared."""
    described = point.described[point.described["metric"] == info.name].to_dict("records")
    unit = f" {info.unit}" if info.unit else ""
    medians = [f"{row['method']} {row['median']:.4g}{unit}" for row in described[:MOST_NAMED]]
    more = f", and {len(described) - MOST_NAMED} more" if len(described) > MOST_NAMED else ""
    where = f", {point.trials.title}" if point.trials.title else ""
    return f"Median {info.words}{where}: {', '.join(medians)}{more}."


def _one_point(trials: Trials, info: MetricInfo, quantity: str, rows: Sequence[Mapping[Any, Any]]) -> str:
    numbers = sorted({int(row["n_pairs"]) for row in rows})
    pairs = f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
    parts = [_compared(trials, info, row) for row in rows[:MOST_NAMED]]
    if len(rows) > MOST_NAMED:
        parts.append(f"{len(rows) - MOST_NAMED} more methods are in the table")
    baseline = str(rows[0]["baseline"])
    compared = f"Compared with {untuned_name(trials, baseline, baseline)} in {quantity} over {pairs} paired runs"
    bound = far_worse_bound(rows, trials, info)
    text = f"{compared}, {_joined(parts)}.{f' Rare bad runs: {bound}.' if bound else ''}"
    averages = {str(row["average"]) for row in rows} - {""}
    if len(averages) != 1:
        return text
    average = averages.pop()
    simultaneous = "simultaneous " if any(row["ci_level"] > trials.confidence for row in rows) else ""
    name = AVERAGES.get(average, "mean difference")
    return f"{text} Numbers: {name} with {simultaneous}{100 * trials.confidence:g} % intervals."


def _compared(trials: Trials, info: MetricInfo, row: Mapping[Any, Any]) -> str:
    word, size = seen_text(row, margin_text(trials, info, row)), size_text(row, info)
    verb = word if word.startswith(("fails", "depends")) else f"is {word}"
    numbers = f"{row['won']} runs won, {row['lost']} lost, {row['tied']} tied" if size == "-" else size
    return f"{row['method']} {verb if word else 'has no verdict'} ({numbers})"


def _several_points(trials: Trials, quantity: str, rows: Sequence[Sequence[Mapping[Any, Any]]]) -> str:
    """Count the verdicts over the points, for all methods with the same counts together."""
    counts: dict[str, Counter[str]] = {}
    for row in (row for point in rows for row in point):
        word = str(row["verdict"]).replace("-size-uncertain", "").replace("-", " ")
        word = word.replace("depends on average", "dependent on the average") or "without a verdict"
        counts.setdefault(str(row["method"]), Counter())[word] += 1
    alike: dict[str, list[str]] = {}
    for method, words in counts.items():
        alike.setdefault(_counted(words, len(rows)), []).append(method)
    parts = [f"{_joined(methods)}: {text}" for text, methods in alike.items()]
    shown = parts[:MOST_NAMED]
    if len(parts) > len(shown):
        left = sum(len(methods) for methods in [*alike.values()][MOST_NAMED:])
        shown.append(f"{left} more method{'' if left == 1 else 's'}: see the table")
    baseline = untuned_name(trials, trials.baseline, trials.baseline)
    return f"Compared with {baseline} in {quantity} at {len(rows)} points of a sweep. {'; '.join(shown)}."


def _counted(words: Counter[str], n_points: int) -> str:
    """Write how often each verdict was given, such as ``better at 3 points, worse at 1``."""
    if len(words) == 1 and words.total() == n_points > 1:
        return f"{next(iter(words))} at all {n_points} points"
    first, *rest = [f"{word} at {times}" for word, times in words.most_common()]
    return ", ".join([f"{first} points" if not first.endswith(" at 1") else f"{first} point", *rest])


def _joined(parts: Sequence[str]) -> str:
    if len(parts) < 3:
        return " and ".join(parts)
    return f"{', '.join(parts[:-1])}, and {parts[-1]}"
