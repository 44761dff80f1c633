"""Failed and far worse runs of a method and of its baseline: shares, and values that stand for failed runs."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from rmpc_bench.analysis.intervals import NONE, Interval
from rmpc_bench.types import Array

FACTOR = 10.0
"""A failed run counts as worse than its partner by this factor; a finished one that exceeds it is far worse."""
BOUND = 0.95
"""Level of the bound of the share of runs that failed or are far worse."""


def far_worse(values: Array, partners: Array, factor: float) -> Array:
    """Return where a value exceeds a factor times that of its partner; nowhere beside a failed or a negative one."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray((values > factor * partners) & (partners >= 0))


def largest_share(k: int, n: int) -> float:
    """Return the largest share that k of n runs leave possible, exactly (Clopper and Pearson, one side).

    Examples
    --------
    >>> [round(100 * largest_share(*each), 4) for each in ((0, 60), (3, 200))]
    [4.8703, 3.831]
    """
    from scipy import special

    return float(special.betaincinv(k + 1, n - k, BOUND)) if k < n else 1.0 if n else float("nan")


@lru_cache(maxsize=4096)
def mcnemar(method_only: int, baseline_only: int, n: int, confidence: float) -> Interval:
    """Invert the exact McNemar test of equal shares of failed runs.

    Given the number m of runs that only one of the two failed in, those in which only the method failed are binomial.
    The interval of that probability p (Clopper and Pearson) gives (2 p - 1) m / n, which excludes 0 where the exact
    test rejects equal shares.  As m is random, it is no interval of the difference itself: `shares_interval` is.

    Examples
    --------
    >>> [round(end, 3) for end in mcnemar(6, 0, 200, 0.95)]
    [0.002, 0.03]
    """
    from scipy import special

    if not n:
        return NONE
    m = method_only + baseline_only
    if not m:
        return 0.0, 0.0
    # Clopper and Pearson: the ends of an exact interval of a share are quantiles of beta distributions.
    rest = (1 - confidence) / 2
    low = float(special.betaincinv(method_only, baseline_only + 1, rest)) if method_only else 0.0
    high = float(special.betaincinv(method_only + 1, baseline_only, 1 - rest)) if baseline_only else 1.0
    return (2 * low - 1) * m / n, (2 * high - 1) * m / n


def worst_of(columns: Iterable[Array], *, higher_is_better: bool) -> float:
    """Return the worst value of the finished runs of all methods; NaN where there is none."""
    values = np.concatenate([*columns, np.zeros(0)])
    values = values[~np.isnan(values)]
    if not len(values):
        return float("nan")
    return float(values.min() if higher_is_better else values.max())
