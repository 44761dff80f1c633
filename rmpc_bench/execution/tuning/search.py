"""Which values of the parameters of a method are tried, from the objectives of those that have been.

A search is a function of the evaluations so far: the same call after an interruption asks for the same values.  Inside,
every parameter is a number z from 0 to 1 along its range, on its scale.  Values are rounded to four significant digits
without their offset, so that another CPU tries the same ones, and an equal value is evaluated once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from rmpc_bench.numerics.direct_search import first_simplex, golden_section, halton, minimise
from rmpc_bench.types import Array
from rmpc_bench.types.tuning import TunedParameter

DIGITS = 4
"""Significant digits of a value that is tried, without its offset."""
GRID_SHARE = 9.0 / 16.0
"""Share of the budget for the grid: 9 of 16 values."""
LARGEST = 1e300
"""Stands for an infinite objective in Nelder and Mead's method, which takes differences."""

Row = tuple[float, ...]
"""A value for every parameter, the offset added."""


class Candidate(NamedTuple):
    """Values that are to be tried."""

    row: Row
    stage: str  # ``grid``, ``golden``, ``quasi-random`` or ``nelder-mead``


def value_at(parameter: TunedParameter, z: float) -> float:
    """Return the rounded value of a parameter at a place z from 0, the lower end of its range, to 1, the upper one.

    Examples
    --------
    >>> radius = TunedParameter("estimator.radius", 0.01, 10.0)
    >>> [value_at(radius, z) for z in (0.0, 0.5, 1.0)]
    [0.01, 0.3162, 10.0]
    """
    low, high = parameter.low, parameter.high
    z = min(max(z, 0.0), 1.0)
    number = low * (high / low) ** z if parameter.scale == "log" else low + (high - low) * z
    if parameter.integer:
        number = float(round(number))
    # The ends themselves keep all digits.
    number = {0.0: low, 1.0: high}.get(z, min(max(float(f"{number:.{DIGITS}g}"), low), high))
    return float(f"{number + parameter.offset:.12g}")


def row_at(parameters: Sequence[TunedParameter], place: Iterable[float]) -> Row:
    """Return the values at a place, one coordinate from 0 to 1 for each parameter."""
    return tuple(value_at(each, float(z)) for each, z in zip(parameters, place, strict=True))


class _Evaluations:
    """Looks objectives up in the order in which a search asks for them; `budget` is the number of different values."""

    def __init__(self, known: Mapping[Row, float], budget: int) -> None:
        self._known, self._budget = known, budget
        self.used: dict[Row, str] = {}
        """Values in the order in which they were asked for first -> stage."""
        self.wanted: dict[Row, str] = {}

    @property
    def is_spent(self) -> bool:
        """Whether no further value may be asked for."""
        return len(self.used) >= self._budget

    def ask(self, candidates: Iterable[Candidate]) -> None:
        """Ask for several values at once; _NeedsMore if the objective of one of them is not known."""
        for row, stage in candidates:
            if row not in self.used:
                if self.is_spent:
                    break
                self.used[row] = stage
                if row not in self._known:
                    self.wanted[row] = stage
        if self.wanted:
            raise _NeedsMore

    def __call__(self, row: Row, stage: str) -> float:
        """Return an objective; _NeedsMore if it is not known, _Spent if the budget does not allow to ask for it."""
        if row not in self.used and self.is_spent:
            raise _Spent
        self.ask([Candidate(row, stage)])
        return self._known[row]


class _NeedsMore(Exception):
    """Objectives are missing."""


class _Spent(Exception):
    """The budget is spent."""


class Plan(NamedTuple):
    """What a search asks for after some evaluations."""

    wanted: tuple[Candidate, ...]  # values whose objective is needed next; none where the search has ended
    used: tuple[Candidate, ...]  # all values in the order in which they were asked for, the wanted ones included


