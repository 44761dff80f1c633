"""The worst runs of a method: 95 % quantile and mean of the worst 5 % with their intervals, and the worst run by name.

Quantile    Its interval lies between order statistics, whose ranks are binomial: the bootstrap distribution of a
            quantile in closed form.
CVaR        Conditional value at risk: the mean of the worst 5 % of the runs.  Its interval is bootstrap-t over whole
            runs.  For 200 runs the percentile bootstrap covers 0.84 to 0.89 of the time instead of 0.95, as a resample
            has no run worse than the worst one; bootstrap-t covers 0.93 to 0.95 for normal to log-normal runs.  Of
            values with one sign it is computed of the logarithm, so that it keeps the sign: for 95 log-normal runs
            with deviations of the logarithm of 0.3, 0.6 and 1.1 it covers 0.94.  From `NORMAL` runs on t is normal.
Limits      An interval at 95 % needs 72 runs: with fewer, all of them lie below the 95 % quantile too often.
"""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import Rows
from rmpc_bench.analysis.intervals import NONE, Interval, order_ranks, quantile, wilson
from rmpc_bench.analysis.pairs import distance_from_best
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array, MetricInfo

TAIL = 0.05
"""Share of the runs that are the worst ones."""
RESAMPLES = 1999
MANY = 5000
"""Number of runs above which only the worst runs of every resample are drawn: all of them take 800 MB for 100,000."""
NORMAL = 20_000
"""Number of runs from which on the interval of the mean of the worst runs is normal; these are then 1000 or more."""
LEAST = 0.2
"""Smallest relative error of a resample, times that of the sample: tails of nearly one value would have any t."""
COLUMNS = (
    "method metric n tail_quantile tail_quantile_low tail_quantile_high cvar cvar_low cvar_high "
    "did_not_occur_share did_not_occur_low did_not_occur_high worst worst_run"
).split()


@np.errstate(over="ignore", invalid="ignore")
def tail_rows(trials: Trials) -> Rows:
    """Describe the worst runs of every method in every metric.

    What is described is the distance from the best value: the size of a metric that is best at 0, max(x, 1/x) of one
    that is best at 1.  Where higher values are better, the worst runs have the lowest ones.

    One row per method and metric with the columns `COLUMNS`, from the `n` finished runs of one point; the worst 5 % of
    them begin at `tail_quantile` and have the mean `cvar`; the share of runs in which the event did not occur has its
    Wilson interval; `worst_run` is the index of the worst finished run, the first of equal ones, None without one.
    """
    return [_row(trials, method, info) for method in trials.methods for info in trials.metrics]


def _row(trials: Trials, method: str, info: MetricInfo) -> dict[str, Any]:
    column = distance_from_best(trials.column(info.name, method), info.direction)
    known = ~np.isnan(column)
    sign = -1.0 if info.direction == "higher" else 1.0
    losses, runs = sign * column[known], trials.runs[known]
    n, missing = len(losses), int(np.isinf(losses).sum())
    at = quantile_interval(losses, trials.confidence)
    mean, of_mean = cvar_interval(losses, trials.confidence, trials.seed)
    share = wilson(missing, n, trials.confidence)
    return {
        "method": method,
        "metric": info.name,
        "n": n,
        "tail_quantile": sign * float(quantile(losses, 1 - TAIL)),
        **_ends("tail_quantile", at, sign),
        "cvar": sign * mean + 0.0,
        **_ends("cvar", of_mean, sign),
        "did_not_occur_share": missing / n if n else math.nan,
        **_ends("did_not_occur", share, 1.0),
        "worst": sign * float(losses.max()) if n else math.nan,
        "worst_run": int(runs[int(losses.argmax())]) if n else None,
    }


def _ends(name: str, interval: Interval, sign: float) -> dict[str, float]:
    low, high = interval if sign > 0 else (-interval[1] + 0.0, -interval[0] + 0.0)
    return {f"{name}_low": low, f"{name}_high": high}


