"""Summary of every metric of every method, and comparisons in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from rmpc_bench.analysis.intervals import (
    NONE,
    quantile,
    standard_error,
    student,
    wilson,
)
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array, MetricInfo

__all__ = ["format_with_error", "sentence", "summary", "wilson"]

SUMMARY = "method metric n n_failed mean se ci_low ci_high median q25 q75 min max did_not_occur".split()


@np.errstate(over="ignore", invalid="ignore")
def summary(trials: Trials) -> pd.DataFrame:
    """Describe every metric of every method.

    Parameters
    ----------
    trials : the table of trials

    Returns
    -------
    one row per method and metric with the columns `SUMMARY`; `n` counts the runs that have a value and
    `did_not_occur` those of them that are inf; where there is one, or could be, mean, se and interval (Student t) are
    NaN
    """
    rows = [_describe(trials, method, info) for method in trials.methods for info in trials.metrics]
    return pd.DataFrame(rows, columns=SUMMARY)


def _describe(trials: Trials, method: str, info: MetricInfo) -> dict[str, Any]:
    values = trials.column(info.name, method)
    values = values[~np.isnan(values)]
    with_mean = len(values) > 0 and not info.may_not_occur and bool(np.isfinite(values).all())
    low, high = student(values, trials.confidence) if with_mean else NONE
    return {
        "method": method,
        "metric": info.name,
        "n": len(values),
        "n_failed": trials.n_failed(method),
        "mean": float(np.mean(values)) if with_mean else math.nan,
        "se": standard_error(values) if with_mean else math.nan,
        "ci_low": low,
        "ci_high": high,
        "median": float(quantile(values, 0.5)),
        "q25": float(quantile(values, 0.25)),
        "q75": float(quantile(values, 0.75)),
        "min": float(quantile(values, 0.0)),
        "max": float(quantile(values, 1.0)),
        "did_not_occur": int(np.isinf(values).sum()),
    }


def from_best(values: Array, direction: str) -> Array:
    """Distance from the best value where that is neither the lowest nor the highest; from 1 as a ratio."""
    if direction not in ("zero", "one"):
        return values
    with np.errstate(divide="ignore"):
        return np.abs(np.log(values) if direction == "one" else values)


def name_from_best(info: MetricInfo) -> str:
    """Name what `from_best` makes of a metric."""
    return {"zero": f"|{info.name}|", "one": f"|log {info.name}|"}.get(info.direction, info.name)


def sentence(row: Mapping[str, Any], info: MetricInfo, *, confidence: float = 0.95) -> str:
    """Say one comparison in one sentence that can be pasted into a paper.

    Parameters
    ----------
    row : a row of `comparison.comparisons`
    info : the metric of the row
    confidence : level of its interval

    Returns
    -------
    such as "R-MPC1 against S-MPC: mse -10.2 % [-11.3, -9.0], better (paired, 95 %, 200 runs; better in 195)."
    """
    n = int(row["n_pairs"])
    counts = f"better in {row['won']}" + (f", tied in {row['tied']}" if row["tied"] else "")
    basis = f"(paired, {100 * confidence:g} %, {n} {'run' if n == 1 else 'runs'}; {counts})"
    pieces = [piece for piece in (_size(row, info), str(row["verdict"]).replace("-", " ")) if piece]
    return f"{row['method']} against {row['baseline']}: {name_of_distance(info)} {', '.join(pieces)} {basis}."


def _size(row: Mapping[str, Any], info: MetricInfo) -> str:
    """Write the average difference with its interval; empty where there is none."""
    signed = row.get("average") == "difference"
    names = ("difference", "difference_low", "difference_high") if signed else ("change_pct", "ci_low", "ci_high")
    value, low, high = (float(row[name]) for name in names)
    unit = " " + (info.unit if signed else "%") if info.unit or not signed else ""
    if math.isnan(value):
        return ""
    if math.isnan(low):
        return f"{value:+.3g}{unit}"
    places = decimals((high - low) / 2) if signed else min(3, decimals((high - low) / 2))
    return f"{value:+.{places}f}{unit} [{low:+.{places}f}, {high:+.{places}f}]"


def decimals(uncertainty: float) -> int:
    """Decimal places that show an uncertainty with two digits, between 0 and 12; 3 where it is 0 or unknown."""
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return 3
    return min(12, max(0, 1 - math.floor(math.log10(uncertainty))))


def format_with_error(value: float, se: float) -> str:
    """Write a value with no more digits than its standard error supports.

    Parameters
    ----------
    value : the number
    se : its standard error, in the same unit

    Returns
    -------
    such as "0.1186(15)", the bracket being the error of the last digits: two of them up to 35, else one; inf is
    "inf", NaN is "-", and an error that is 0 or unknown leaves four digits without a bracket
    """
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if not (math.isfinite(se) and se > 1e-12 * abs(value)):  # an error below rounding is none
        return f"{value:.4g}"
    size = math.floor(math.log10(max(abs(value), se)))
    if not -4 <= size < 6:
        return f"{format_with_error(value / 10.0**size, se / 10.0**size)}e{size:+03d}"
    exponent = math.floor(math.log10(se))
    lead = se / 10.0**exponent
    # The rule of the Particle Data Group: 1.0 to 3.54 two digits, to 9.49 one, above that "10" of the next decade.
    last = exponent - 1 if lead < 3.55 else exponent
    error = round(se / 10.0**last) * 10.0 ** max(last, 0)
    return f"{round(value, -last):z.{max(-last, 0)}f}({error:.0f})"
