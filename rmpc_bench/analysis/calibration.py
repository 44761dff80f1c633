"""Calibration: whether the shares of errors that lie in the regions of a reported covariance P are those promised.

The unit is the run: samples of a run are dependent.  The interval of a share is Student t over the runs.  Where fewer
than 10 runs are below 1, or above 0, it is that of Wilson with the number of runs, which is safe: the variance of a
share is at most c (1 - c).  The shares of the level of the verdict hold together for all methods and points (`levels`);
those of other levels and of single states have the level of the experiment one by one.

With the share c of a region of level p the errors are f = sqrt(q_p / q_c) times as large as the reported standard
deviations, q the chi-square quantile with as many degrees of freedom as P has rank.  The margin is the share for f from
1/(1 + margin) to 1 + margin.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.columns import Rows
from rmpc_bench.analysis.comparison_text import MOST_RUNS, about
from rmpc_bench.analysis.estimation_errors import normalised_squares
from rmpc_bench.analysis.intervals import NONE, Interval, student, wilson
from rmpc_bench.analysis.levels import held_level, unplanned_level
from rmpc_bench.analysis.superiority import runs_for_direction
from rmpc_bench.analysis.traces import COVARIANCE
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array
from rmpc_bench.types.metric import CalibrationKeys

CALIBRATED, OVERCONFIDENT, CONSERVATIVE = "calibrated", "overconfident", "conservative"
INCONCLUSIVE, NO_COVARIANCE, NO_RUN = "inconclusive", "reports no covariance", "no finished run"
UNCERTAIN = ", size uncertain"
FEW = 10
"""Runs below 1, or above 0, below which the interval is that of Wilson."""
OF_TAILS = 0.975
"""Level of each of the two intervals whose order says that tails are heavy or light."""


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """A share of errors in the region of a level; a row of calibration.csv.

    Parameters
    ----------
    method : name
    of : ``joint`` for all states, or one state such as ``x.0``
    level : probability of the region
    covered, low, high : mean share over the runs with its interval
    n : runs that count: finished ones with a covariance
    factor, factor_low, factor_high : size of the errors relative to the reported standard deviations
    verdict : in words, at the level of the verdict and for all states only
    """

    method: str
    of: str
    level: float
    covered: float = math.nan
    low: float = math.nan
    high: float = math.nan
    n: int = 0
    factor: float = math.nan
    factor_low: float = math.nan
    factor_high: float = math.nan
    verdict: str = ""


COLUMNS = [field.name for field in fields(Calibration)]


class Region(NamedTuple):
    """A region of a level p in n dimensions."""

    p: float
    n: int

    def factor(self, covered: float) -> float:
        """Return the size of the errors relative to the standard deviations for a share of covered ones.

        >>> round(Region(0.9, 1).factor(0.712), 2), Region(0.9, 2).factor(1.0), Region(0.9, 2).factor(0.0)
        (1.55, 0.0, inf)
        """
        from scipy.special import gammaincinv

        if math.isnan(covered) or not self.n:
            return math.nan
        promised, found = (float(gammaincinv(self.n / 2, share)) for share in (self.p, covered))
        return math.sqrt(promised / found) if found else math.inf

    def margin(self, margin: float) -> Interval:
        """Return the shares for errors that are 1 + margin times as large as promised, and as small.

        >>> [round(end, 4) for end in Region(0.9, 2).margin(0.1)]
        [0.8509, 0.9383]
        """
        from scipy.special import gammainc, gammaincinv

        promised = float(gammaincinv(self.n / 2, self.p))
        low, high = (float(gammainc(self.n / 2, promised / f**2)) for f in (1 + margin, 1 / (1 + margin)))
        return low, high


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


def calibrations(trials: Trials) -> list[tuple[Trials, Rows]]:
    """Return every point with its rows, the fields of `Calibration`; none where the configuration asks for none."""
    keys = trials.calibration
    if keys is None:
        return [(point, []) for point in trials.each]
    level = _held(trials, keys)
    every = [
        (point, [row for name in point.methods for row in _rows(point, keys, name, level)]) for point in trials.each
    ]
    return [(point, [*map(asdict, rows)]) for point, rows in every]


def _held(trials: Trials, keys: CalibrationKeys) -> float:
    """Return the level at which the intervals of the verdicts hold together."""
    whole, name = unplanned_level(trials.confidence, trials.look), keys.name(keys.verdict)
    runs = np.unique(np.concatenate([point.runs for point in trials.each]))
    columns = []
    for point, method in ((point, method) for point in trials.each for method in point.methods):
        columns.append(np.full(len(runs), np.nan))
        columns[-1][np.searchsorted(runs, point.runs)] = point.column(name, method)
    return held_level(np.stack(columns, axis=1), whole, trials.seed) if columns else whole


def _rows(point: Trials, keys: CalibrationKeys, method: str, held: float) -> Iterator[Calibration]:
    decisive = point.column(keys.name(keys.verdict), method)
    if np.isnan(decisive).all():
        n_finished = len(point.statuses(method)) - point.n_failed(method)
        yield Calibration(
            method=method, of="joint", level=keys.verdict, verdict=NO_COVARIANCE if n_finished else NO_RUN
        )
        return
    states = [of for of in states_of(point, keys) for _ in keys.levels]
    for of in ("joint", *dict.fromkeys(states)):
        for p in keys.levels:
            decides = of == "joint" and p == keys.verdict
            region = Region(p, _rank(point, keys, method) if of == "joint" else 1)
            yield _row(point, keys, method, of, region, held if decides else point.confidence, decides=decides)


def states_of(point: Trials, keys: CalibrationKeys) -> list[str]:
    """Return the states that have shares of their own, such as x.0; none where there is one state only."""
    start = keys.name(keys.verdict, "x.")
    return [f"x.{info.name.removeprefix(start)}" for info in point.metrics if info.name.startswith(start)]


def _row(
    point: Trials, keys: CalibrationKeys, method: str, of: str, region: Region, level: float, *, decides: bool
) -> Calibration:
    shares = _shares(point, keys, method, region.p, of)
    c = float(shares.mean()) if len(shares) else math.nan
    low, high = share_interval(shares, level)
    return Calibration(
        method=method,
        of=of,
        level=region.p,
        covered=c,
        low=low,
        high=high,
        n=len(shares),
        factor=region.factor(c),
        # A larger share means smaller errors.
        factor_low=region.factor(high),
        factor_high=region.factor(low),
        verdict=_verdict(point, keys, method, region, shares, level) if decides and point.with_verdicts else "",
    )


def _shares(point: Trials, keys: CalibrationKeys, method: str, level: float, of: str = "joint") -> Array:
    """Return the shares of the runs that have one."""
    values = point.column(keys.name(level, of), method)
    return values[~np.isnan(values)]


def _rank(point: Trials, keys: CalibrationKeys, method: str) -> int:
    """Return the rank that P has at most samples; the number of states where it depends on the data."""
    try:
        P = point.matrix_series(COVARIANCE, method)
    except KeyError:
        return max(1, len(states_of(point, keys)))
    ranks = normalised_squares(np.zeros(P.shape[:-1]), P).freedom.tolist()
    return int(Counter(ranks).most_common(1)[0][0])


def _verdict(point: Trials, keys: CalibrationKeys, method: str, region: Region, shares: Array, level: float) -> str:
    """Return the word with what belongs to it."""
    margin = region.margin(keys.margin)
    found = word(share_interval(shares, level), region.p, margin)
    if found == CALIBRATED:
        found = f"{CALIBRATED} (within {100 * keys.margin:g} %)"
    elif found.startswith(CONSERVATIVE) and method in point.bounds:
        found = f"{CONSERVATIVE} (reports a bound)"
    elif found == INCONCLUSIVE and not math.isnan(n := runs_needed(shares, region.p, margin, level)):
        found = f"{INCONCLUSIVE} (runs needed: {about(n)})"
    tails = _tails(point, keys, method, region.n)
    return f"{found}, {tails}" if tails else found


def _tails(point: Trials, keys: CalibrationKeys, method: str, n: int) -> str:
    """Say whether errors far out are more frequent, or rarer, than those of a normal law with errors of this size."""
    ends = []
    for p in (min(keys.levels), max(keys.levels)):
        low, high = share_interval(_shares(point, keys, method, p), OF_TAILS)
        ends.append((Region(p, n).factor(high), Region(p, n).factor(low)))
    (low, high), (far_low, far_high) = ends
    return "heavy tails" if high < far_low else "light tails" if far_high < low else ""
