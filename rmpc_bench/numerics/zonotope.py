"""Zonotopes around 0, such as the sets that bounded noise reaches in a linear system, and largest invariant sets.

Set     Z = {G e : every entry of e in [-1, 1]}.  Linear maps, sums and the support function are exact and need no
        vertices: M Z has the generators M G, Z_1 + Z_2 has those of both, and max {d' z : z in Z} = sum_j |d' g_j|.
Sets    Minimal robust invariant set of x+ = A x + w, w in a box W: W + A W + A^2 W + ..
        Outer approximation: if A^s W is inside alpha W with alpha < 1, then (1 - alpha)^-1 (W + .. + A^(s-1) W) is
        robust invariant and contains the minimal set (Rakovic, Kerrigan, Kouramas and Mayne 2005).
Cost    The number of facets grows with a power of the number of generators: 2 per generator in the plane.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics import lp
from rmpc_bench.types import Array

PARALLEL = 1e-8
"""Angle between the normals of two facets below which they are one facet [rad].

A point between the facets that are kept exceeds a facet that is left out by at most twice this angle times the radius
of the set."""


@dataclass(frozen=True, eq=False)
class Zonotope:
    """The set {G e : -1 <= e <= 1}."""

    generators: Float[Array, "n m"]  # G, a generator per column

    def mapped(self, M: Float[Array, "p n"]) -> Zonotope:
        """Return the image M Z."""
        return Zonotope(M @ self.generators)

    def scaled(self, factor: float) -> Zonotope:
        """Return factor Z."""
        return Zonotope(factor * self.generators)

    def __add__(self, other: Zonotope) -> Zonotope:
        """Return the Minkowski sum {a + b : a in the first set, b in the second}."""
        return Zonotope(np.hstack([self.generators, other.generators]))

    def support(self, directions: Float[Array, "rows n"]) -> Float[Array, " rows"]:
        """Return max {d' z : z in Z} for every row d'; the minimum is its negative."""
        return np.abs(directions @ self.generators).sum(axis=1)

    @property
    def half_widths(self) -> Float[Array, " n"]:
        """Half the width of the set along every axis."""
        return self.support(np.eye(len(self.generators)))

    @property
    def area(self) -> float:
        """Area of a set in the plane: 4 sum |det [g_i, g_j]| over all pairs of generators."""
        if len(self.generators) != 2:
            raise ValueError(f"only a set in the plane has an area; this one has {len(self.generators)} dimensions")
        x, y = self.generators
        # Every pair stands twice in the matrix of determinants.
        return float(2.0 * np.abs(np.outer(x, y) - np.outer(y, x)).sum())

    def most_facets(self) -> int:
        """Return an upper bound of the number of pairs of opposite facets, without computing them."""
        n, m = self.generators.shape
        return comb(m, n - 1)

    def facets(self) -> Facets:
        """Return the set as {z : -bounds <= normals z <= bounds}."""
        n = len(self.generators)
        if np.linalg.matrix_rank(self.generators) < n:
            raise ValueError("the set has no interior")
        normals = _normals(self.generators)
        return Facets(normals, self.support(normals))

    def outline(self) -> Float[Array, "points 2"]:
        """Return the vertices of a set in the plane, counterclockwise."""
        upper = np.where(_points_up(self.generators), self.generators, -self.generators)
        turned = upper[:, np.argsort(np.arctan2(upper[1], upper[0]), kind="stable")]
        # From the lowest vertex along twice every generator, and back on the other side.
        half = -turned.sum(axis=1) + 2.0 * np.cumsum(turned, axis=1).T
        return np.concatenate([half, -half])


class Facets(NamedTuple):
    """A set that is symmetric to 0, as {z : -bounds <= normals z <= bounds}."""

    normals: Float[Array, "rows n"]  # unit vectors, one per pair of opposite facets
    bounds: Float[Array, " rows"]


def box(half_widths: Float[Array, " n"] | list[float]) -> Zonotope:
    """Return the box of all z with |z_i| <= half_widths_i."""
    return Zonotope(np.diag(np.asarray(half_widths, dtype=float)))


def reached(A: Float[Array, "n n"], W: Zonotope, n_steps: int) -> Zonotope:
    """Return W + A W + .. + A^(n_steps - 1) W, the states that noise in W reaches from 0 in some steps."""
    parts, power = [np.zeros((len(A), 0))], np.eye(len(A))
    for _ in range(n_steps):
        parts.append(power @ W.generators)
        power = A @ power
    return Zonotope(np.hstack(parts))


class InvariantSet(NamedTuple):
    """Outer approximation of the minimal robust invariant set."""

    set: Zonotope
    terms: int  # s, number of terms of the sum
    alpha: float  # smallest number for which A^s W is inside alpha W


def robust_invariant(
    A: Float[Array, "n n"], half_widths: Float[Array, " n"], largest_alpha: float, most_terms: int = 10_000
) -> InvariantSet:
    """Return a robust invariant set of x+ = A x + w, with w in a box.

    Terms are added until alpha is at most `largest_alpha` < 1; a ValueError says that `most_terms` are not enough.
    """
    power = np.eye(len(A))
    for terms in range(1, most_terms + 1):
        power = A @ power
        # A^s W is a zonotope inside the box alpha W if its half widths are at most alpha times those of W.
        alpha = float((np.abs(power) @ half_widths / half_widths).max())
        if alpha <= largest_alpha:
            return InvariantSet(reached(A, box(half_widths), terms).scaled(1.0 / (1.0 - alpha)), terms, alpha)
    raise ValueError(f"{most_terms} terms do not reach alpha = {largest_alpha:g}")


def _normals(generators: Float[Array, "n m"]) -> Float[Array, "rows n"]:
    """Return unit normals of all facets: every facet is spanned by n - 1 generators."""
    n = len(generators)
    sized = generators[:, np.abs(generators).sum(axis=0) > 0.0]
    directions = sized / np.linalg.norm(sized, axis=0)
    kept = np.zeros((0, n))
    for chosen in combinations(range(directions.shape[1]), n - 1):
        _, sizes, rows = np.linalg.svd(directions[:, chosen].T, full_matrices=True)
        # Generators that are (nearly) dependent span no facet.
        if n > 1 and sizes[-1] < PARALLEL:
            continue
        normal = rows[-1]
        # The distance of unit vectors, because the arc cosine of their product has half of the digits only.
        angles = np.minimum(*(np.linalg.norm(kept - signed, axis=1) for signed in (normal, -normal)))
        if angles.min(initial=np.inf) >= PARALLEL:
            kept = np.vstack([kept, normal])
    return kept


def _points_up(generators: Float[Array, "2 m"]) -> Array:
    """Say which generators have an angle of 0 or more and less than pi."""
    x, y = generators
    return (y > 0.0) | ((y == 0.0) & (x > 0.0))


# Largest invariant set of x+ = A x inside limits that tighten with time, as rows.
#
# Set     O = {x : H A^t x <= b_t for all t >= 0}, where b_t falls to b_inf > 0: the states from which the limits
#         H x(t) <= b_t hold at all times.  With b_t = b it is the largest invariant set inside H x <= b.
# Method  Rows of t = 0, 1, .. are added until all rows H A^(T+1) x <= b_inf follow from those of t = 0..T, which a
#         linear program per row decides (Gilbert and Tan 1991).  Then no later row matters: for a state x of the set,
#         A x meets the rows 0..T as well, because b_t falls, and so on.  Rows that follow from the others are left out.
# Ends    If the eigenvalues of A are inside the unit circle and b_inf > 0.

IMPLIED = 1e-9
"""A row follows from others if it exceeds its bound by at most this much, relative to the bound."""
MOST_STEPS = 10_000


class InvariantRows(NamedTuple):
    """The set {x : H x <= b}."""

    H: Float[Array, "rows n"]
    b: Float[Array, " rows"]
    steps: int  # T, the last step whose rows are needed


def largest_invariant(
    A: Float[Array, "n n"],
    H: Float[Array, "rows n"],
    bounds: Callable[[int], Float[Array, " rows"]],
    b_inf: Float[Array, " rows"],
) -> InvariantRows:
    """Return the states from which H x(t) <= b_t for all t.

    A has its eigenvalues inside the unit circle, b_t = bounds(t) does not increase with t and is at least b_inf > 0.
    A ValueError says that a bound is not positive, or the set not found within `MOST_STEPS` steps.
    """
    if not (b_inf > 0.0).all():
        raise ValueError("the point 0 must be inside all limits")
    rows, limits = H / bounds(0)[:, None], np.ones(len(H))
    power = np.eye(len(A))
    for t in range(MOST_STEPS):
        power = A @ power
        later = H @ power
        if all(_follows(row / bound, rows, limits) for row, bound in zip(later, b_inf, strict=True)):
            needed = irredundant(rows, limits)
            return InvariantRows(rows[needed], limits[needed], t)
        now = later / bounds(t + 1)[:, None]
        # A row that already follows is left out now, so that the programs stay small.
        for row in now:
            if not _follows(row, rows, limits):
                rows, limits = np.vstack([rows, row]), np.append(limits, 1.0)
    raise ValueError(f"the set is not found within {MOST_STEPS} steps")


def irredundant(H: Float[Array, "rows n"], b: Float[Array, " rows"]) -> list[int]:
    """Return the indices of rows of H x <= b that do not follow from the others."""
    kept = list(range(len(H)))
    # The last rows first: those of later steps are more often redundant.
    for row in reversed(range(len(H))):
        others = [each for each in kept if each != row]
        if others and _follows(H[row] / b[row], H[others], b[others]):
            kept = others
    return kept


def _follows(row: Float[Array, " n"], H: Float[Array, "rows n"], b: Float[Array, " rows"]) -> bool:
    """Whether H x <= b implies row x <= 1."""
    # The solver needs entries of size 1: every state is taken in a unit of its own.
    units = np.abs(np.vstack([H, row])).max(axis=0)
    units[units == 0.0] = 1.0
    size = np.abs(row / units).max()
    if size == 0.0:
        return True
    m, n = H.shape
    free = np.full(n, np.inf)
    found = lp.solve(-row / units / size, lp.Bounds(H / units, np.full(m, -np.inf), b, -free, free))
    return found.status is lp.LpStatus.OPTIMAL and bool(-found.objective * size <= 1.0 + IMPLIED)
