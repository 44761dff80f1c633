"""Sets of runs in words."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby

MOST = 5
"""Ranges that are named."""


def said_runs(runs: Iterable[int]) -> str:
    """Return sorted runs as ranges, such as ``0 to 28, 57``; of many ranges the first ones.

    Examples
    --------
    >>> said_runs([0, 1, 2, 5, 7, 8])
    '0 to 2, 5, 7, 8'
    """
    texts: list[str] = []
    for _, group in groupby(enumerate(runs), key=lambda pair: pair[1] - pair[0]):
        members = [run for _, run in group]
        texts += [f"{members[0]} to {members[-1]}"] if len(members) > 2 else map(str, members)
    more = f" and {len(texts) - MOST} more ranges" if len(texts) > MOST else ""
    return ", ".join(texts[:MOST]) + more
