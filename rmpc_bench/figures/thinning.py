"""Lines with few points: those that a reader does not see are left out, so that an SVG stays small."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rmpc_bench.figures.curves import Cell, Line
from rmpc_bench.types import Array

MOST_THIN, MOST_OTHER = 1700, 1800
"""Points of all thin lines of a figure and of its other lines; a point has about 8 bytes in an SVG."""
TOLERANCES = (1 / 300, 1 / 200, 1 / 150)
"""Distances from a line that are not seen, as shares of the height of a panel; the first that gives few points."""
ASPECT = 1.5
"""Width of a panel, in heights."""
FEW_RUNS = 2
"""Thin lines of a panel that are shown in any case."""


def thinned(rows: Sequence[tuple[float, Sequence[Cell]]]) -> dict[int, Array]:
    """Choose the points of all lines that have too many, by their `id`; of too many runs the last ones have none.

    `rows` has the height of the panels of a quantity, in its unit, and what they show.  Every point is one of the
    stored samples, and so are the largest and the smallest value.
    """
    panels = [(height, cell) for height, cells in rows for cell in cells]
    runs = [(height, [line for line in cell.lines if line.kind == "run"]) for height, cell in panels]
    others = [(height, line) for height, cell in panels for line in cell.lines if line.kind not in ("run", "outside")]
    found = {} if sum(len(line.t) for _, line in others) <= MOST_OTHER else _fewer(others, MOST_OTHER)
    thin = _fewer([(height, line) for height, lines in runs for line in lines], MOST_THIN, is_last=False)
    share = MOST_THIN / max(1, sum(map(len, thin.values())))
    if share < 1:
        shown = [(height, lines[: max(FEW_RUNS, int(share * len(lines)))]) for height, lines in runs]
        left_out = [line for (_, lines), (_, kept) in zip(runs, shown, strict=True) for line in lines[len(kept) :]]
        thin = _fewer([(height, line) for height, lines in shown for line in lines], MOST_THIN)
        thin |= {id(line): np.zeros(0, dtype=np.int64) for line in left_out}
    return found | thin


def _fewer(lines: Sequence[tuple[float, Line]], most: int, *, is_last: bool = True) -> dict[int, Array]:
    """Choose points by the first tolerance that gives few of them, else the ends of equal parts of the time."""
    found: dict[int, Array] = {}
    for tolerance in TOLERANCES:
        found = {id(line): needed_points(line.t, line.values, height, tolerance) for height, line in lines}
        if sum(map(len, found.values())) <= most:
            return found
    if not is_last:
        return found
    n = max(10, most // (2 * len(lines)))
    return {
        id(line): _extremes(line.values, n) if len(found[id(line)]) > 2 * n else found[id(line)] for _, line in lines
    }


def _extremes(values: Array, n: int) -> Array:
    """Positions of the smallest and the largest value in each of n parts, and of both ends."""
    kept = {0, len(values) - 1}
    for part in np.array_split(np.arange(len(values)), n):
        known = part[np.isfinite(values[part])]
        kept |= {int(known[np.argmin(values[known])]), int(known[np.argmax(values[known])])} if len(known) else set()
    return np.array(sorted(kept))


def needed_points(t: Array, values: Array, height: float, tolerance: float = TOLERANCES[0]) -> Array:
    """Positions of the points that a line needs in a panel of some height (Douglas, Peucker 1973); gaps stay."""
    finite = np.isfinite(values)
    if not finite.any():
        return np.zeros(0, dtype=np.int64)
    across = ASPECT * (t - t[0]) / ((t[-1] - t[0]) or 1.0)
    points = np.stack([across, np.where(finite, values, 0.0) / (height or 1.0)], axis=1)
    edges = np.flatnonzero(np.diff(finite.astype(np.int64))) + 1
    keep = ~finite
    for piece in np.split(np.arange(len(t)), edges):
        if finite[piece[0]]:
            keep[piece] = _needed(points[piece], tolerance)
    return np.flatnonzero(keep)


def _needed(points: Array, tolerance: float) -> Array:
    """Whether each point of a broken line is needed for a distance of at most the tolerance."""
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    parts = [(0, len(points) - 1)]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        along = points[last] - points[first]
        gap = points[first + 1 : last] - points[first]
        away = np.abs(along[0] * gap[:, 1] - along[1] * gap[:, 0]) / (np.hypot(*along) or 1.0)
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            middle = first + 1 + worst
            keep[middle] = True
            parts += [(first, middle), (middle, last)]
    return keep
