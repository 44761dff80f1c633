"""Levels of the intervals of a family: simultaneous ones, and those at several looks at a growing number of runs.

Method  Max-t by sign flips of whole runs: the deviations of all comparisons from their means are multiplied by a random
        sign per run, the same for all methods and points of a sweep, which keeps the correlation of the comparisons.
        A comparison with n pairs is measured by the p value of its t statistic, as n differs where runs failed; with
        equal n this is the largest |t|.  The (1 - confidence) quantile of the smallest p is the level of each interval.
Source  Westfall and Young, Resampling-Based Multiple Testing, 1993 (single-step min-p).
Limit   One comparison: the level that is asked for.  Independent comparisons: that of Sidak.

A verdict that is repeated with more runs until it is decided has several chances to be wrong.

Planned looks at verdicts or claims, of which there are at most K: each interval has the level 1 - alpha/K, so that all
looks together are wrong in at most alpha of the experiments (Bonferroni).

Planned looks at widths end an experiment when its intervals are narrow enough, whatever they contain.  Their levels
stay as they are.

Unplanned looks, where a user raises the number of runs after a verdict was printed: the number of further looks is
unknown, and the first one has used alpha already.  Look k > 1 gets alpha / (k (k + 1)); their sum over all k > 1 is
alpha / 2.  All looks together are thus wrong in at most 1.5 alpha of the experiments, however often a user looks.  As
they share their runs it is less: 6.1 % for alpha = 5 % and eight doublings by simulation, against 25 % with alpha at
every look.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import quantile
from rmpc_bench.types import Array

FLIPS = 4096
"""Random sign patterns; all of them where the runs have no more, which is up to 12 runs."""
_CHUNK = 512
MANY = 1000
"""Runs from which on the sums of flipped deviations are drawn as what they are then: normal, with their covariance."""


def held_level(contributions: Array, confidence: float, seed: int) -> float:
    """Return the level of each interval of a family, between the level `confidence` of all and that of Bonferroni.

    The contributions are (n_runs, n_comparisons) numbers whose means are compared with 0, such as log ratios; NaN where
    a pair is missing.

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
    """Yield blocks (patterns, n_comparisons) of sums of deviations with random signs."""
    # All sign patterns of few runs, random ones of more; of very many runs normal numbers, so that time and memory do
    # not grow with the number of runs.
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


def schedule(min_runs: int, max_runs: int) -> tuple[int, ...]:
    """Return the numbers of runs of planned looks: min_runs times powers of 2 below max_runs, and max_runs.

    >>> schedule(100, 2000), schedule(100, 400)
    ((100, 200, 400, 800, 1600, 2000), (100, 200, 400))
    """
    looks, n = [], min_runs
    while n < max_runs:
        looks.append(n)
        n *= 2
    return (*looks, max_runs)


def planned_level(confidence: float, n_looks: int) -> float:
    """Return the level of the intervals at each of so many planned looks.

    >>> round(planned_level(0.95, 6), 4)
    0.9917
    """
    return 1 - (1 - confidence) / n_looks


def next_width_look(n: int, half_width: float, resolve: float, every: int, max_runs: int) -> int:
    """Return the number of runs of the next look at the width of intervals.

    The width falls with the root of the number of runs.  The next look is half way to the number that would resolve, in
    steps of `every`, so that no look is wasted on intervals that are certainly too wide; it is at most twice the number
    now, as few runs predict badly.

    >>> next_width_look(100, 0.03, 0.02, 50, 2000), next_width_look(100, 0.021, 0.02, 50, 2000)
    (150, 150)
    >>> next_width_look(400, 0.05, 0.02, 50, 10_000), next_width_look(400, 0.05, 0.02, 50, 700)
    (800, 700)
    """
    distance = n * ((half_width / resolve) ** 2 - 1) / 2 if half_width < resolve * max_runs else n
    step = max(int(min(distance, n) / every), 1) * every
    return min(n + step, max_runs)


def unplanned_level(confidence: float, look: int) -> float:
    """Return the level of the intervals at a look, the first being 1.

    >>> [round(unplanned_level(0.95, look), 4) for look in (1, 2, 3)]
    [0.95, 0.9917, 0.9958]
    """
    return confidence if look <= 1 else 1 - (1 - confidence) / (look * (look + 1))


Look = int | str
"""Number of runs at which verdicts were published, with `statistics.adjust` behind it where that is not `auto`."""


def look_of(n_runs: int, adjust: Any) -> Look:
    """Return a look: the same runs with another adjustment are another one.

    >>> look_of(200, "auto"), look_of(200, "none")
    (200, '200 none')
    """
    return n_runs if adjust == "auto" else f"{n_runs} {adjust}"


def number_of_look(earlier: Sequence[Look], look: Look) -> int:
    """Return the number of a look, the first being 1; one that has taken place keeps its number.

    >>> number_of_look([], 200), number_of_look([200], 200), number_of_look([200], 400)
    (1, 1, 2)
    """
    return list(earlier).index(look) + 1 if look in earlier else len(earlier) + 1


class PlannedLook(NamedTuple):
    """A look of a stopping rule."""

    number: int  # the first is 1
    n_looks: int  # how many are possible; 0 where the levels do not depend on their number
    confidence: float  # level that all looks have together

    @property
    def text(self) -> str:
        """The look in words, for the line below a table.

        >>> PlannedLook(3, 6, 0.95).text
        'look 3 of 6, which together have the level 95 %'
        """
        if not self.n_looks:
            return f"look {self.number} at the width of the intervals, which keeps their level"
        return f"look {self.number} of {self.n_looks}, which together have the level {100 * self.confidence:g} %"
