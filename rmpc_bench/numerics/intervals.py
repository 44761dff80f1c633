"""Bounds of the coordinates of a vector."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types import Array, DesignError

Pair: TypeAlias = tuple[float | None, float | None]
Pairs: TypeAlias = Pair | list[Pair]
"""[low, high] for all coordinates, or one pair each; None or an infinite number where there is no bound."""


class Interval(NamedTuple):
    """Lower and upper bounds; infinite where there is none."""

    low: Float[Array, " n"]
    high: Float[Array, " n"]

    @property
    def bounded(self) -> Bool[Array, " n"]:
        """Which coordinates have a bound."""
        return np.isfinite(self.low) | np.isfinite(self.high)

    def chosen(self, places: Array) -> Interval:
        """Return the bounds of some coordinates."""
        return Interval(self.low[places], self.high[places])

    def shifted(self, by: Float[Array, " n"]) -> Interval:
        """Return the bounds plus a vector."""
        return Interval(self.low + by, self.high + by)


def interval_of(pairs: Pairs | None, n: int, key: str, *, distinct: bool = False, required: bool = True) -> Interval:
    """Return bounds of n coordinates, infinite without pairs; with `distinct` no lower bound equals the upper one.

    Pairs without any number are refused if a bound is `required`.
    """
    if pairs is None:
        return Interval(np.full(n, -np.inf), np.full(n, np.inf))
    listed: list[Any] = [pairs] * n if pairs and not isinstance(pairs[0], list | tuple) else list(pairs)
    if len(listed) != n:
        raise DesignError(f"has {len(listed)} pairs, and {n} {'is' if n == 1 else 'are'} required, or one for all", key)
    ends = (-np.inf, np.inf)
    filled = [[end if each is None else each for each, end in zip(pair, ends, strict=True)] for pair in listed]
    for low, high in filled:
        if not (low < high or (low == high and not distinct)):
            relation = "be below" if distinct else "not exceed"
            raise DesignError(f"the lower bound {low:g} must {relation} the upper bound {high:g}", key)
        if low == np.inf or high == -np.inf:
            raise DesignError(f"no number satisfies the bounds [{low:g}, {high:g}]", key)
    if required and not np.isfinite(filled).any():
        raise DesignError("has no bound; give a number in place of a null, or leave the key out", key)
    return Interval(*np.ascontiguousarray(np.array(filled, dtype=float).T))
