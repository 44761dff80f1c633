"""The numbers of a comparison in words."""

from __future__ import annotations

import math

from rmpc_bench.analysis.statistics import decimals
from rmpc_bench.claims.comparison import Compared

_FEWEST, _MOST = 4, 12  # significant digits


def evidence(number: Compared) -> str:
    """Write whether a comparison holds, and by which numbers.

    Parameters
    ----------
    number : the comparison

    Returns
    -------
    such as ``holds; closest at k = 1, entry 0: 3.62498 and 3.62537``
    """
    word = {True: "holds", False: "does not hold", None: "not separated"}[number.holds]
    reach = math.nan if number.interval is None else (number.interval[1] - number.interval[0]) / 2
    details = [_sides(number, reach)]
    if number.interval is not None:
        ends = ["open" if math.isinf(end) else shown(end, reach) for end in number.interval]
        details.append(f"difference in [{ends[0]}, {ends[1]}]")
    if number.n:
        details.append(f"n = {number.n}")
    if number.left_out:
        details.append(f"{number.left_out} left out: failed, or not computed")
    return f"{word}; {', '.join(details)}"


def _sides(number: Compared, reach: float) -> str:
    """Write the two sides, with the place where they were taken and what lies closer."""
    if number.entries > 1 and number.equal == number.entries:
        return f"equal to {_MOST} digits in all {number.entries} entries"
    digits = _digits(number.left, number.right)
    left, right = (shown(side, reach, digits) for side in (number.left, number.right))
    text = f"{left} and {right}"
    if left == right and number.left != number.right and number.interval is None:
        rounding = number.holds and number.operator not in ("<", ">")
        text += f", equal to {_MOST} digits" if rounding else f", left - right = {number.left - number.right:.1e}"
    place = [] if number.k is None else [f"k = {number.k}"]
    if number.entry is not None:
        place.append("entry " + ",".join(map(str, number.entry)))
    if place:
        text = f"{_extreme(number)} at {', '.join(place)}: {text}"
    rest = f", equal to {_MOST} digits in {number.equal} of {number.entries} entries"
    return text + rest if number.equal and number.entries > 1 else text


def _extreme(number: Compared) -> str:
    """What the shown entry is among all of them."""
    if number.operator in ("~", "=="):
        return "farthest apart"
    return "closest" if number.holds else "fails most"


def _digits(left: float, right: float) -> int:
    """Significant digits that tell two numbers apart, with one more to see by how much."""
    for digits in range(_FEWEST, _MOST + 1):
        if f"{left:.{digits}g}" != f"{right:.{digits}g}":
            return digits if digits == _FEWEST else min(digits + 1, _MOST)
    return _FEWEST


def shown(value: float | None, uncertainty: float = math.nan, digits: int = _FEWEST) -> str:
    """Write a number with the digits its uncertainty supports, or with so many where there is none; inf stays inf."""
    if value is None or math.isnan(value):
        return "-"
    if math.isinf(value):
        return str(plain(value))
    if not (math.isfinite(uncertainty) and uncertainty > 0 and 1e-4 <= abs(value) < 1e6):
        return f"{value:.{digits}g}"
    return f"{value:.{decimals(uncertainty)}f}"


def plain(value: float) -> float | str:
    """Replace infinity, for which JSON has no number, by a text."""
    return str(value) if math.isinf(value) else value
