"""Where a method does worst: the fifth of one uncertain quantity with the worst mean response.

Many fifths are compared, so the worst one looks worse than it is.  The intervals of all fifths hold simultaneously
(Bonferroni): with the level of the experiment each of them contains the mean of its fifth, the chosen one too.  The
fifth differs from the whole where its interval lies on the worse side of the mean of all runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import Interval, student, wilson
from rmpc_bench.types import Array

PARTS = 5
FEWEST = 10
"""Runs below which a fifth is not considered."""
FEWEST_FAILED = 5
"""Failed runs below which no region is named for them."""
NAMES = ("lowest", "second lowest", "middle", "second highest", "highest")


class Region(NamedTuple):
    """A fifth of a quantity, or one of its values where it has at most five."""

    quantity: str
    name: str
    """Such as ``lowest``; empty for a single value."""
    low: float
    high: float
    inside: Array
    """(n,) which runs are in it."""


class RegionMean(NamedTuple):
    """Mean of a response in a region."""

    region: Region
    mean: float
    interval: tuple[float, float]
    """Simultaneous for all regions."""
    overall: float
    higher: bool = False
    """Whether higher responses are better."""

    @property
    def differs(self) -> bool:
        """Whether the interval lies on the worse side of the mean of all runs."""
        return self.interval[1] < self.overall if self.higher else self.interval[0] > self.overall


def regions(values: Mapping[str, Array]) -> Iterator[Region]:
    """Yield the fifths of every quantity."""
    for name, column in values.items():
        order = np.argsort(column, kind="stable")
        ordered = column[order]
        ends = np.flatnonzero(ordered[1:] != ordered[:-1]) + 1
        if len(ends) < PARTS:
            parts = [("", places) for places in np.split(order, ends)]
        else:
            parts = list(zip(NAMES, np.array_split(order, PARTS), strict=True))
        for word, places in parts:
            inside = np.zeros(len(column), dtype=bool)
            inside[places] = True
            if len(places) >= FEWEST:
                yield Region(name, word, float(column[places].min()), float(column[places].max()), inside)


def worst_means(
    values: Mapping[str, Array],
    response: Array,
    confidence: float,
    *,
    higher: bool = False,
    interval: Callable[[Array, float], Interval] = student,
    parts: Sequence[Region] | None = None,
) -> dict[str, RegionMean]:
    """Find the worst region of every quantity that varies; all intervals hold together.

    `parts` are the `regions` of the values, where they are known from another response in the same runs.
    """
    found = list(regions(values)) if parts is None else parts
    level = 1 - (1 - confidence) / max(len(found), 1)
    sign = -1.0 if higher else 1.0
    worst: dict[str, RegionMean] = {}
    overall = float(response.mean())
    for region in found:
        inside = response[region.inside]
        each = RegionMean(region, float(inside.mean()), interval(inside, level), overall, higher)
        known = worst.get(region.quantity)
        if known is None or sign * each.mean > sign * known.mean:
            worst[region.quantity] = each
    return worst


def most_failures(values: Mapping[str, Array], failed: Array, confidence: float) -> RegionMean | None:
    """Find the region with the largest share of failed runs, with its Wilson interval, for all regions together.

    None with fewer than `FEWEST_FAILED` failed runs.
    """
    found = list(regions(values)) if failed.sum() >= FEWEST_FAILED else []
    if not found:
        return None
    level = 1 - (1 - confidence) / len(found)
    worst = max(found, key=lambda region: float(failed[region.inside].mean()))
    inside = failed[worst.inside]
    return RegionMean(worst, float(inside.mean()), wilson(int(inside.sum()), len(inside), level), float(failed.mean()))
