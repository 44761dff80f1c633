"""Summary of every metric of every method, and how many runs meet a requirement.

The share of runs that pass has its Wilson (score) interval, the paired difference of two shares the score interval of
Tango with the exact McNemar test (`shares_interval`).  A failed run does not pass; an event that did not occur has the
value inf, which passes no upper limit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import Rows
from rmpc_bench.analysis.intervals import NONE, quantiles, standard_error, student, wilson
from rmpc_bench.analysis.superiority import shares_interval
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.verdict import largest_share
from rmpc_bench.types import Array, MetricInfo
from rmpc_bench.types.metric import Requirement

NUMBERS = "mean se ci_low ci_high median q25 q75 min max".split()
"""Columns of `SUMMARY` that are no counts and no names."""
SUMMARY = ["method", "metric", "n", "n_failed", *NUMBERS, "did_not_occur"]


@np.errstate(over="ignore", invalid="ignore")
def summary(trials: Trials) -> Rows:
    """Describe every metric of every method.

    One row per method and metric with the columns `SUMMARY`; `n` counts the runs that have a value and `did_not_occur`
    those of them that are inf.  Where there is one, or could be, mean, se and interval (Student t) are NaN.
    """
    return [_describe(trials, method, info) for method in trials.methods for info in trials.metrics]


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


COLUMNS = (
    "requirement method baseline n n_failed passed pass_pct pass_low pass_high miss_upper n_pairs method_only "
    "baseline_only difference_pct difference_low difference_high"
).split()
"""Columns of requirements.csv, a row of which counts the runs of one method that meet one requirement.

requirement : as written
n, n_failed, passed : runs of the method, failed ones included; failed ones, which do not pass; runs that pass
pass_pct, pass_low, pass_high : share of runs that pass with its Wilson interval [%]
miss_upper : exact 95 % bound of the share of runs that do not pass [%]
n_pairs : runs of both methods
method_only, baseline_only : runs in which one of the two passes and the other does not
difference_pct, difference_low, difference_high : share of the method minus that of the baseline with its paired score
    interval [percentage points]; NaN for the baseline
"""


def pass_rates(trials: Trials) -> Rows:
    """Count the runs that meet each requirement, a row of `COLUMNS` per requirement and method."""
    return [_rate(trials, each, method) for each in trials.requirements for method in trials.methods]


def _rate(trials: Trials, requirement: Requirement, method: str) -> dict[str, Any]:
    passed, there = _passed(trials, requirement, method)
    other, there_too = _passed(trials, requirement, trials.baseline)
    n, k = int(there.sum()), int(passed.sum())
    both = there & there_too
    alone = int((passed & ~other & both).sum()), int((other & ~passed & both).sum())
    n_pairs = int(both.sum())
    low, high = wilson(k, n, trials.confidence)
    paired = (math.nan, math.nan, math.nan)
    if method != trials.baseline and n_pairs:
        paired = ((alone[0] - alone[1]) / n_pairs, *shares_interval(*alone, n_pairs, trials.confidence))
    return {
        "requirement": requirement.text,
        "method": method,
        "baseline": trials.baseline,
        "n": n,
        "n_failed": trials.n_failed(method),
        "passed": k,
        "pass_pct": 100 * k / n if n else math.nan,
        "pass_low": 100 * low,
        "pass_high": 100 * high,
        "miss_upper": 100 * largest_share(n - k, n),
        "n_pairs": n_pairs,
        "method_only": alone[0],
        "baseline_only": alone[1],
        **{name: 100 * end for name, end in zip(COLUMNS[-3:], paired, strict=True)},
    }


def _passed(trials: Trials, requirement: Requirement, method: str) -> tuple[Array, Array]:
    """Return which runs pass, and which there are; both (n_runs,) in the order of `Trials.runs`."""
    values = trials.column(requirement.metric, method)
    there = ~np.isnan(values) | trials.failed(method)
    return requirement.passed(values), there
