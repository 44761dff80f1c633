"""Logarithms of a metric at all points of a sweep, and their differences between two methods, run by run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.analysis.failures import FACTOR
from rmpc_bench.analysis.pairs import distance_from_best
from rmpc_bench.analysis.rounding import NEGLIGIBLE
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array, MetricInfo


class Difference(NamedTuple):
    """The difference of the mean logarithms of two methods, distributed over the runs."""

    per_run: Float[Array, " runs"]
    """Numbers whose mean is the difference; NaN where no point is used."""
    n_points: int
    """Points that it rests on."""
    n_pairs: int
    """Runs of these points that both methods finished."""


@dataclass(frozen=True, eq=False)
class Losses:
    """Logarithms of a metric at all points of a sweep, smaller ones better.

    Parameters
    ----------
    methods : names of axis 1
    logs : NaN where the run failed or is not there
    failed : whether the run failed
    """

    methods: tuple[str, ...]
    logs: Float[Array, "points methods runs"]
    failed: Bool[Array, "points methods runs"]

    def difference(
        self, method: int, other: int, points: Sequence[int] | None = None, *, failed: str = "left out"
    ) -> Difference:
        """Average the differences of two methods over points with equal weights.

        Every point counts by its own mean, whatever the number of runs that both methods finished there.  The deviation
        of a run from that mean has the weight (number of runs)/(number of pairs).

        Parameters
        ----------
        method, other : their places; the difference is the first minus the second
        points : places of the points; all unless given
        failed : ``left out``, or ``worst``: as the worst finished run at the point, and worse than its partner
        """
        chosen = slice(None) if points is None else list(points)
        a, b = self.logs[chosen, method], self.logs[chosen, other]
        if failed == "worst":
            worst, step = self._worst[chosen][:, None], np.log(FACTOR)
            of_a, of_b = np.fmax(worst, b + step), np.fmax(worst, a + step)
            a, b = np.where(self.failed[chosen, method], of_a, a), np.where(self.failed[chosen, other], of_b, b)
        gap = a - b
        # Two values that differ by rounding errors only are equal.
        gap = np.where(np.abs(gap) <= NEGLIGIBLE, 0.0, gap)
        there = np.isfinite(gap)
        n = there.sum(axis=1)
        used = n > 0
        if not used.any():
            return Difference(np.full(gap.shape[1], np.nan), 0, 0)
        gap, there, n = gap[used], there[used], n[used][:, None]
        mean = np.where(there, gap, 0.0).sum(axis=1, keepdims=True) / n
        parts = mean + np.where(there, gap - mean, 0.0) * (gap.shape[1] / n)
        return Difference(parts.mean(axis=0), int(used.sum()), int(there.sum()))

    def failures(self, method: int, other: int) -> Float[Array, " runs"]:
        """Return the share of points at which a method fails, minus that of another one, of every run."""
        gap = self.failed[:, method].astype(float) - self.failed[:, other]
        return np.asarray(gap.mean(axis=0))

    @property
    def _worst(self) -> Float[Array, " points"]:
        """The largest logarithm of all methods at every point; 0 where no run is finished."""
        finite = np.isfinite(self.logs)
        largest = np.where(finite, self.logs, -np.inf).max(axis=(1, 2), initial=-np.inf)
        return np.where(finite.any(axis=(1, 2)), largest, 0.0)


def losses(trials: Trials, info: MetricInfo) -> Losses | None:
    """Collect the logarithms of a metric; None where a finished run has a value without one: 0, negative or inf."""
    methods = trials.methods
    runs = np.unique(np.concatenate([point.runs for point in trials.each]))
    shape = (len(trials.each), len(methods), len(runs))
    values, failed = np.full(shape, np.nan), np.zeros(shape, dtype=bool)
    for number, point in enumerate(trials.each):
        places = np.searchsorted(runs, point.runs)
        for column, name in enumerate(methods):
            values[number, column, places] = distance_from_best(point.column(info.name, name), info.direction)
            failed[number, column, places] = point.failed(name)
    values[failed] = np.nan
    known = ~np.isnan(values)
    if not (known.any() and np.isfinite(values[known]).all() and (values[known] > 0).all()):
        return None
    sign = -1.0 if info.direction == "higher" else 1.0
    return Losses(methods, sign * np.log(values), failed)
