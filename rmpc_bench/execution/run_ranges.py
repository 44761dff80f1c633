"""Sets of runs in words."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import Int

from rmpc_bench.execution.chunks import ranges
from rmpc_bench.types import Array

MOST = 5
"""Ranges that are named."""


def said_runs(runs: Sequence[int] | Int[Array, " runs"]) -> str:
    """Return sorted runs as ranges, such as ``0 to 28, 57``; of many ranges the first ones.

    Examples
    --------
    >>> said_runs([0, 1, 2, 5, 7, 8])
    '0 to 2, 5, 7, 8'
    """
    texts: list[str] = []
    for first, stop in ranges(runs):
        texts += [f"{first} to {stop - 1}"] if stop - first > 2 else map(str, range(first, stop))
    more = f" and {len(texts) - MOST} more ranges" if len(texts) > MOST else ""
    return ", ".join(texts[:MOST]) + more
