"""Comparisons entry by entry, over k or over states, by a simultaneous band over all entries.

The ends of the band are quantiles of the largest t and of the largest -t over all entries when groups of runs are drawn
again (bootstrap-t with equal tails), so that the band covers all entries together with the probability of one interval.
For the variance at 30 correlated samples of 50 and 200 runs it covers 0.95 of the time at 95 %; random signs of the
groups, which lose the skewness, 0.72 and 0.86.  With fewer than `FEW_GROUPS` groups too few resamples differ, and the
width is that of Bonferroni.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import difference
from rmpc_bench.claims import tree
from rmpc_bench.claims.decision import decided
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.jackknife import PseudoValues, pseudo_values
from rmpc_bench.claims.levels import ORDER, estimates, unseen
from rmpc_bench.claims.spread import UNKNOWN, BandSpread, Spread
from rmpc_bench.expressions.arithmetic import Call
from rmpc_bench.types import Array

_RESAMPLES = 1999
_CHUNK = 100
FEW_GROUPS = 10
"""Groups below which the width is that of Bonferroni: sample variances of few groups are nearly 0 too often."""


class Band(NamedTuple):
    """Simultaneous interval of every entry."""

    low: Array
    high: Array


def entry_by_entry(
    link: tree.Link, evaluator: Evaluator, confidence: float, place: tuple[int, ...], *, about_runs: bool
) -> tuple[Spread | None, tuple[int, ...]]:
    """Find how uncertain the entry is that decides a comparison of series, vectors or matrices, and its place.

    No spread where no entry is estimated, or where the entries are runs (`about_runs`).
    """
    if about_runs or not evaluator.is_estimated(link):
        return None, place
    # Leaving groups of runs out says nothing of quantiles, nor of what was not seen.
    of_order = any(isinstance(node, Call) and node.function in ORDER for node in estimates(link, evaluator))
    values = None if of_order or unseen(link, evaluator, confidence) else pseudo_values(link, evaluator)
    if values is None:
        return UNKNOWN, place
    bands = {shift: gap_band(values, confidence, evaluator.trials.seed, shift) for shift in (-1, 0, 1)}

    def at(entry: tuple[int, ...]) -> BandSpread:
        return BandSpread({shift: (float(band.low[entry]), float(band.high[entry])) for shift, band in bands.items()})

    # A failing entry decides, else an inconclusive one; the tightest entry, if it is one of these.
    order = {False: 0, None: 1, True: 2}
    entries = [place, *np.ndindex(bands[0].low.shape)]
    ranks = [order[decided(link.operator, at(entry))] for entry in entries]
    worst = entries[ranks.index(min(ranks))]
    return at(worst), worst


def band(values: Array, confidence: float, seed: int) -> Band:
    """Compute the simultaneous band of the mean of pseudo-values (groups, ...)."""
    from scipy import special

    n, shape = len(values), values.shape[1:]
    flat = values.reshape(n, -1)
    centre = flat.mean(axis=0)
    deviation = flat - centre
    squares = (deviation**2).sum(axis=0)
    varying = squares > 0
    # The band is never narrower than the interval of one entry.
    factors = np.full(2, special.stdtrit(n - 1, (1 + confidence) / 2))
    if n < FEW_GROUPS:
        factors[:] = special.stdtrit(n - 1, 1 - (1 - confidence) / (2 * max(int(varying.sum()), 1)))
    elif varying.any():
        largest = _largest_t(deviation[:, varying] / np.sqrt(squares[varying]), seed)
        rank = min(_RESAMPLES, math.ceil((_RESAMPLES + 1) * (1 + confidence) / 2)) - 1
        factors = np.maximum(np.sort(largest, axis=1)[:, rank], factors)
    below, above = (np.where(varying, factor * np.sqrt(squares / (n * (n - 1))), 0.0) for factor in factors)
    return Band((centre - below).reshape(shape), (centre + above).reshape(shape))


def _largest_t(deviation: Array, seed: int) -> Array:
    """Draw groups again and return the largest t and the largest -t over all entries, (2, _RESAMPLES).

    It is inf where an entry has no spread in a resample.
    """
    n = len(deviation)
    rng = np.random.Generator(np.random.PCG64(seed))
    counts = rng.multinomial(n, np.full(n, 1 / n), _RESAMPLES).astype(float)
    found = []
    for first in range(0, _RESAMPLES, _CHUNK):
        part = counts[first : first + _CHUNK]
        mean = part @ deviation / n
        variance = np.maximum(part @ deviation**2 - n * mean**2, 0.0) / (n * (n - 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(mean == 0, 0.0, mean / np.sqrt(variance))
        found.append(np.stack([t.max(axis=1), -t.min(axis=1)]))
    return np.concatenate(found, axis=1)


def gap_band(values: PseudoValues, confidence: float, seed: int, shift: int = 0) -> Band:
    """Compute the band of left - right + shift * tolerance."""
    gap = difference(values.left, values.right)
    return band(gap + shift * values.tolerance if shift else gap, confidence, seed)
