"""Calibration: whether the shares of errors that lie in the regions of a reported covariance P are those promised.

The unit is the run: samples of a run are dependent.  The interval of a share is Student t over the runs.  Where fewer
than 10 runs are below 1, or above 0, it is that of Wilson with the number of runs, which is safe: the variance of a
share is at most c (1 - c).  The intervals at the level of the verdict hold together for all methods and points
(`levels`); those of other levels and of single states hold one by one.

With the share c of a region of level p the errors are f = sqrt(q_p / q_c) times as large as the reported standard
deviations, q the chi-square quantile with as many degrees of freedom as P most often has rank, in the recorded runs
where P differs from run to run, or as there are states where none is recorded.  Where ranks differ, f is exact at 1
only: with ranks 1 and 4 in equal parts it is 1.5 in place of 1.3.  A sample with P = 0 and without an error is covered
at every level.  The margin is the share for f from 1/(1 + margin) to 1 + margin.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.columns import Rows
from rmpc_bench.analysis.comparison_text import MOST_RUNS, about
from rmpc_bench.analysis.estimation_errors import recorded_errors
from rmpc_bench.analysis.intervals import Interval, student, wilson
from rmpc_bench.analysis.levels import held_level, unplanned_level
from rmpc_bench.analysis.superiority import runs_for_direction
from rmpc_bench.analysis.traces import COVARIANCE
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.numerics.error_size import normalised_squares
from rmpc_bench.types import Array

CALIBRATED, OVERCONFIDENT, CONSERVATIVE, INCONCLUSIVE = "calibrated", "overconfident", "conservative", "inconclusive"
UNCERTAIN = ", size uncertain"
FEW = 10  # runs below 1, or above 0, below which the interval is that of Wilson
OF_TAILS = 0.975  # level of each of the two intervals whose order says that tails are heavy or light
COLUMNS = "method of level covered low high n factor factor_low factor_high verdict".split()
"""Columns of calibration.csv; `of` is joint for all states, or one such as x.0."""


class Region(NamedTuple):
    """A region of a level p in n dimensions."""

    p: float
    n: int

    def factor(self, covered: float) -> float:
        """Return the size of the errors relative to the standard deviations for a share of covered ones."""
        from scipy.special import gammaincinv

        promised, found = (float(gammaincinv(self.n / 2, share)) for share in (self.p, covered))
        return math.nan if math.isnan(found) else math.sqrt(promised / found) if found else math.inf

    def margin(self, margin: float) -> Interval:
        """Return the shares for errors that are 1 + margin times as large as promised, and as small.

        >>> [round(end, 4) for end in Region(0.9, 2).margin(0.1)]
        [0.8509, 0.9383]
        """
        from scipy.special import gammainc, gammaincinv

        promised, f = float(gammaincinv(self.n / 2, self.p)), (1 + margin) ** 2
        return float(gammainc(self.n / 2, promised / f)), float(gammainc(self.n / 2, promised * f))


def share_interval(shares: Array, confidence: float) -> Interval:
    """Return the interval of the mean share over the runs; NaN without runs."""
    if min(np.count_nonzero(shares < 1), np.count_nonzero(shares > 0)) < FEW:
        return wilson(float(shares.sum()), len(shares), confidence)
    low, high = student(shares, confidence)
    return max(low, 0.0), min(high, 1.0)


def word(interval: Interval, p: float, margin: Interval) -> str:
    """Return the word for the interval of a share, the level p and the margin around it."""
    low, high = interval
    if margin[0] <= low and high <= margin[1]:
        return CALIBRATED
    if high < p:
        return OVERCONFIDENT + UNCERTAIN * (high >= margin[0])
    if low > p:
        return CONSERVATIVE + UNCERTAIN * (low <= margin[1])
    return INCONCLUSIVE


def runs_needed(shares: Array, p: float, margin: Interval, level: float) -> float:
    """Return about how many runs would give another word than inconclusive; NaN where that is not known."""
    c, n = float(shares.mean()), len(shares)
    sd = float(np.std(shares, ddof=1)) if n >= FEW else math.sqrt(c * (1 - c))
    # The interval has to leave p, or both ends of the margin.
    leaving, *ends = (runs_for_direction(c - end, sd, level) for end in (p, *margin))
    inside = max(ends) if margin[0] < c < margin[1] else math.nan
    return min((needed for needed in (leaving, inside) if n < needed <= MOST_RUNS), default=math.nan)


# Tables, screen, page and figures ask for them.
@lru_cache(maxsize=2)
def calibrations(trials: Trials) -> list[tuple[Trials, Rows]]:
    """Return every point with its rows of `COLUMNS`; no rows where the configuration asks for none."""
    keys = trials.calibration
    if keys is None:
        return [(point, []) for point in trials.each]
    whole, name = unplanned_level(trials.confidence, trials.look), keys.name(keys.verdict)
    runs = np.unique(np.concatenate([point.runs for point in trials.each]))
    every = [(point, method) for point in trials.each for method in point.methods]
    table = np.full((len(runs), len(every)), np.nan)
    for column, (point, method) in enumerate(every):
        table[np.searchsorted(runs, point.runs), column] = point.column(name, method)
    level = held_level(table, whole, trials.seed) if every else whole
    return [(p, [row for method in p.methods for row in _Shares(p, method, level).rows()]) for p in trials.each]


def states_of(point: Trials) -> list[str]:
    """Return the states that have shares of their own, such as x.0; none where there is one state only."""
    keys = point.calibration
    start = "" if keys is None else keys.name(keys.verdict, "x.")
    return [f"x.{info.name.removeprefix(start)}" for info in point.metrics if info.name.startswith(start)]


class _Shares:
    """Shares of a method at a point; the interval of the verdict has the level `held`."""

    def __init__(self, point: Trials, method: str, held: float) -> None:
        assert point.calibration is not None, "asked for"
        self.point, self.method, self.held, self.keys = point, method, held, point.calibration
        self.n = max(1, len(states_of(point)))
        P = next((each.values for each in point.series_of(COVARIANCE, method)), None)
        if P is None and (recorded := recorded_errors(point, method)) is not None:
            P = recorded.P
        if P is not None and (known := np.isfinite(P).all(axis=(-2, -1))).any():
            ranks = normalised_squares(np.zeros(P[known].shape[:-1]), P[known]).freedom.tolist()
            self.n = max(1, Counter(ranks).most_common(1)[0][0])

    def of(self, level: float, of: str = "joint") -> Array:
        """Return those of the runs that have one."""
        values = self.point.column(self.keys.name(level, of), self.method)
        return values[~np.isnan(values)]

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield a row per states and level, or one that says why there is none."""
        verdict = self.keys.verdict
        if not len(self.of(verdict)):
            finished = len(self.point.statuses(self.method)) - self.point.n_failed(self.method)
            row = dict.fromkeys(COLUMNS, math.nan) | {"method": self.method, "of": "joint", "level": verdict, "n": 0}
            yield row | {"verdict": "reports no covariance" if finished else "no finished run"}
            return
        for of in ("joint", *states_of(self.point)):
            for p in self.keys.levels:
                decides = of == "joint" and p == verdict
                shares, region = self.of(p, of), Region(p, self.n if of == "joint" else 1)
                low, high = ends = share_interval(shares, self.held if decides else self.point.confidence)
                c = float(shares.mean()) if len(shares) else math.nan
                # A larger share means smaller errors.
                factors = map(region.factor, (c, high, low))
                words = self._verdict(region, shares, ends) if decides and self.point.with_verdicts else ""
                yield dict(zip(COLUMNS, (self.method, of, p, c, *ends, len(shares), *factors, words), strict=True))

    def _verdict(self, region: Region, shares: Array, ends: Interval) -> str:
        """Return the word with what belongs to it."""
        margin = region.margin(self.keys.margin)
        found = word(ends, region.p, margin)
        if found == CALIBRATED:
            found += f" (within {100 * self.keys.margin:g} %)"
        elif found.startswith(CONSERVATIVE) and self.method in self.point.bounds:
            found = f"{CONSERVATIVE} (reports a bound)"
        elif found == INCONCLUSIVE and not math.isnan(n := runs_needed(shares, region.p, margin, self.held)):
            found += f" (runs needed: {about(n)})"
        return found + self._tails()

    def _tails(self) -> str:
        """Say whether errors far out are more frequent, or rarer, than those of a normal law of this size."""
        ends = []
        for p in (min(self.keys.levels), max(self.keys.levels)):
            low, high = share_interval(self.of(p), OF_TAILS)
            ends.append((Region(p, self.n).factor(high), Region(p, self.n).factor(low)))
        (low, high), (far_low, far_high) = ends
        return ", heavy tails" if high < far_low else ", light tails" if far_high < low else ""
