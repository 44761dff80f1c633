"""Rounding of what is kept under version control, such that another CPU writes the same digits.

Sums and products in another order differ by about 1e-13 of their size.  Such a difference must neither change a digit
nor turn 0 into 1e-17, so two rules hold for every number that is written:

1. It is rounded to `STABLE` significant digits first, and then to those that are shown.  A number that stands on the
   border between two roundings, such as 0.125 at two digits, would else go up on one CPU and down on another.
2. Digits below `NEGLIGIBLE` of the size of the numbers that it was computed from are not written: what is left of a
   difference of equal numbers is 0, and a determinant that nearly vanishes has fewer digits.
"""

from __future__ import annotations

import math

STABLE = 12
SHOWN = 6
NEGLIGIBLE = 1e-9


def significant(value: float, digits: int = SHOWN) -> float:
    """Round to significant digits; inf and NaN stay.

    Parameters
    ----------
    value : the number
    digits : significant digits, at most `STABLE`

    Returns
    -------
    the rounded number

    Examples
    --------
    >>> significant(0.12345649999999999), significant(0.12345650000000001), significant(2 / 3)
    (0.123456, 0.123456, 0.666667)
    """
    return float(significant_text(value, digits)) if math.isfinite(value) else value


def significant_text(value: float, digits: int = SHOWN) -> str:
    """Write a finite number with so many significant digits at most; raises nothing, -0.0 is 0."""
    return f"{float(f'{value:.{STABLE}g}') + 0.0:.{digits}g}"


def decimal_text(value: float, decimals: int) -> str:
    """Write a finite number with so many digits after the point; -0.0 is 0."""
    text = f"{float(f'{value:.{STABLE}g}'):.{decimals}f}"
    return text.lstrip("-") if float(text) == 0 else text


def negligible(value: float, scale: float) -> bool:
    """Whether a number cannot be told from 0 beside a scale.

    Parameters
    ----------
    value : the number
    scale : size of the numbers that it was computed from; one that is not finite hides nothing
    """
    return math.isfinite(scale) and abs(value) < NEGLIGIBLE * abs(scale)


def without_noise(value: float, scale: float) -> float:
    """Round a number to the digits that its computation supports, about `NEGLIGIBLE` of a scale.

    Parameters
    ----------
    value : the number; inf and NaN stay
    scale : size of the numbers that it was computed from; one that is 0 or not finite leaves the number as it is

    Returns
    -------
    the rounded number

    Examples
    --------
    >>> without_noise(0.0232562499, 2e4), without_noise(6e-15, 30.0), without_noise(1 / 3, 1.0)
    (0.02326, 0.0, 0.333333333)
    """
    if not (math.isfinite(value) and math.isfinite(scale)) or scale == 0:
        return value
    exponent = int(f"{abs(scale):.{STABLE - 1}e}".split("e")[1])
    return round(value, round(-math.log10(NEGLIGIBLE)) - exponent) + 0.0
