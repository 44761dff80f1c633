"""SVG text that does not depend on the rounding errors of the CPU.

matplotlib writes coordinates with six decimals of a point and names clipping paths and markers by a hash of unrounded
numbers, so that an error of 1e-13 changes many lines of a file.  A tenth of a point cannot be seen.
"""

from __future__ import annotations

import re
from decimal import Decimal

DECIMALS = Decimal("0.1"), Decimal("0.01")
"""Digits of a place on the picture, and of numbers below 10, such as those of a marker."""
_COORDINATES = re.compile(r'(?<=\s)(?:d|x|y|width|height|points|viewBox)="[^"]*"|(?:translate|rotate)\([^)]*\)')
"""Attributes that hold coordinates in points; a factor in `scale(...)` or a comment is left as it is."""
_LONG_NUMBER = re.compile(r"-?\d+\.\d{2,}")
_HASHED_NAME = re.compile(r'(?<=id=")[a-z][0-9a-f]{10}(?=")')


def stable_svg(text: str) -> str:
    """Round an SVG of matplotlib to a tenth of a point, and number the names that it has made from hashes."""
    text = _COORDINATES.sub(lambda part: _LONG_NUMBER.sub(_rounded, part[0]), text)
    names = dict.fromkeys(_HASHED_NAME.findall(text))
    numbers = {name: f"{name[0]}{number}" for number, name in enumerate(names, start=1)}
    return re.sub(r'(?<=["#])[a-z][0-9a-f]{10}(?=["\)])', lambda found: numbers.get(found[0], found[0]), text)


def _rounded(number: re.Match[str]) -> str:
    """Write a number with few decimals; the six decimals of the text decide a half, not the float."""
    given = Decimal(number[0])
    rounded = given.quantize(DECIMALS[abs(given) < 10])
    return f"{rounded if rounded else abs(rounded):f}".rstrip("0").rstrip(".")
