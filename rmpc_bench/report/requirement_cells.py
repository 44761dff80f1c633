"""Cells of the tables of requirements."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from rmpc_bench.analysis.comparison_text import per_cent
from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import marked

REQUIREMENTS_NOTE = (
    "A failed run does not meet a requirement. Share: Wilson interval; difference in percentage points: paired score "
    "interval of Tango, which contains 0 where the exact McNemar test does not reject equal shares."
)


def requirement_columns(trials: Trials, frame: pd.DataFrame, *, plain: bool = False) -> dict[str, list[str]]:
    """Return head -> cells by the pass rates of one point, see `analysis.requirements`; empty without any.

    In Markdown requirements stand between backticks, in a plain table they do not.
    """
    rows = frame.to_dict("records")
    if not rows:
        return {}
    columns = {
        "requirement": [str(row["requirement"]) if plain else f"`{row['requirement']}`" for row in rows],
        "method": [row["method"] if plain else marked(trials, row["method"]) for row in rows],
        "runs that meet it": [f"{row['passed']} of {row['n']}" for row in rows],
        "share": [share(row) for row in rows],
        "miss it, at most (95 %)": [per_cent(row["miss_upper"]) for row in rows],
    }
    if len(trials.methods) > 1:
        columns[f"difference from {trials.baseline}"] = [difference(row) for row in rows]
        columns["met by the method only / by the baseline only"] = [_alone(row) for row in rows]
    return columns


def share(row: Mapping[Hashable, Any]) -> str:
    """Write the share of runs that meet a requirement with its interval."""
    return interval_text(row["pass_pct"], row["pass_low"], row["pass_high"], unit="%", sign=False)


def difference(row: Mapping[Hashable, Any]) -> str:
    """Write the paired difference from the baseline in percentage points; "-" for the baseline."""
    values = (row["difference_pct"], row["difference_low"], row["difference_high"])
    return interval_text(*values, unit="points")


def _alone(row: Mapping[Hashable, Any]) -> str:
    same = row["method"] == row["baseline"]
    return "-" if same else f"{row['method_only']} / {row['baseline_only']}"
