"""Durations, sizes and lengths with their unit: ``1 s``, ``200 ms``, ``2 min``, ``2 GB``, ``252pt``, ``88 mm``."""

from __future__ import annotations

import re

_SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
_BYTES = {"kB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12, "KiB": 2.0**10, "MiB": 2.0**20, "GiB": 2.0**30, "TiB": 2.0**40}
_INCHES = {"pt": 1 / 72.27, "bp": 1 / 72, "mm": 1 / 25.4, "cm": 1 / 2.54, "in": 1.0}
_NUMBER_WITH_UNIT = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([A-Za-z]+)\s*")


def seconds(value: float | str) -> float:
    """Return a duration, a number or a text with a unit, in seconds.

    Raises a ValueError if it is none, or not longer than 0.

    Examples
    --------
    >>> seconds("200 ms"), seconds(3)
    (0.2, 3.0)
    """
    number = _converted(value, _SECONDS, "a duration such as '1 s' or '200 ms'") if isinstance(value, str) else value
    if not 0.0 < number < float("inf"):
        raise ValueError(f"must be longer than 0 s (got {value})")
    return float(number)


def n_bytes(text: str) -> int:
    """Return a size such as ``2 GB`` (2e9 bytes) or ``2 GiB`` in bytes; raises a ValueError if it is none.

    Examples
    --------
    >>> n_bytes("1.5 kB")
    1500
    """
    return int(_converted(text, _BYTES, "a size such as '2 GB' or '500 MB'"))


def inches(text: str) -> float:
    """Return a length such as ``252pt``, ``88 mm`` or ``3.5in`` in inches.

    A point is that of LaTeX, of which an inch has 72.27, as in the width of a column that LaTeX prints.  The point of
    PostScript and CSS, of which an inch has 72, is ``bp`` here and there.  Raises a ValueError if it is no length, or
    not longer than 0.

    Examples
    --------
    >>> inches("72.27pt"), inches("72 bp"), inches("3.5in")
    (1.0, 1.0, 3.5)
    """
    length = _converted(str(text), _INCHES, "a length such as '252pt', '88mm' or '3.5in'")
    if not length > 0.0:
        raise ValueError(f"must be longer than 0 (got {text})")
    return length


def _converted(text: str, units: dict[str, float], right: str) -> float:
    match = _NUMBER_WITH_UNIT.fullmatch(text)
    if match is None or match[2] not in units:
        raise ValueError(f"must be {right}; the units are {', '.join(units)} (got {text!r})")
    return float(match[1]) * units[match[2]]
