"""Numbers as page, screen and figures show them: as many digits as the interval of a number supports.

The decimals follow from half the width h of the interval: h has two digits if it begins with 1 to 3, else one.  A
minus is U+2212; `plain` turns texts into those of a terminal.
"""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["Estimate", "change_texts", "difference_texts", "interval_text", "mean_text", "number", "places", "plain"]

MINUS, PLUS_MINUS, TIMES, THIN = "\u2212", "\u00b1", "\u00d7", "\u202f"
NOISE = 1e-12
"""Half widths below this share of a number come from rounding: all runs are equal."""
PLAIN = (-4, 6)
"""Exponents of the leading digit that are written without a power of ten: from the first to below the second."""
AS_PER_CENT = (0.2, 2.0)
"""Ratios from the first to the second are written as a change in per cent, others as a factor."""
_MOST_PLACES, _FINEST = 2, 12
"""Decimals of a change in per cent, and of any number where an end would print as 0."""
_ASCII = {ord(MINUS): "-", ord(TIMES): "x", ord(THIN): " ", 0x2248: "=", 0x2032: "'"}


class Estimate(NamedTuple):
    """A number with the ends of its interval; NaN where there is none."""

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan

    @property
    def half(self) -> float:
        """Half the width of the interval."""
        return (self.high - self.low) / 2


def places(half: float) -> int:
    """Count the decimals that show half a width; below 0 left of the point, 3 where it is 0 or unknown.

    >>> places(0.0049), places(0.0019), places(8.5), places(160.0)
    (3, 4, 0, -1)
    """
    if not half > 0 or math.isinf(half):
        return 3
    size = math.floor(math.log10(half))
    return 1 - size if half / 10.0**size < 4 else -size


def number(x: float, decimals: int, *, sign: bool = False) -> str:
    """Write a number with decimals; below 0 it is rounded left of the point.  With `sign`, positive ones have a plus.

    >>> number(-0.12345, 2), number(-0.001, 2), number(20911.0, -2, sign=True), number(float("nan"), 1)
    ('\u22120.12', '0.00', '+20900', '-')
    """
    if math.isnan(x):
        return "-"
    if math.isinf(x):
        return "inf" if x > 0 else f"{MINUS}inf"
    rounded = round(x, decimals) + 0.0
    text = f"{rounded:z.{max(decimals, 0)}f}".replace("-", MINUS)
    return f"+{text}" if sign and rounded > 0 else text


def short(x: float, digits: int = 3) -> str:
    """Write a number with significant digits, such as a mean without its interval; powers of ten as `mean_text`.

    >>> short(0.117389), short(1287.4), short(69100.0, 4), short(1.5e-9), short(-2.34e7), short(-0.0)
    ('0.117', '1290', '69100', '1.5e\u22129', '\u22122.34e7', '0')
    """
    if math.isnan(x):
        return "-"
    text = f"{x + 0.0:.{digits}g}"
    start, _, power = text.partition("e")
    if power:
        text = f"{float(text):.0f}" if PLAIN[0] <= int(power) < PLAIN[1] else f"{start}e{int(power)}"
    return text.replace("-", MINUS)


def mean_text(mean: Estimate) -> str:
    """Write a mean with half the width of its interval; four digits where the runs are equal or too few.

    >>> mean_text(Estimate(0.117389, 0.112445, 0.122332)), mean_text(Estimate(59.7743, 51.29, 68.2587))
    ('0.117 \u00b1 0.005', '60 \u00b1 8')
    >>> mean_text(Estimate(1.5e-9, 1.4e-9, 1.6e-9)), mean_text(Estimate(2.0, 2.0, 2.0))
    ('(1.50 \u00b1 0.10)e\u22129', '2')
    """
    half = mean.half
    if math.isnan(half) or half <= NOISE * abs(mean.value) or math.isinf(half):
        return short(mean.value, 4)
    size = math.floor(math.log10(max(abs(mean.value), half)))
    if not PLAIN[0] <= size < PLAIN[1]:
        scaled = Estimate(*(each / 10.0**size for each in mean))
        return f"({mean_text(scaled)})e{number(size, 0)}"
    d = places(half)
    return f"{number(mean.value, d)} {PLUS_MINUS} {number(half, d)}"


def interval_text(x: Estimate, unit: str = "", *, sign: bool = False) -> str:
    """Write a number with its unit and its interval in brackets; with `sign`, positive ones have a plus.

    >>> interval_text(Estimate(0.117389, 0.112445, 0.122332)), interval_text(Estimate(9.1, 7.2, 11.0), "%", sign=True)
    ('0.117 [0.112, 0.122]', '+9.1 % [+7.2, +11.0]')
    """
    if math.isnan(x.value):
        return "-"
    text, ends = _with_ends(x, sign=sign)
    return " ".join(filter(None, [text, unit, ends]))


