"""Largest invariant set of x+ = A x inside limits that tighten with time, as rows.

Set     O = {x : H A^t x <= b_t for all t >= 0}, where b_t falls to b_inf > 0: the states from which the limits
        H x(t) <= b_t hold at all times.  With b_t = b it is the largest invariant set inside H x <= b.
Method  Rows of t = 0, 1, .. are added until all rows H A^(T+1) x <= b_inf follow from those of t = 0..T, which a linear
        program per row decides (Gilbert and Tan 1991).  Then no later row matters: for a state x of the set, A x meets
        the rows 0..T as well, because b_t falls, and so on.
        Rows that follow from the others are left out.
Ends    If the eigenvalues of A are inside the unit circle and b_inf > 0.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rmpc_bench.numerics import lp
from rmpc_bench.types import Array

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
