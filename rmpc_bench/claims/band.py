"""Comparisons entry by entry, over k or over states, by a simultaneous band over all entries.

The width of the band is a quantile of the largest t over all entries when the signs of the groups of runs are drawn at
random, so that the band covers all entries together with the probability of one interval.
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
from rmpc_bench.claims.spread import UNKNOWN, BandSpread, Spread, about_these_runs
from rmpc_bench.types import Array

_FLIPS = 1999


class Band(NamedTuple):
    """Simultaneous interval of every entry."""

    low: Array
    high: Array


def entry_by_entry(
    link: tree.Link, evaluator: Evaluator, confidence: float, place: tuple[int, ...], *, about_runs: bool
) -> tuple[Spread | None, tuple[int, ...]]:
    """Find how uncertain the entry is that decides a comparison of series, vectors or matrices.

    Parameters
    ----------
    link : the comparison
    evaluator : made for it
    confidence : probability that the band covers all entries
    place : entry with the smallest margin
    about_runs : whether the entries are runs, so that the statement is about every run at hand

    Returns
    -------
    spread of the entry that decides, and its place; no spread where no entry is estimated
    """
    estimated = bool(evaluator.sampled) or (len(evaluator.runs) > 1 and not about_these_runs(link, evaluator))
    if about_runs or not estimated:
        return None, place
    values = pseudo_values(link, evaluator)
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
    """Compute the simultaneous band of the mean of pseudo-values.

    Parameters
    ----------
    values : (groups, ...) pseudo-values
    confidence : probability that the band covers all entries
    seed : of the random signs

    Returns
    -------
    low and high, each of the shape of one entry
    """
    from scipy import stats

    n, shape = len(values), values.shape[1:]
    flat = values.reshape(n, -1)
    centre = flat.mean(axis=0)
    deviation = flat - centre
    squares = (deviation**2).sum(axis=0)
    varying = squares > 0
    rng = np.random.Generator(np.random.PCG64(seed))
    signs = rng.choice([-1.0, 1.0], (_FLIPS, n))
    means = signs @ deviation[:, varying] / n
    # The spread about the mean with these signs; the sum of squares does not depend on them.
    spread = (squares[varying] - n * means**2) / (n * (n - 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        largest = np.max(np.abs(means) / np.sqrt(np.maximum(spread, 0.0)), axis=1, initial=0.0)
    rank = min(_FLIPS, math.ceil((_FLIPS + 1) * confidence)) - 1
    # Few groups have few patterns of signs: the band is never narrower than the interval of one entry.
    factor = max(float(np.sort(largest)[rank]), float(stats.t.ppf((1 + confidence) / 2, n - 1)))
    reach = np.where(varying, factor * np.sqrt(squares / (n * (n - 1))), 0.0)
    return Band((centre - reach).reshape(shape), (centre + reach).reshape(shape))


def gap_band(values: PseudoValues, confidence: float, seed: int, shift: int = 0) -> Band:
    """Compute the band of left - right + shift * tolerance."""
    gap = difference(values.left, values.right)
    return band(gap + shift * values.tolerance if shift else gap, confidence, seed)
