"""How many runs of a method are lost: failed, or far worse in the primary metric than the baseline in the same run.

Lost    A run that failed, or whose primary metric exceeds a factor times that of the baseline in the same run.
Limit   Where the baseline failed, is absent or has a value below 0, a run counts by its own failure only.  The baseline
        is lost where it failed.
        `Pairs.far_worse` has the same rule (`verdict.far_worse`), but of the runs that both methods have only, and no
        factor for a metric with a negative value in any run.
Source  The interval of the share is that of Wilson (`intervals.wilson`), each for itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import Rows
from rmpc_bench.analysis.intervals import wilson
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.verdict import far_worse

COLUMNS = "method baseline metric factor n n_failed n_lost lost_pct lost_low lost_high".split()
"""Columns of lost.csv, a row of which counts the lost runs of one method.

factor : a finished run is lost where its metric exceeds this number times that of the baseline
n, n_failed, n_lost : runs of the method, failed ones included; failed ones, all of which are lost; lost ones
lost_pct, lost_low, lost_high : share of lost runs with its Wilson interval [%]
"""


def lost_runs(trials: Trials) -> Rows:
    """Count the lost runs of every method at one point, whose baseline need not be shown: rows of `COLUMNS`.

    Empty where no factor is given.
    """
    info, factor = trials.primary_info, trials.lost
    if info is None or factor is None:
        return []
    # A table may show some of the methods only.
    whole = replace(trials, methods=tuple(dict.fromkeys([*trials.methods, trials.baseline])))
    return [_lost(whole, name, info.name, factor) for name in trials.methods]


def _lost(trials: Trials, method: str, metric: str, factor: float) -> dict[str, Any]:
    values, limits = trials.column(metric, method), trials.column(metric, trials.baseline)
    failed = trials.failed(method)
    lost = failed | far_worse(values, limits, factor)
    n, k = int((~np.isnan(values) | failed).sum()), int(lost.sum())
    low, high = wilson(k, n, trials.confidence)
    return {
        "method": method,
        "baseline": trials.baseline,
        "metric": metric,
        "factor": factor,
        "n": n,
        "n_failed": int(failed.sum()),
        "n_lost": k,
        "lost_pct": 100 * k / n if n else math.nan,
        "lost_low": 100 * low,
        "lost_high": 100 * high,
    }
