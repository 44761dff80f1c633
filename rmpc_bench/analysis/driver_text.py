"""Shares of drivers, and what they are shares of, as text."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping
from typing import Any

from rmpc_bench.analysis.drivers import FEWEST, REST
from rmpc_bench.analysis.rounding import decimal_text

Row = Mapping[Hashable, Any]
LITTLE = "the uncertain quantities explain little of the change"
"""What is said where no quantity is named."""
MOST_OF = 0.5
"""Share from which on a quantity alone is named."""
MUCH_OF = 0.25
"""Share from which on two quantities are named."""


def share_text(row: Row) -> str:
    """Write a share with its interval in per cent, such as ``79 % [67, 85]``; ``-`` in place of one that is unclear.

    Parameters
    ----------
    row : a row of `rmpc_bench.analysis.drivers`
    """
    if math.isnan(row["share"]):
        return "-"
    low, high = (per_cent(row[name]) for name in ("share_low", "share_high"))
    if not row["resolved"]:
        return f"- [{low}, {high}]"
    return f"{per_cent(row['share'])} % [{low}, {high}]"


def per_cent(share: float) -> str:
    """Write a share as a whole number of per cent between 0 and 100."""
    return decimal_text(min(100.0, max(0.0, 100 * float(share))), 0)


def gist(rows: Iterable[Row], baseline: str) -> str:
    """Say in a few words what drives the changes from the baseline; nothing where no share is resolved.

    Parameters
    ----------
    rows : of `rmpc_bench.analysis.drivers`, at one point
    baseline : its name; where it is alone, its own metric is meant

    Returns
    -------
    such as ``mostly eps`` or ``a and b``
    """
    of_each = [row for row in rows if row["quantity"] != REST and row["response"] != "failed"]
    of_each = [row for row in of_each if row["method"] != baseline] or of_each
    known = [row for row in of_each if row["resolved"] and row["n"] >= FEWEST]
    largest: dict[str, float] = {}
    for row in known:
        largest[str(row["quantity"])] = max(float(row["share"]), largest.get(str(row["quantity"]), 0.0))
    names = sorted(largest, key=lambda name: -largest[name])
    if not names:
        return ""
    if largest[names[0]] > MOST_OF:
        return f"mostly {names[0]}"
    if len(names) > 1 and largest[names[1]] > MUCH_OF:
        return f"{names[0]} and {names[1]}"
    return LITTLE
