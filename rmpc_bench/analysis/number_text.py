"""Numbers as text: as many digits as their Monte Carlo error supports, and enough to see their spread.

Three rules hold for all of them.

1. A number has no digits below its Monte Carlo error, unless rule 2 or 3 asks for them.
2. A spread (an interval, the quartiles) shows at least two significant digits: ``0.11 [0.10, 0.11]`` shows one.
3. Numbers of one group have the same decimal places, unless they differ by powers of ten: then each has its own
   exponent, as one exponent for all turns the smaller ones into 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = ["decimals", "interval_text", "median_text", "with_error"]

MOST_PLACES = 12
NOISE = 1e-12
"""Errors below this share of a number come from rounding: all runs are equal."""
WIDE = 1e3
"""Ratio of the largest to the smallest of a group from which on each number has its own exponent."""
_PLAIN = (-4, 6)
"""Exponents of the leading digit that are written without a power of ten: from the first to below the second."""


def decimals(uncertainty: float) -> int:
    """Count the decimal places that show an uncertainty with two digits: 0 to 12, and 3 where it is 0 or unknown.

    >>> decimals(0.0123), decimals(4.5), decimals(160.0)
    (3, 1, 0)
    """
    if not (math.isfinite(uncertainty) and uncertainty > 0):
        return 3
    return min(MOST_PLACES, max(0, 1 - math.floor(math.log10(uncertainty))))


def with_error(value: float, se: float) -> str:
    """Write a value with no more digits than its standard error supports.

    The bracket is the error of the last digits: two of them up to 35, else one.  An error that is 0, rounding or
    unknown leaves four digits without a bracket; NaN is "-".

    >>> with_error(0.11861, 0.00149), with_error(2.0, 0.0)
    ('0.1186(15)', '2')
    """
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return _infinite(value)
    if not (math.isfinite(se) and se > NOISE * abs(value)):
        return f"{value:.4g}"
    size = math.floor(math.log10(max(abs(value), se)))
    if not _PLAIN[0] <= size < _PLAIN[1]:
        return f"{with_error(value / 10.0**size, se / 10.0**size)}e{size:+03d}"
    exponent = math.floor(math.log10(se))
    lead = se / 10.0**exponent
    # The rule of the Particle Data Group: 1.0 to 3.54 two digits, to 9.49 one, above that "10" of the next decade.
    last = exponent - 1 if lead < 3.55 else exponent
    error = round(se / 10.0**last) * 10.0 ** max(last, 0)
    return f"{round(value, -last):z.{max(-last, 0)}f}({error:.0f})"


def median_text(median: float, low: float, high: float, n: int) -> str:
    """Write a median of n values and its quartiles, of which the upper ones may be inf; "-" where there is none.

    >>> median_text(0.11449, 0.10213, 0.135736, 200), median_text(18.21, 3.43, 19.06, 8)
    ('0.114 [0.102, 0.136]', '18.2 [3.4, 19.1]')
    """
    if math.isnan(median):
        return "-"
    values = (median, low, high)
    # In a Gaussian sample a quartile has the error 1.01 (high - low)/sqrt(n).  In a skewed one the tighter side, where
    # most values are, says how well the median is known; the other one may be infinite.
    sides = [side for side in (median - low, high - median) if math.isfinite(side) and side > 0]
    finite = [value for value in values if math.isfinite(value)]
    spread = max(finite, default=0.0) - min(finite, default=0.0)
    if not sides or min(sides) <= NOISE * max(map(abs, finite)):
        return _group(values, None)
    places = max(round(-math.log10(2 * min(sides) / math.sqrt(n))), _places_of(spread), _places_of(min(sides)) - 1)
    # A quartile that is a visible part of the spread has two digits, too.
    small = [abs(value) for value in finite if 0.1 * spread < abs(value)]
    return _group(values, max([places, *map(_places_of, small)]))


def interval_text(value: float, low: float, high: float, *, unit: str = "", sign: bool = True) -> str:
    """Write a number with its interval and unit; `sign` gives numbers shown above 0 a plus; "-" without a number.

    >>> interval_text(-10.9134, -12.077, -9.73443, unit="%")
    '-10.9 % [-12.1, -9.7]'
    >>> interval_text(0.00004, -0.00012, 0.00019, unit="%")
    '+0.00004 % [-0.00012, +0.00019]'
    >>> interval_text(20911.0, 12041.0, 27027.0, unit="%")
    '+20900 % [+12000, +27000]'
    """
    if math.isnan(value):
        return "-"
    unit = f" {unit}" if unit else ""
    if math.isnan(low):
        return _plus(f"{value:.3g}", sign) + unit
    reach = (high - low) / 2
    largest = max(abs(end) for end in (value, low, high))
    if not math.isfinite(reach) or largest >= 10.0 ** _PLAIN[1]:
        texts = [_own(number, 3) for number in (value, low, high)]
    elif reach <= NOISE * max(largest, 1.0):
        texts = [f"{number:.4g}" for number in (value, low, high)]
    else:
        # Left of the point, too: the digits of 20911 that an error of 8000 does not support are 0.
        places = _places_of(reach) if reach >= 100 else decimals(reach)
        texts = [f"{round(number, places):z.{max(places, 0)}f}" for number in (value, low, high)]
    first, *ends = (_plus(text, sign) for text in texts)
    return f"{first}{unit} [{', '.join(ends)}]"


def _plus(text: str, sign: bool) -> str:
    return f"+{text}" if sign and float(text) > 0 else text


def _places_of(size: float) -> int:
    """Decimal places, below 0 left of the point, that show a size with two digits."""
    return 1 - math.floor(math.log10(size))


def _group(values: Sequence[float], places: int | None) -> str:
    """Write a number and two more in brackets, with common places; None: all runs are equal, four digits."""
    sizes = [abs(value) for value in values if math.isfinite(value) and value]
    size = math.floor(math.log10(max(sizes, default=1.0)))
    plain = _PLAIN[0] <= size < _PLAIN[1]
    if places is None:
        texts = [f"{value:.4g}" if math.isfinite(value) else _infinite(value) for value in values]
    elif not plain and max(sizes) > WIDE * min(sizes):
        texts = [_own(value, 2) for value in values]
    else:
        texts = [_rounded(value, places, 0 if plain else size) for value in values]
    return f"{texts[0]} [{', '.join(texts[1:])}]"


def _rounded(value: float, places: int, exponent: int) -> str:
    """Round to decimal places of the number itself; with an exponent that is not 0 the power of ten is written."""
    if math.isinf(value):
        return _infinite(value)
    places = min(MOST_PLACES, places + exponent)
    mantissa = f"{round(value / 10.0**exponent, places):z.{max(places, 0)}f}"
    return f"{mantissa}e{exponent:+03d}" if exponent else mantissa


def _own(value: float, digits: int) -> str:
    """Write a number with significant digits and, where it is very large or small, an exponent of its own."""
    if math.isinf(value):
        return _infinite(value)
    size = math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{digits}g}" if -4 <= size < digits else f"{value:.{digits - 1}e}"


def _infinite(value: float) -> str:
    return "inf" if value > 0 else "-inf"
