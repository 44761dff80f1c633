"""Text of the evidence of a comparison, with its numbers.

All numbers are rounded so that another CPU gives the same text, see `analysis.rounding`.
"""

from __future__ import annotations

import math

from rmpc_bench.analysis.rounding import STABLE, decimal_text, significant, significant_text
from rmpc_bench.claims.comparison import ComparisonResult
from rmpc_bench.claims.decision import Change

_MOST_PLACES = 12
_MIN_DIGITS, _MAX_DIGITS = 4, 9
"""Significant digits; beyond the second limit two numbers count as equal."""


def _decimals(uncertainty: float) -> int:
    """Count the decimal places that show an uncertainty with two digits: 0 to 12, and 3 where it is 0 or unknown.

    >>> _decimals(0.0123), _decimals(4.5), _decimals(160.0)
    (3, 1, 0)
    """
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return 3
    return min(_MOST_PLACES, max(0, 1 - math.floor(math.log10(uncertainty))))


def evidence(comparison: ComparisonResult) -> str:
    """Write whether a comparison holds, and by which numbers."""
    comparison = comparison.rounded()
    word = {True: "holds", False: "does not hold", None: "inconclusive"}[comparison.holds]
    interval = comparison.interval
    reach = math.nan if interval is None else (interval[1] - interval[0]) / 2
    details = [_sides(comparison, reach)]
    if interval is not None:
        low, high = (number_text(end, reach) for end in interval)
        details.append(f"interval of the difference [{low}, {high}]")
    if comparison.n:
        details.append(f"n = {comparison.n}")
    if comparison.n_excluded:
        runs = "1 run" if comparison.n_excluded == 1 else f"{comparison.n_excluded} runs"
        details.append(f"{runs} excluded (failed or not computed)")
    return "; ".join([f"{word}; {', '.join(details)}", *_further(comparison)])


def _further(comparison: ComparisonResult) -> list[str]:
    """Write what would change the outcome: another threshold, more runs, further runs."""
    found = []
    if comparison.exceptions is not None:
        found.append(f"at most {significant_text(100 * comparison.exceptions, 2)} % of all runs are exceptions")
    if comparison.below_margin:
        found.append(f"the difference is below the margin of relevance of {comparison.below_margin}")
    # Sides that are equal up to rounding are equivalent within 0.
    if comparison.change is not None and comparison.change.high != 0:
        found.append(change_text(comparison.change))
    if comparison.n_deciding is not None:
        found.append(f"about {comparison.n_deciding:,} runs would decide")
    return found


def change_text(change: Change) -> str:
    """Write at which value of a number of the check the outcome changes.

    Examples
    --------
    >>> change_text(Change("factor", 0.28, 0.331)), change_text(Change("relative margin", 0.0, 0.132))
    ('outcome changes at factors from 0.28 to 0.331', 'equivalent within margins of 13.2 % or more')
    """
    low, high = (significant_text(end, _MIN_DIGITS) for end in (change.low, change.high))
    if change.kind == "margin":
        return f"equivalent within margins of {high} or more"
    if change.kind == "relative margin":
        return f"equivalent within margins of {significant_text(100 * change.high, 3)} % or more"
    where = f"a {change.kind} of {low}" if low == high else f"{change.kind}s from {low} to {high}"
    return f"outcome changes at {where}"


def _sides(comparison: ComparisonResult, reach: float) -> str:
    """Write the two sides, with the place where they were taken and how many other entries are equal."""
    if comparison.n_entries > 1 and comparison.n_equal == comparison.n_entries:
        return f"equal to {_MAX_DIGITS} digits in all {comparison.n_entries} entries"
    digits = _digits(comparison.left, comparison.right)
    left, right = (number_text(side, reach, digits) for side in (comparison.left, comparison.right))
    text = f"{left} and {right}"
    # Equal numbers support every comparison but these; whether they are equal to the last bit is left to rounding.
    surprising = comparison.holds is (comparison.operator in ("<", ">"))
    if left == right and comparison.interval is None and surprising:
        text += f", equal to {_MAX_DIGITS} digits"
    place = [] if comparison.k is None else [f"k = {comparison.k}"]
    if comparison.entry is not None:
        place.append("entry " + ",".join(map(str, comparison.entry)))
    if place:
        text = f"{_extreme(comparison)} at {', '.join(place)}: {text}"
    if comparison.n_equal and comparison.n_entries > 1:
        text += f"; equal to {_MAX_DIGITS} digits in {comparison.n_equal} of {comparison.n_entries} entries"
    return text


def _extreme(comparison: ComparisonResult) -> str:
    """Say which of the entries is given."""
    if comparison.operator in ("~", "=="):
        return "largest difference"
    return "smallest margin" if comparison.holds else "largest violation"


def _digits(left: float, right: float) -> int:
    """Significant digits that distinguish two numbers, with one more to see by how much."""
    for digits in range(_MIN_DIGITS, _MAX_DIGITS + 1):
        if significant_text(left, digits) != significant_text(right, digits):
            return digits if digits == _MIN_DIGITS else min(digits + 1, _MAX_DIGITS)
    return _MIN_DIGITS


def number_text(value: float | None, uncertainty: float = math.nan, digits: int = _MIN_DIGITS) -> str:
    """Write a number with the digits that its uncertainty, half the width of its interval, supports."""
    if value is None or math.isnan(value):
        return "-"
    if math.isinf(value):
        return str(value)
    if not (math.isfinite(uncertainty) and uncertainty > 0 and 1e-4 <= abs(value) < 1e6):
        return significant_text(value, digits)
    return decimal_text(value, _decimals(significant(uncertainty, STABLE)))
