"""Where the ranking of two methods turns along a swept number, such as the scale of the uncertainty.

The runs of all points have the same draws, so that points differ in the swept number only.  A point has a sign where
the interval of the change from the baseline excludes 0.  A turn lies between two points of opposite signs without a
sign between them.  The intervals are simultaneous, so that with the level of the experiment every turn is one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rmpc_bench.analysis.comparison import Levels, compared, levels
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import MetricInfo

ENDS = ("low", "high")


@dataclass(frozen=True, eq=False)
class Track:
    """A method against the baseline along a swept number.

    Parameters
    ----------
    path : swept path
    others : title of the points without the path; empty without other coordinates
    method : name of the method
    places : values of the path, ascending
    rows : comparison at each of them, with the fields of `Comparison`
    points : the tables of the points
    """

    path: str
    others: str
    method: str
    places: tuple[float, ...]
    rows: tuple[Mapping[str, Any], ...]
    points: tuple[Trials, ...]

    @property
    def changes(self) -> tuple[float, ...]:
        """Change at each place, negative where the metric is lower; NaN where there is none."""
        return tuple(float(row["difference" if row["average"] == "difference" else "change_pct"]) for row in self.rows)

    @property
    def signs(self) -> tuple[int, ...]:
        """Sign of the change at each place; 0 where its interval contains 0, or where there is none."""
        names = ["difference" if row["average"] == "difference" else "ci" for row in self.rows]
        low, high = ([float(row[f"{name}_{end}"]) for row, name in zip(self.rows, names, strict=True)] for end in ENDS)
        return signs(low, high)

    @property
    def turns(self) -> tuple[tuple[int, int], ...]:
        """Pairs of places between which the sign turns; places without a sign are passed over."""
        return turns(self.signs)


def signs(low: Sequence[float], high: Sequence[float]) -> tuple[int, ...]:
    """Return the sign of every interval that excludes 0, else 0.

    Parameters
    ----------
    low, high : ends of the intervals; NaN where there is none

    Examples
    --------
    >>> signs([-2, -1, 1, float("nan")], [-1, 1, 2, float("nan")])
    (-1, 0, 1, 0)
    """
    return tuple(1 if a > 0 else -1 if b < 0 else 0 for a, b in zip(low, high, strict=True))


def turns(of: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Return the pairs of places with opposite signs that have only zeros between them.

    Examples
    --------
    >>> turns([-1, 0, 1, 1])
    ((0, 2),)
    """
    known = [place for place, sign in enumerate(of) if sign]
    return tuple((a, b) for a, b in zip(known, known[1:], strict=False) if of[a] != of[b])


def numeric_paths(trials: Trials) -> tuple[str, ...]:
    """Return the swept paths along which there are at least two different finite numbers and nothing else."""
    found = []
    for path in trials.paths:
        values = {_number(point.point[path]) for point in trials.points if path in point.point}
        if None not in values and len(values) > 1:
            found.append(path)
    return tuple(found)


def tracks(trials: Trials, path: str, info: MetricInfo | None = None, of: Levels | None = None) -> Iterator[Track]:
    """Yield every method along a swept number, for each combination of the other coordinates.

    Parameters
    ----------
    trials : the table of a sweep
    path : one of `numeric_paths`
    info : the metric; the primary one unless given
    of : levels of the intervals; those that are simultaneous for the whole experiment unless given
    """
    of = of or levels(trials)
    groups: dict[tuple[tuple[str, str], ...], list[Trials]] = {}
    for point in sorted(trials.points, key=lambda point: float(point.point[path])):
        others = tuple((name, value) for name, value in point.point.items() if name != path)
        groups.setdefault(others, []).append(point)
    for points in groups.values():
        rows = [_rows(point, info, of) for point in points]
        for method in trials.methods:
            shown = [n for n, each in enumerate(rows) if method in each]
            if len(shown) > 1:
                yield Track(
                    path,
                    _title_without(points[0], path),
                    method,
                    tuple(float(points[n].point[path]) for n in shown),
                    tuple(rows[n][method] for n in shown),
                    tuple(points[n] for n in shown),
                )


def failed_shares(points: Sequence[Trials], method: str) -> list[tuple[int, int]]:
    """Count the failed runs and all runs of a method at every point."""
    return [(point.n_failed(method), int((point.frame["method"] == method).sum())) for point in points]


def _rows(point: Trials, info: MetricInfo | None, of: Levels) -> dict[str, Mapping[str, Any]]:
    metric = info or point.primary_info
    return {} if metric is None else {row.method: asdict(row) for _, row in compared(point, metric, of)}


def _title_without(point: Trials, path: str) -> str:
    """Return the title of a point without one of its coordinates; values that change together have one name in it."""
    title = point.title or ", ".join(f"{name}={value}" for name, value in point.point.items())
    return f", {title}, ".replace(f", {path}={point.point[path]}, ", ", ")[2:-2]


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
