"""What a figure of quantities over time shows: kinds of lines, their reach, and few points of each.

Points that a reader does not see are left out, so that an SVG stays small.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.figures.curves import Cell, Line
from rmpc_bench.figures.palette import DIM, GROUND, INK, PRINT, paler
from rmpc_bench.figures.quantities import Quantity
from rmpc_bench.figures.recorded_runs import RunSelection, TimeWindow
from rmpc_bench.types import Array

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

COLUMN, MOST_COLUMNS = 1.5, 4  # least width of a column [in], and columns up to which their panels are wide enough
FAR = 1.0  # a limit further away than this times the reach of the curves is not shown
WILD = 6.0  # reach of all runs, as a multiple of that of thick lines, up to which a panel shows them whole
MOST_THIN, MOST_OTHER = 1700, 1800
"""Points of all thin lines of a figure and of its other lines; a point has about 8 bytes in an SVG."""
TOLERANCES = (1 / 300, 1 / 200, 1 / 150)
"""Distances from a line that are not seen, as shares of the height of a panel; the first that gives few points."""
ASPECT = 1.5  # width of a panel, in heights
FEW_RUNS = 2  # thin lines of a panel that are shown in any case
CIRCLE: Mapping[str, Any] = {"ls": "", "marker": "o", "ms": 3.0, "mew": 0.7, "mfc": GROUND}
OWN = ""  # stands for the colour of the method


class Look(NamedTuple):
    """How a kind of line or area looks, and what it means."""

    look: str
    meaning: str
    style: Mapping[str, Any]


WORDS: Mapping[str, Look] = {
    "main": Look("thick", "", {"color": OWN, "lw": 1.5, "zorder": 3.0}),
    "run": Look("thin", "single runs", {"color": paler(INK, 0.7), "lw": 0.5, "zorder": 2.2}),
    "band": Look("area", "from 5 to 95 % of the runs", {"color": OWN, "zorder": 1.5}),
    "average": Look("thin dashes", "average over time", {"color": OWN, "lw": 0.7, "ls": (0, (3, 2)), "zorder": 2.4}),
    "spread": Look("thin coloured", r"mean $\pm 3$ standard deviations", {"color": OWN, "lw": 0.7, "zorder": 2.6}),
    "from runs": Look("pale", "from runs", {"color": OWN, "lw": 0.7, "alpha": 0.5, "zorder": 2.3}),
    "state": Look("black", "true state", {"color": INK, "lw": 0.8, "zorder": 2.8}),
    "outside": Look("circles", "outside", {**CIRCLE, "color": INK, "zorder": 3.2}),
    "reference": Look("dashed", "reference", {"color": INK, "lw": 0.9, "ls": (0, (4, 2)), "zorder": 2.5}),
    "limit": Look("dotted", "limit", {"color": PRINT["worse"], "lw": 1.0, "ls": (0, (1.2, 1.6)), "zorder": 2.5}),
    "bound": Look("dashed", "reported variance", {"color": INK, "lw": 1.0, "ls": (0, (4, 2)), "zorder": 2.9}),
    "reported": Look("grey", r"reported $\pm 3\sigma$", {"color": paler(DIM, 0.75), "zorder": 0.5}),
    "consistent": Look("grey", "band of a consistent estimator", {"color": paler(DIM, 0.75), "zorder": 0.5}),
    "set M": Look("area", "set $M$", {"color": OWN, "zorder": 1.5}),
    "set P": Look("area", "of $P$", {"color": OWN, "zorder": 1.5}),
}  # kinds of lines and areas in the order of the legend
QUIET: Mapping[str, Mapping[str, Any]] = {
    "zero": {"color": DIM, "lw": 0.6, "zorder": 2.1},
    "one": {"color": INK, "lw": 0.7, "zorder": 2.1},
}  # levels that need no entry in a legend
EDGES = {"reported": (0, (4, 2)), "set P": (0, (3, 1.5)), "set M": "-"}
"""Dashes of the lines around areas that have some."""


class Content(NamedTuple):
    """What a figure of quantities over time shows."""

    point: Trials
    title: str
    rows: Sequence[Quantity]
    cells: Mapping[str, Sequence[Cell | None]]  # method -> the content of its panels
    window: TimeWindow
    selections: Mapping[str, RunSelection]
    log: bool | None
    level: float
    run: int | None
    left_out: bool

    def columns(self, width: float) -> int:
        """Columns of panels in a picture of some width [in]; methods that do not fit stand below the others."""
        most = max(1, min(MOST_COLUMNS, int(width / COLUMN)))
        return -(-len(self.cells) // -(-len(self.cells) // most))

    def kinds(self) -> set[str]:
        """Kinds of lines, areas and levels that are shown."""
        rows = [[cell for cell in row if cell is not None] for row in zip(*self.cells.values(), strict=True)]
        kinds = {each[0] for row in rows for cell in row for group in cell for each in group}
        # Limits are shown where they lie in the reach of their panels.
        return kinds if any(reach_of(row)[1] for row in rows if row) else kinds - {"limit"}

    def words(self, kind: str) -> str:
        """Say what a kind of line means here."""
        if kind == "set P":
            return f"{100 * self.level:g} % of $P$"
        if kind == "consistent":
            return f"{100 * self.level:g} % {WORDS[kind].meaning}"
        if kind != "main":
            return WORDS[kind].meaning
        kinds = {each.kind for each in self.rows}
        found = []
        if kinds & {"recorded", "error", "tube"}:
            found.append(self._of_runs())
        found += ["average over the runs"] if kinds & {"nees", "nis"} else []
        found += ["variance of the error"] if "variance" in kinds else []
        found += ["mean of the estimate"] if "mean" in kinds else []
        found += ["value of the design"] if "series" in kinds else []
        return ", ".join(found)

    def _of_runs(self) -> str:
        """Say which run is thick, or what of all runs."""
        shown = self.kinds()
        if "band" in shown or "average" in shown:
            return "median" if "band" in shown else "width from 5 to 95 % of the runs"
        if self.run is not None:
            return f"run {self.run}"
        if all(len(each.rows) < 2 for each in self.selections.values()):
            found = {int(run) for name in self.selections for run in self.point.traces[name].runs[:1]}
            return f"run {found.pop()}" if len(found) == 1 else "the recorded run"
        info = self.point.primary_info or self.point.metrics[0]
        return f"run with the middle {info.words}"


def reach_of(cells: Sequence[Cell]) -> tuple[tuple[float, float], list[float]]:
    """Ends of what all panels of a quantity show, and the limits that are not far away from it."""
    thick = _ends([line.values for cell in cells for line in cell.lines if line.kind != "run"])
    whole = _ends([line.values for cell in cells for line in cell.lines])
    areas = _ends([end for cell in cells for area in cell.areas for end in (area.low, area.high)])
    room = WILD * ((thick[1] - thick[0]) or abs(thick[0]) or 1.0)
    low = min(max(whole[0], thick[0] - room), max(areas[0], thick[0] - room))
    high = max(min(whole[1], thick[1] + room), min(areas[1], thick[1] + room))
    reach = (high - low) or abs(high) or 1.0
    levels = {value for cell in cells for kind, value in cell.levels if kind == "limit"}
    limits = sorted(each for each in levels if low - FAR * reach <= each <= high + FAR * reach)
    return (min([low, *limits]), max([high, *limits])), limits


def _ends(values: Sequence[Array]) -> tuple[float, float]:
    """The smallest and the largest finite value; infinities in the wrong order without any."""
    every = np.concatenate([np.zeros(0), *map(np.ravel, values)])
    every = every[np.isfinite(every)]
    return (float(every.min()), float(every.max())) if len(every) else (np.inf, -np.inf)


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
    smallest = {id(line): _smallest_tolerances(line.t, line.values, height) for height, line in lines}
    for tolerance in TOLERANCES:
        found = {name: np.flatnonzero(each > tolerance) for name, each in smallest.items()}
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
    return np.flatnonzero(_smallest_tolerances(t, values, height) > tolerance)


def _smallest_tolerances(t: Array, values: Array, height: float) -> Array:
    """Smallest tolerance that does without each point; 0 where the smallest of `TOLERANCES` does, inf in gaps."""
    finite = np.isfinite(values)
    if not finite.any():
        return np.zeros(len(t))
    across = ASPECT * (t - t[0]) / ((t[-1] - t[0]) or 1.0)
    points = np.stack([across, np.where(finite, values, 0.0) / (height or 1.0)], axis=1)
    edges = np.flatnonzero(np.diff(finite.astype(np.int64))) + 1
    found = np.full(len(t), np.inf)
    for piece in np.split(np.arange(len(t)), edges):
        if finite[piece[0]]:
            found[piece] = _of_broken_line(points[piece])
    return found


def _of_broken_line(points: Array) -> Array:
    """Smallest tolerances for a line without gaps, whose parts are the same with every tolerance, up to the last."""
    found = np.zeros(len(points))
    found[[0, -1]] = np.inf
    parts = [(0, len(points) - 1, np.inf)]
    while parts:
        first, last, of_part = parts.pop()
        if last - first < 2:
            continue
        along = points[last] - points[first]
        gap = points[first + 1 : last] - points[first]
        away = np.abs(along[0] * gap[:, 1] - along[1] * gap[:, 0]) / (np.hypot(*along) or 1.0)
        worst = int(np.argmax(away))
        if away[worst] > TOLERANCES[0]:
            middle = first + 1 + worst
            found[middle] = min(of_part, float(away[worst]))
            parts += [(first, middle, found[middle]), (middle, last, found[middle])]
    return found
