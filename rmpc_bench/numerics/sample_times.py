"""Times in seconds as numbers of samples; bursts at given times, and the factor of a noise at a sample."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from rmpc_bench.types import DesignError, NonNegative

ROUNDING = 1e-9
"""Share of a sample that a time may be off: 0.3 / 0.1 is 2.9999999999999996 in doubles."""


def at_least(time: float, Ts: float) -> int:
    """Return the smallest k with time <= k Ts."""
    return math.ceil(time / Ts - ROUNDING)


def at_most(time: float, Ts: float) -> int:
    """Return the largest k with k Ts <= time."""
    return math.floor(time / Ts + ROUNDING)


@dataclass(frozen=True)
class Burst:
    """Time interval in which a noise is larger.

    Parameters
    ----------
    from_ : begin of the burst [s]
    to : end of the burst [s], included
    factor : factor on the deviation of the noise from its centre
    """

    from_: NonNegative
    to: NonNegative
    factor: NonNegative


class Span(NamedTuple):
    """Samples first..last, both included, and the factor of the noise there."""

    first: int
    last: int
    factor: float


def spans_of(bursts: Sequence[Burst], Ts: float) -> tuple[Span, ...]:
    """Return the samples of bursts, intervals in seconds; each must contain a sample."""
    spans = tuple(Span(*samples_of(each.from_, each.to, Ts), each.factor) for each in bursts)
    for number, (burst, span) in enumerate(zip(bursts, spans, strict=True)):
        if burst.to < burst.from_:
            raise DesignError(f"must not be before from, {burst.from_:g} (got {burst.to:g})", f"bursts.{number}.to")
        if span.last < span.first:
            raise DesignError(f"contains no sample; the sampling time is {Ts:g} s", f"bursts.{number}")
    return spans


def samples_of(start: float, end: float, Ts: float) -> tuple[int, int]:
    """Return the first and the last sample k with start <= k Ts <= end."""
    return at_least(start, Ts), at_most(end, Ts)


def factor_at(spans: Sequence[Span], k: int) -> float:
    """Return the product of the factors of all bursts that contain sample k, 1 outside bursts."""
    factor = 1.0
    for span in spans:
        if span.first <= k <= span.last:
            factor *= span.factor
    return factor
