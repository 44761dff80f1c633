"""The worst runs of every method as Markdown: 95 % quantile, mean of the worst 5 %, and the worst run by its index."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.analysis.pairs import distance_from_best, name_of_distance
from rmpc_bench.analysis.tails import tails
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import marked
from rmpc_bench.types import MetricInfo

FEWEST = 20
"""Runs below which the worst 5 % are less than one run."""


def worst_runs_columns(trials: Trials, metrics: Sequence[MetricInfo] | None = None) -> dict[str, list[str]]:
    """Return head -> cells at one point for some metrics or all; empty with few runs and where nothing is estimated."""
    if len(trials.runs) < FEWEST or trials.alike or not trials.with_verdicts:
        return {}
    trials = trials if metrics is None else trials.with_numbers(trials.frame, metrics=tuple(metrics))
    infos = {info.name: info for info in trials.metrics}
    columns: dict[str, list[str]] = {}
    table = tails(trials).sort_values("metric", key=lambda names: names.map(list(infos).index), kind="stable")
    for row in table.to_dict("records"):
        for head, cell in _cells(trials, row, infos[row["metric"]]).items():
            columns.setdefault(head, []).append(cell)
    return columns


def worst_runs(trials: Trials, info: MetricInfo) -> dict[str, tuple[float, int]]:
    """Return method -> distance from the best value and index of its worst finished run, the first of equal ones."""
    found = {}
    for method in trials.methods:
        values = distance_from_best(trials.column(info.name, method), info.direction)
        if np.isnan(values).all():
            continue
        place = int(np.nanargmin(values) if info.direction == "higher" else np.nanargmax(values))
        found[method] = float(values[place]), int(trials.runs[place])
    return found


def _cells(trials: Trials, row: Mapping[Any, Any], info: MetricInfo) -> dict[str, str]:
    quantile = "5 %" if info.direction == "higher" else "95 %"
    unit = f" [{info.unit}]" if info.unit else ""
    worst = "-" if math.isnan(row["worst"]) else f"{row['worst']:.4g} (run {row['worst_run']})"
    return {
        "metric": name_of_distance(info) + unit,
        "method": marked(trials, row["method"]),
        "95 % quantile": _text(row, "tail_quantile") + (f" ({quantile})" if quantile != "95 %" else ""),
        "mean of the worst 5 %": _text(row, "cvar"),
        "worst finished run": worst,
    }


def _text(row: Mapping[Any, Any], name: str) -> str:
    value = float(row[name])
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return interval_text(value, float(row[f"{name}_low"]), float(row[f"{name}_high"]), sign=False)