def quantile_interval(values: Array, confidence: float) -> Interval:
    """Interval of the 95 % quantile between order statistics; NaN where there is none of them on either side."""
    n = len(values)
    if n < 2:
        return NONE
    low, high = order_ranks(n, 1 - TAIL, confidence)
    if low < 1 or high > n:
        return NONE
    ordered = np.partition(values, (low - 1, high - 1))
    return float(ordered[low - 1]), float(ordered[high - 1])


def cvar_interval(values: Array, confidence: float, seed: int) -> tuple[float, Interval]:
    """Mean of the largest 5 % of a sample with its bootstrap-t interval, which is NaN where that of the quantile is."""
    n = len(values)
    if not n:
        return math.nan, NONE
    n_tail = math.floor(TAIL * n)
    # Resamples of fewer runs contain any of them.
    left_out = n - n_tail - 1 if n >= NORMAL else 0
    largest = np.sort(np.partition(values, left_out)[left_out:])[::-1]
    if not np.isfinite(largest[0]):
        return math.inf, NONE
    mean, se = (float(found[0]) for found in _cvar(largest[: n_tail + 1][None], n))
    if math.isnan(quantile_interval(values, confidence)[0]):
        return mean, NONE
    if se == 0:
        return mean, (mean, mean)
    size = abs(mean) if values.min() >= 0 or values.max() <= 0 else 0.0
    if n >= NORMAL:
        high = NormalDist().inv_cdf((1 + confidence) / 2)
        low = -high
    else:
        means, errors = _cvar(largest[_ranks(n, n_tail + 1, seed)], n)
        # A resample whose tail repeats one value, or is 0, has no t statistic.
        kept = (errors > 0) & ((means * mean > 0) | (size == 0))
        means, errors = means[kept], errors[kept]
        relative = np.maximum(errors / np.abs(means), LEAST * se / size) if size else errors
        t = (np.log(means / mean) * np.sign(mean) if size else means - mean) / relative
        low, high = (float(quantile(t, p)) for p in ((1 - confidence) / 2, (1 + confidence) / 2))
    if not size:
        return mean, (mean - high * se, mean - low * se)
    with np.errstate(over="ignore"):
        ends = mean * float(np.exp(-high * se / mean)), mean * float(np.exp(-low * se / mean))
    return mean, ends if np.isfinite(ends).all() else NONE


# All metrics and methods with so many finished runs have the same resamples.
@lru_cache(maxsize=4)
def _ranks(n: int, n_worst: int, seed: int) -> Array:
    """Draw n of n runs again and return the ranks of the worst ones, 0 for the worst run: (RESAMPLES, n_worst)."""
    rng = np.random.Generator(np.random.PCG64(seed))
    if n < MANY:
        drawn = rng.integers(0, n, (RESAMPLES, n), dtype=np.int32)
        return np.sort(np.partition(drawn, n_worst - 1, axis=1)[:, :n_worst], axis=1)
    # The number of draws among the first ranks is binomial: below n_worst with probability 1e-12.
    first = n_worst + math.ceil(8 * math.sqrt(n_worst))
    counts = np.maximum(rng.binomial(n, first / n, RESAMPLES), n_worst)
    return np.array([np.sort(rng.integers(0, first, count, dtype=np.int32))[:n_worst] for count in counts])


def _cvar(largest: Array, n: int) -> tuple[Array, Array]:
    """Mean and standard error, from the influence of each run, of samples of n: (samples, n_tail + 1) descending."""
    n_tail, size = largest.shape[1] - 1, TAIL * n
    mean = (largest[:, :n_tail].sum(axis=1) + (size - n_tail) * largest[:, n_tail]) / size
    beyond = (largest[:, :n_tail] - largest[:, n_tail:]) / TAIL
    variance = ((beyond**2).sum(axis=1) - beyond.sum(axis=1) ** 2 / n) / max(n - 1, 1)
    return mean, np.sqrt(np.maximum(variance, 0.0) / n)
