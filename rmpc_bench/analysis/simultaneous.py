"""Level of each interval of a family such that the intervals are simultaneous with the level that is asked for.

Method  Max-t by sign flips of whole runs: the deviations of all comparisons from their means are multiplied by a random
        sign per run, the same for all methods and points of a sweep, which keeps the correlation of the comparisons.
        A comparison with n pairs is measured by the p value of its t statistic, as n differs where runs failed; with
        equal n this is the largest |t|.  The (1 - confidence) quantile of the smallest p is the level of each interval.
Source  Westfall and Young, Resampling-Based Multiple Testing, 1993 (single-step min-p).
Limit   One comparison: the level that is asked for.  Independent comparisons: that of Sidak.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from rmpc_bench.analysis.intervals import quantile
from rmpc_bench.types import Array

FLIPS = 4096
"""Random sign patterns; all of them where the runs have no more, which is up to 12 runs."""
_CHUNK = 512
MANY = 1000
"""Runs from which on the sums of flipped deviations are drawn as what they are then: normal, with their covariance."""


def held_level(contributions: Array, confidence: float, seed: int) -> float:
    """Return the level of each interval of a family.

    Parameters
    ----------
    contributions : (n_runs, n_comparisons) numbers whose means are compared with 0, such as log ratios; NaN where a
        pair is missing
    confidence : level of the family, such as 0.95
    seed : of the sign patterns

    Returns
    -------
    a level between `confidence` and that of Bonferroni

    Examples
    --------
    >>> held_level(np.array([[1.0], [2.0], [4.0]]), 0.95, seed=1)
    0.95
    """
    from scipy import special

    valid = np.isfinite(contributions)
    n = valid.sum(axis=0)
    mean = np.where(valid, contributions, 0.0).sum(axis=0) / np.maximum(n, 1)
    deviations = np.where(valid, contributions - mean, 0.0)
    squares = np.einsum("ij,ij->j", deviations, deviations)
    # A comparison without spread cannot be wrong by chance.
    used = (n > 1) & (squares > 0)
    size, alpha = int(used.sum()), 1 - confidence
    if size < 2:
        return confidence
    n, squares = n[used], squares[used]
    deviations = np.ascontiguousarray(deviations[:, used] / np.sqrt(squares))
    smallest = []
    for sums in _flipped_sums(deviations, seed):
        # With squares scaled to 1:  t^2 = (n - 1) s^2 / (n - s^2), s the sum of the flipped deviations.
        share = np.minimum(sums**2 / n, 1.0)
        with np.errstate(divide="ignore"):
            t = np.sqrt((n - 1) * share / (1 - share))
        p = [2 * special.stdtr(pairs - 1, -t[:, n == pairs].max(axis=1)) for pairs in np.unique(n)]
        smallest.append(np.min(p, axis=0))
    level = float(quantile(np.concatenate(smallest), alpha))
    return 1 - min(max(level, alpha / size), alpha)


def _flipped_sums(deviations: Array, seed: int) -> Iterator[Array]:
    """Yield blocks (patterns, n_comparisons) of sums of deviations with random signs.

    All sign patterns of few runs, random ones of more; of very many runs normal numbers, so that time and memory do
    not grow with the number of runs.
    """
    n_runs = len(deviations)
    rng = np.random.Generator(np.random.PCG64(seed))
    if n_runs <= math.log2(FLIPS):
        bits = np.arange(2**n_runs)[:, None] >> np.arange(n_runs) & 1
        yield (1.0 - 2.0 * bits) @ deviations
    elif n_runs < MANY:
        for _ in range(FLIPS // _CHUNK):
            yield (1.0 - 2.0 * rng.integers(0, 2, (_CHUNK, n_runs), dtype=np.int8)) @ deviations
    else:
        covariance = np.einsum("ri,rj->ij", deviations, deviations)
        # Two methods that never differ make it singular.
        root = np.linalg.cholesky(covariance + 1e-10 * np.eye(len(covariance)))
        yield rng.standard_normal((4 * FLIPS, len(covariance))) @ root.T
