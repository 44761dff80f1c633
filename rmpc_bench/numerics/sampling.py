"""Times in seconds as numbers of samples."""

from __future__ import annotations

import math

ROUNDING = 1e-9
"""Share of a sample that a time may be off: 0.3 / 0.1 is 2.9999999999999996 in doubles."""


def at_least(time: float, Ts: float) -> int:
    """Return the smallest k with time <= k Ts.

    Parameters
    ----------
    time : in seconds
    Ts : sampling time [s]
    """
    return math.ceil(time / Ts - ROUNDING)


def at_most(time: float, Ts: float) -> int:
    """Return the largest k with k Ts <= time.

    Parameters
    ----------
    time : in seconds
    Ts : sampling time [s]
    """
    return math.floor(time / Ts + ROUNDING)