def plan(
    parameters: Sequence[TunedParameter], budget: int, search: str, known: Mapping[Row, float], start: int = 0
) -> Plan:
    """Return what to try next, within a budget of different values.

    The search is ``auto``, ``grid-golden``, ``nelder-mead`` or ``quasi-random``, with the index of its first random
    point.  Objectives of known values may be infinite.
    """
    evaluations = _Evaluations(known, budget)
    name = search if search != "auto" else "grid-golden" if len(parameters) == 1 else "nelder-mead"
    try:
        _SEARCHES[name](parameters, budget, evaluations, start)
    except (_NeedsMore, _Spent):
        pass
    return Plan(
        tuple(Candidate(*each) for each in evaluations.wanted.items()),
        tuple(Candidate(*each) for each in evaluations.used.items()),
    )


def _grid_golden(parameters: Sequence[TunedParameter], budget: int, evaluate: _Evaluations, start: int) -> None:
    """Evaluate a grid, then golden section between the neighbours of its best point."""
    [parameter] = parameters
    n = min(budget, max(2, math.floor(GRID_SHARE * budget + 0.5)))
    grid = [i / (n - 1) for i in range(n)] if n > 1 else [0.5]
    evaluate.ask(Candidate(row_at(parameters, [z]), "grid") for z in grid)
    rows = {row_at(parameters, [z]): z for z in reversed(grid)}
    places = sorted(rows.values())

    def objective(z: float) -> float:
        return evaluate(row_at([parameter], [z]), "golden")

    best = min(places, key=lambda z: (evaluate(row_at([parameter], [z]), "grid"), z))
    i = places.index(best)
    golden_section(objective, places[max(i - 1, 0)], best, places[min(i + 1, len(places) - 1)])
    if parameter.integer:
        _step_to_neighbours(parameter, evaluate)


def _step_to_neighbours(parameter: TunedParameter, evaluate: _Evaluations) -> None:
    """Go from the best integer to a better one beside it until there is none: golden section passes over some."""
    best = min(evaluate.used, key=lambda row: evaluate(row, "golden"))
    low, high = parameter.ends
    while True:
        beside = [(value,) for value in (best[0] - 1.0, best[0] + 1.0) if low <= value <= high]
        evaluate.ask(Candidate(row, "golden") for row in beside)
        better = min([best, *beside], key=lambda row: evaluate(row, "golden"))
        if better == best:
            return
        best = better


def _quasi_random(parameters: Sequence[TunedParameter], budget: int, evaluate: _Evaluations, start: int) -> None:
    """Spend the whole budget on quasi-random points."""
    points = halton(_most_points(budget), len(parameters), start)
    evaluate.ask(Candidate(row_at(parameters, place), "quasi-random") for place in points)


def _most_points(budget: int) -> int:
    """Number of points that are looked at, as some may round to equal values."""
    return 20 * budget


def _nelder_mead(parameters: Sequence[TunedParameter], budget: int, evaluate: _Evaluations, start: int) -> None:
    """Spend half of the budget on quasi-random points, and the rest on a simplex that starts at the best of them."""
    first = _distinct(parameters, max(1, budget // 2), start)
    evaluate.ask(Candidate(row_at(parameters, place), "quasi-random") for place in first)
    best = min(first, key=lambda place: evaluate(row_at(parameters, place), "quasi-random"))
    simplex = first_simplex(best)
    evaluate.ask(Candidate(row_at(parameters, place), "nelder-mead") for place in simplex)

    def objective(z: Array) -> float:
        return min(evaluate(row_at(parameters, z), "nelder-mead"), LARGEST)

    minimise(objective, simplex, 10 * budget)


def _distinct(parameters: Sequence[TunedParameter], n: int, start: int) -> list[Row]:
    """Return the first n quasi-random points with different values."""
    found: dict[Row, Row] = {}
    for place in halton(_most_points(n), len(parameters), start):
        found.setdefault(row_at(parameters, place), place)
        if len(found) == n:
            break
    return [*found.values()]


_SEARCHES: Mapping[str, Callable[[Sequence[TunedParameter], int, _Evaluations, int], None]] = {
    "grid-golden": _grid_golden,
    "nelder-mead": _nelder_mead,
    "quasi-random": _quasi_random,
}
