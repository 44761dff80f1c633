"""Minimisation of a function without derivatives: golden section, quasi-random points, Nelder and Mead's simplex.

Source  J. Kiefer, "Sequential minimax search for a maximum", Proc. AMS 4 (1953), 502-506, the golden section;
        J. A. Nelder and R. Mead, "A simplex method for function minimization", Comput. J. 7 (1965), 308-313;
        J. H. Halton, Numer. Math. 2 (1960), 84-90, the quasi-random points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from rmpc_bench.types import Array

GOLDEN = (3.0 - math.sqrt(5.0)) / 2.0
"""Share of an interval at which golden section places a point."""
MOST_STEPS = 100
"""Steps of golden section, which may meet values that are known already."""
SIMPLEX = 0.15
"""Edge of the first simplex, as a share of the unit cube."""
_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29)
MOST_DIMENSIONS = len(_PRIMES)
"""Largest number of coordinates of a quasi-random point."""

Place = tuple[float, ...]
"""A point in the unit cube."""


def golden_section(objective: Callable[[float], float], a: float, b: float, c: float) -> tuple[float, float]:
    """Minimise a function between a and c by golden section, until it raises or the interval has no width.

    The value at b is smaller than at both ends; b is an end where no such point is known.
    """
    if a < b < c:
        # The first new point divides the larger part.
        left, right = (b, b + GOLDEN * (c - b)) if c - b > b - a else (b - GOLDEN * (b - a), b)
    else:
        left, right = a + GOLDEN * (c - a), c - GOLDEN * (c - a)
    for _ in range(MOST_STEPS):
        if not a < left < right < c:
            break
        # The left value first, as where both are new.
        at_left, at_right = objective(left), objective(right)
        if at_left <= at_right:
            c, right = right, left
            left = right - GOLDEN * (right - a)
        else:
            a, left = left, right
            right = left + GOLDEN * (c - left)
    best = min((left, right), key=objective)
    return best, objective(best)


def halton(n: int, dimensions: int, start: int = 0) -> Iterator[Place]:
    """Yield points of the Halton sequence without its first point, the origin, from number `start` on."""
    for index in range(start + 1, start + n + 1):
        yield tuple(_radical_inverse(index, base) for base in _PRIMES[:dimensions])


def _radical_inverse(index: int, base: int) -> float:
    numerator, denominator = 0, 1
    while index:
        index, digit = divmod(index, base)
        numerator, denominator = numerator * base + digit, denominator * base
    return numerator / denominator


def first_simplex(place: Place) -> list[Place]:
    """Return a place and, for every coordinate, one that differs in it and is in the unit cube."""
    moved = [z + SIMPLEX if z + SIMPLEX <= 1.0 else z - SIMPLEX for z in place]
    return [place, *((*place[:i], z, *place[i + 1 :]) for i, z in enumerate(moved))]


def minimise(objective: Callable[[Array], float], simplex: Sequence[Place], most: int) -> Array:
    """Minimise a function in the unit cube by SciPy's method of Nelder and Mead, in at most so many evaluations."""
    # Imported where it is used: a configuration is checked without it.
    from scipy.optimize import minimize

    vertices = np.array(simplex)
    options = {"initial_simplex": vertices, "maxfev": most, "xatol": 1e-4, "fatol": 0.0}
    bounds = [(0.0, 1.0)] * vertices.shape[1]
    found = minimize(objective, vertices[0], method="Nelder-Mead", bounds=bounds, options=options)
    return np.asarray(found.x)