def _with_ends(x: Estimate, *, sign: bool) -> tuple[str, str]:
    """Write a number, and its interval in brackets, empty where there is none or all runs are equal."""
    if math.isnan(x.half) or x.half <= NOISE * abs(x.value):
        return f"{'+' * (sign and x.value > 0)}{short(x.value, 4)}", ""
    sizes = [math.floor(math.log10(abs(end))) for end in x if end and math.isfinite(end)]
    if math.isinf(x.half) or not PLAIN[0] <= max(sizes, default=0) < PLAIN[1]:
        texts = [f"{'+' * (sign and end > 0)}{short(end)}" for end in x]
    else:
        d = _with_both_ends(x, min(places(x.half), _FINEST))
        texts = [number(end, d, sign=sign) for end in x]
    return texts[0], f"[{texts[1]}, {texts[2]}]"


def change_texts(change: Estimate, *, mirrored: bool = False) -> tuple[str, str]:
    """Write a change in per cent and its interval, as factors where a ratio is below a fifth or above 2.

    With `mirrored`, a reduction is a positive number and its ends are in order; factors stay.

    >>> change_texts(Estimate(-11.1105, -15.2737, -6.74284))
    ('\u221211 %', '[\u221215, \u22127]')
    >>> change_texts(Estimate(161.0, 107.0, 228.0))
    ('\u00d72.6', '[2.1, 3.3]')
    >>> change_texts(Estimate(-10.2, -12.4, -7.9), mirrored=True)
    ('10.2 %', '[7.9, 12.4]')
    """
    if math.isnan(change.value):
        return "", ""
    if not is_per_cent(change):
        factor, *factors = (_factor(1 + each / 100) for each in change)
        return f"{TIMES}{factor}", "" if math.isnan(change.half) else f"[{', '.join(factors)}]"
    unknown = math.isnan(change.half)
    d = 1 if unknown else _with_both_ends(change, max(0, min(places(change.half), _MOST_PLACES)))
    value, low, high = _mirrored(change) if mirrored else change
    signed = not mirrored
    ends = f"[{number(low, d, sign=signed)}, {number(high, d, sign=signed)}]"
    return f"{number(value, d, sign=signed)} %", "" if unknown else ends


def _mirrored(change: Estimate) -> Estimate:
    return Estimate(-change.value, -change.high, -change.low)


def is_per_cent(change: Estimate) -> bool:
    """Whether a change is written in per cent."""
    low, high = AS_PER_CENT
    return low * (1 - NOISE) <= 1 + change.value / 100 <= high * (1 + NOISE)


def _with_both_ends(x: Estimate, d: int) -> int:
    """Add decimals until no end of an interval that excludes 0 prints as 0."""
    while d < _FINEST and x.low * x.high > 0 and 0 in (round(x.low, d), round(x.high, d)):
        d += 1
    return d


def _factor(ratio: float) -> str:
    """Write a factor with two significant digits, from 100 on as an integer; a power of ten where it is far from 1.

    >>> _factor(2.63), _factor(541.4), _factor(1.0e64), _factor(3.2e-9)
    ('2.6', '541', '1.0e64', '3.2e\u22129')
    """
    if not math.isfinite(ratio) or ratio == 0:
        return number(ratio, 0)
    if not 10.0 ** PLAIN[0] <= abs(ratio) < 10.0 ** PLAIN[1]:
        digits, _, power = f"{ratio:.1e}".partition("e")
        return f"{digits}e{number(int(power), 0)}"
    rounded = abs(float(f"{ratio:.1e}"))
    return number(ratio, max(0, 1 - math.floor(math.log10(rounded) + 1e-9)) if rounded < 100 else 0)


def difference_texts(change: Estimate, unit: str = "", *, mirrored: bool = False) -> tuple[str, str]:
    """Write a difference in the unit of a metric and its interval.

    >>> difference_texts(Estimate(0.00121, -0.0003, 0.0027), "rad")
    ('+0.0012 rad', '[\u22120.0003, +0.0027]')
    >>> difference_texts(Estimate(-6.2e6, -8.4e6, -4.3e6), "m")
    ('\u22126.2e6 m', '[\u22128.4e6, \u22124.3e6]')
    """
    if math.isnan(change.value):
        return "", ""
    shown = _mirrored(change) if mirrored else change
    text, ends = _with_ends(shown, sign=not mirrored and not math.isnan(change.half))
    return f"{text} {unit}".strip(), ends


def plain(text: str) -> str:
    """Write a text with the characters of a terminal: ``-``, ``x`` and blanks; the sign of a half width stays."""
    return text.translate(_ASCII)
