"""Summary of every metric of every method."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from rmpc_bench.analysis.intervals import NONE, quantiles, standard_error, student
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import MetricInfo

SUMMARY = "method metric n n_failed mean se ci_low ci_high median q25 q75 min max did_not_occur".split()


@np.errstate(over="ignore", invalid="ignore")
def summary(trials: Trials) -> pd.DataFrame:
    """Describe every metric of every method.

    One row per method and metric with the columns `SUMMARY`; `n` counts the runs that have a value and `did_not_occur`
    those of them that are inf.  Where there is one, or could be, mean, se and interval (Student t) are NaN.
    """
    rows = [_describe(trials, method, info) for method in trials.methods for info in trials.metrics]
    return pd.DataFrame(rows, columns=SUMMARY)


def _describe(trials: Trials, method: str, info: MetricInfo) -> dict[str, Any]:
    values = trials.column(info.name, method)
    values = values[~np.isnan(values)]
    with_mean = len(values) > 0 and not info.may_not_occur and bool(np.isfinite(values).all())
    low, high = student(values, trials.confidence) if with_mean else NONE
    least, q25, median, q75, largest = map(float, quantiles(values, [0.0, 0.25, 0.5, 0.75, 1.0]))
    return {
        "method": method,
        "metric": info.name,
        "n": len(values),
        "n_failed": trials.n_failed(method),
        "mean": float(np.mean(values)) if with_mean else math.nan,
        "se": standard_error(values) if with_mean else math.nan,
        "ci_low": low,
        "ci_high": high,
        "median": median,
        "q25": q25,
        "q75": q75,
        "min": least,
        "max": largest,
        "did_not_occur": int(np.isinf(values).sum()),
    }
