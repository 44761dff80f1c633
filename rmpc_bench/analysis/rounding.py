"""Rounding of the files under version control, such that another CPU writes the same digits.

Sums and products in another order differ by about 1e-13 of their size.  Such a difference must neither change a digit
nor turn 0 into 1e-17, so two rules hold for every number that is written:

1. It is rounded to `STABLE` significant digits first, and then to the digits that are shown.  Otherwise a number at the
   border between two roundings, such as 0.125 at two digits, could be rounded up on one CPU and down on another.
2. Digits below `NEGLIGIBLE` times the size of the numbers that it was computed from are not written: the difference of
   two equal numbers is 0, and the determinant of a nearly singular matrix has fewer digits.
"""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np

from rmpc_bench.types import Array

STABLE = 12
SHOWN = 6
NEGLIGIBLE = 1e-9
DIGITS_OF_SCALE = 9
"""Decimal places of `NEGLIGIBLE`."""


def significant(value: float, digits: int = SHOWN) -> float:
    """Round to significant digits, at most `STABLE`; inf and NaN stay.

    >>> significant(0.12345649999999999), significant(0.12345650000000001), significant(2 / 3)
    (0.123456, 0.123456, 0.666667)
    """
    return float(significant_text(value, digits)) if math.isfinite(value) else value


def significant_text(value: float, digits: int = SHOWN) -> str:
    """Write a finite number with so many significant digits at most; raises nothing, -0.0 is 0."""
    return f"{float(f'{_stable(value):.{digits - 1}e}') + 0.0:.{digits}g}"


def decimal_text(value: float, decimals: int) -> str:
    """Write a finite number with so many digits after the point; -0.0 is 0."""
    text = f"{_stable(value):.{decimals}f}"
    return text.lstrip("-") if float(text) == 0 else text


def _stable(value: float) -> Decimal:
    """Round to `STABLE` digits as a decimal number, in which a half is exactly a half: it goes to the even digit."""
    return Decimal(f"{value:.{STABLE}g}")


def negligible(value: float, scale: float) -> bool:
    """Whether a number cannot be distinguished from 0 beside the finite size of those it was computed from."""
    return math.isfinite(scale) and abs(value) < NEGLIGIBLE * abs(scale)


def without_noise(value: float, scale: float) -> float:
    """Round a number to about `NEGLIGIBLE` of the scale of what it was computed from; no scale, inf and NaN leave it.

    >>> without_noise(0.0232562499, 2e4), without_noise(6e-15, 30.0), without_noise(1 / 3, 1.0)
    (0.02326, 0.0, 0.333333333)
    """
    if not (math.isfinite(value) and math.isfinite(scale)) or scale == 0:
        return value
    exponent = int(f"{abs(scale):.{STABLE - 1}e}".split("e")[1])
    return round(value, DIGITS_OF_SCALE - exponent) + 0.0


SMALLEST = -307
_POWERS = np.array([float(f"1e{exponent}") for exponent in range(SMALLEST, 309)])
"""Powers of ten as the nearest doubles; `10.0 ** n` differs in the last bit between mathematical libraries."""
EXACT_POWER = 22
"""Exponent of the largest power of ten that is exact as a double."""


def rounded(values: Array, scale: Array | float = 0.0, digits: int = SHOWN) -> Array:
    """Round an array to significant digits, by the two rules above; inf and NaN stay.

    A spread that is small beside its scale, such as the standard error of nearly equal numbers, has fewer reliable
    digits: none is kept below `NEGLIGIBLE` of the scale, which is 0 where it is not known.

    >>> rounded(np.array([2 / 3, 0.12345650000000001, 1e-17, 1.23456e-8]), scale=1.0).tolist()
    [0.666667, 0.123456, 0.0, 1.2e-08]
    """
    values, scale = np.broadcast_arrays(np.asarray(values, dtype=float), np.asarray(scale, dtype=float))
    finite = np.isfinite(values) & (values != 0)
    numbers = np.where(finite, values, 1.0)
    known = np.isfinite(scale) & (scale != 0)
    floor = np.where(known, NEGLIGIBLE * np.abs(scale), 0.0)
    lead = _exponent(numbers)
    # From a rounded scale, as one that is 1 on this CPU may be 0.9999999999999999 on another.
    lowest = _exponent(_stable_array(np.where(known, scale, 1.0))) - DIGITS_OF_SCALE
    last = np.maximum(lead - digits + 1, np.where(known, lowest, lead - digits + 1))
    found = np.where(np.abs(numbers) < floor, 0.0, _to_decimal(numbers, lead, np.minimum(last, lead)))
    return np.where(finite, found, values) + 0.0


def _exponent(values: Array) -> Array:
    """Exponent of the leading digit; comparisons decide it, as a logarithm may miss it at powers of ten."""
    found: Array = np.searchsorted(_POWERS, np.abs(values), side="right") - 1 + SMALLEST
    return np.maximum(found, SMALLEST)


def _stable_array(values: Array) -> Array:
    """Round finite numbers, none of them 0, to `STABLE` digits."""
    lead = _exponent(values)
    return _to_decimal(values, lead, lead - STABLE + 1)


def _to_decimal(values: Array, lead: Array, last: Array) -> Array:
    """Round to `STABLE` digits and then to a multiple of ``10**last``: the nearest double of the decimal number."""
    shift = STABLE - 1 - lead
    # Whole numbers of `STABLE` digits are exact, so that a half is exactly a half: it goes to the even digit.
    whole = np.rint(_times_power(values, shift))
    found = _times_power(np.rint(whole / _power(last + shift)), last)
    for i in np.flatnonzero((np.abs(shift) > EXACT_POWER) | (np.abs(last) > EXACT_POWER)):
        found.flat[i] = float(f"{_stable(values.flat[i]):.{lead.flat[i] - last.flat[i]}e}")
    return found


def _times_power(values: Array, exponent: Array) -> Array:
    """Multiply by ``10**exponent``; a power with a negative exponent is not exact, so its inverse divides."""
    return np.where(exponent < 0, values / _power(-exponent), values * _power(exponent))


def _power(exponent: Array) -> Array:
    found: Array = _POWERS[np.clip(exponent, 0, EXACT_POWER) - SMALLEST]
    return found
