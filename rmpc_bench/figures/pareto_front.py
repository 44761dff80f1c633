"""Methods as points in the plane of two metrics, with their spread over the runs, and the Pareto front of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rmpc_bench.analysis.intervals import quantile, standard_error
from rmpc_bench.types import Array, DesignError, MetricInfo

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials


class Spread(NamedTuple):
    """A value and the ends of its bar, NaN where there is none."""

    low: float
    middle: float
    high: float


class Dot(NamedTuple):
    """A method at a point of the sweep."""

    method: str
    point: Trials
    x: Spread
    y: Spread
    n: int
    """Runs that have both values."""
    n_runs: int

    @property
    def is_finite(self) -> bool:
        """Whether it can be drawn."""
        return bool(np.isfinite([self.x.middle, self.y.middle]).all())


def dots_of(
    points: Sequence[Trials], methods: Sequence[str], infos: tuple[MetricInfo, MetricInfo], bars: str
) -> list[Dot]:
    """Find the dots of every method in the order of the sweep; trials that points share make one dot.

    Raises a DesignError when no method has a value of both metrics.
    """
    found: dict[tuple[str, str], Dot] = {}
    for name in methods:
        for point in points:
            key = name, point.keys.get(name, point.title)
            if name in point.methods and key not in found:
                found[key] = _dot(point, name, infos, bars)
    if not any(dot.is_finite for dot in found.values()):
        raise DesignError(f"no method has a value of both {infos[0].name} and {infos[1].name}", "x")
    return list(found.values())


def not_dominated(dots: Sequence[Dot], infos: tuple[MetricInfo, MetricInfo]) -> list[Dot]:
    """Find the drawable dots that are not dominated, from best in x to best in y, by the metrics' directions."""
    signs = [-1.0 if info.direction == "higher" else 1.0 for info in infos]
    costs = [(signs[0] * dot.x.middle, signs[1] * dot.y.middle) for dot in dots]
    best = [
        place
        for place, (x, y) in enumerate(costs)
        if not any(other[0] <= x and other[1] <= y and other != (x, y) for other in costs)
    ]
    return [dots[place] for place in sorted(best, key=lambda place: costs[place])]


def _dot(point: Trials, name: str, infos: tuple[MetricInfo, MetricInfo], bars: str) -> Dot:
    from rmpc_bench.analysis.pairs import distance_from_best

    columns = [point.column(info.name, name) for info in infos]
    both: Array = ~np.isnan(np.stack(columns)).any(axis=0)
    x, y = (
        spread_of(distance_from_best(column[both], info.direction), bars)
        for column, info in zip(columns, infos, strict=True)
    )
    return Dot(name, point, x, y, int(both.sum()), len(both))


def spread_of(values: Array, bars: str) -> Spread:
    """Return the median with the quartiles, or the mean with one standard error (`se`) on both sides, without NaN."""
    if bars == "quartiles":
        return Spread(*(float(quantile(values, share)) for share in (0.25, 0.5, 0.75)))
    with np.errstate(invalid="ignore", over="ignore"):
        mean = float(values.mean()) if len(values) else np.nan
    error = standard_error(values)
    return Spread(mean - error, mean, mean + error)
