"""Numbers without Monte Carlo error beside those of a paper: equal to the digits printed, close or different."""

from __future__ import annotations

import math
import re
from decimal import Decimal
from typing import NamedTuple

from rmpc_bench.analysis.rounding import STABLE
from rmpc_bench.claims.claim import Finding, Stated

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")


def printed_number(text: str) -> Decimal:
    """Read a number as printed, such as ``1,869.20``; its last digit, a zero included, says how exactly.

    Examples
    --------
    >>> printed_number("62,908"), printed_number("5.80")
    (Decimal('62908'), Decimal('5.80'))
    """
    plain = re.sub(r"(?<=\d)[ ,](?=\d{3}(\D|$))", "", text.strip())
    if not _NUMBER.fullmatch(plain):
        raise ValueError(f"must be a number as the paper prints it, such as '58.24' (got {text!r})")
    return Decimal(plain)


class Closeness(NamedTuple):
    """How close a computed number is to a printed one."""

    finding: Finding
    relative: float
    """Difference relative to the printed number; inf beside a printed 0."""


def closeness(value: float, stated: Stated) -> Closeness:
    """Compare a number without Monte Carlo error with the printed one: equal if it rounds to the printed digits.

    Examples
    --------
    >>> [closeness(v, Stated("", 5.8, None, "", "5.8")).finding.value for v in (5.84, 5.851, 6.1)]
    ['equal', 'close', 'different']
    """
    printed = printed_number(stated.printed)
    if not math.isfinite(value):
        return Closeness(Finding.DIFFERENT, math.inf)
    # Digits beyond `STABLE` differ between machines.
    gap = Decimal(f"{value:.{STABLE}g}") - printed
    exponent = printed.as_tuple().exponent
    assert isinstance(exponent, int)
    relative = float(gap / abs(printed)) if printed else math.copysign(math.inf, gap) if gap else 0.0
    if 2 * abs(gap) <= Decimal(1).scaleb(exponent):
        return Closeness(Finding.EQUAL, relative)
    return Closeness(Finding.CLOSE if abs(relative) <= stated.close else Finding.DIFFERENT, relative)
