"""Tables for version control, rounded such that another CPU writes the same bytes.

See `rmpc_bench.analysis.rounding` for the rules; trials.csv keeps full precision.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from rmpc_bench.analysis.rounding import NEGLIGIBLE, rounded
from rmpc_bench.types import Array

MIDDLE = ["median", "q25", "q75"]
NUMBERS = ["mean", "se", "ci_low", "ci_high", *MIDDLE, "min", "max"]
CHANGES = [
    *("change_pct", "ci_low", "ci_high", "geometric_pct", "geometric_low", "geometric_high"),
    *("mean_pct", "mean_low", "mean_high"),
]
SHARES = ["superiority", "ci_level", "superiority_low", "superiority_high", "failed_low", "failed_high"]
SHARES += ["far_worse_upper", "baseline_far_worse_upper"]
DIFFERENCES = ["difference", "difference_low", "difference_high"]
PER_CENT = 100.0
UNRELIABLE = 1e-12
"""Digits of a small metric that may be rounding errors of the numbers whose difference it is."""


def summary_table(described: pd.DataFrame) -> pd.DataFrame:
    """Return the content of summary.csv, from `Summary.described`; numbers are rounded, counts and texts are exact.

    The scale of a row is its largest quartile, that of a metric the largest quartile of all rows of the metric.
    Minimum and maximum do not count, as those of a single run may be enormous.  Where the scale of a row is below
    `NEGLIGIBLE` of that of its metric, those of its numbers that are, too, are written as 0.  A row above it keeps its
    small numbers, such as the error of its mean.  No digit is kept below `NEGLIGIBLE` of the scale of the row or below
    `UNRELIABLE` of that of the metric.
    """
    table = described.drop(columns="did_not_occur")
    numbers = table[NUMBERS].to_numpy(dtype=float)
    of_row = _largest(table[MIDDLE])[:, None]
    groups = pd.Series(of_row[:, 0]).groupby(table["metric"].to_numpy())
    of_metric = groups.transform("max").to_numpy(dtype=float)[:, None]
    found = rounded(numbers, np.maximum(of_row, UNRELIABLE / NEGLIGIBLE * of_metric))
    smallest = NEGLIGIBLE * of_metric
    table[NUMBERS] = np.where((of_row < smallest) & (np.abs(numbers) < smallest), 0.0, found)
    return table


def comparisons_table(compared: pd.DataFrame) -> pd.DataFrame:
    """Return the content of comparisons.csv, from `Summary.compared`.

    Changes are rounded beside 100 per cent, shares beside 1; counts and texts are exact.
    """
    table = compared.copy()
    table[CHANGES] = rounded(table[CHANGES].to_numpy(dtype=float), PER_CENT)
    table[SHARES] = rounded(table[SHARES].to_numpy(dtype=float), 1.0)
    # They are rounded beside the numbers that they were computed from already.
    table[DIFFERENCES] = rounded(table[DIFFERENCES].to_numpy(dtype=float))
    return table


def _largest(frame: pd.DataFrame) -> Array:
    """Largest finite absolute value of every row, 0 where there is none."""
    sizes = np.abs(frame.to_numpy(dtype=float))
    found: Array = np.max(np.where(np.isfinite(sizes), sizes, 0.0), axis=1, initial=0.0)
    return found
