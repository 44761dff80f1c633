"""The base class of metrics over the samples inside or outside bursts of the measurement noise.

A burst counts until its end + memory, because it affects an estimator with a moving window for some time afterwards.
Every sample of a window is either in a burst or quiet.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Bool

from rmpc_bench.numerics.sample_times import at_most
from rmpc_bench.types import Array, Issue, MetricLayout, NonNegative, Record, SampleWindow, WindowMetric

During: TypeAlias = Literal["all", "bursts", "quiet"]


@dataclass(frozen=True, kw_only=True)
class BurstMetric(WindowMetric):
    """A metric over all samples of the window, over those in bursts, or over the quiet ones.

    A run without such a sample has no value (NaN).

    Parameters
    ----------
    during : samples that count: `all`, those in `bursts`, or `quiet`, those outside bursts
    memory : time after the end of a burst that still counts as part of it [s]
    """

    during: During = "all"
    memory: NonNegative = 0.0

    def check(self, layout: MetricLayout) -> Iterator[Issue]:
        """Find an invalid window, bursts that the noise does not have, and a memory that has no effect."""
        yield from super().check(layout)
        yield from check_bursts(layout, self.during)
        if self.during == "all" and self.memory:
            yield Issue("memory", "can only be given with during: bursts or during: quiet")

    def counted(self, record: Record) -> Bool[Array, "runs window"]:
        """Return which samples of the window count."""
        return burst_samples(record, self.samples(record), self.during, self.memory)


def check_bursts(layout: MetricLayout, during: During) -> Iterator[Issue]:
    """Report `during: bursts` or `during: quiet` if the measurement noise has no bursts."""
    if during != "all" and layout.bursts is False:
        yield Issue(
            "during",
            f"{during!r} needs bursts of the measurement noise, {{uniform: {{.., bursts: ..}}}}; there are none",
        )


def burst_samples(record: Record, window: SampleWindow, during: During, memory: float) -> Bool[Array, "runs window"]:
    """Return which samples of a window count; in a record without bursts all samples are quiet.

    The time `memory` [s] after the end of a burst counts as part of it.
    """
    if during == "all" or record.bursts is None:
        return np.full((len(record.y), window.length), during != "bursts")
    inside = prolonged(record.bursts, at_most(memory, record.Ts))[:, window.slice]
    return inside if during == "bursts" else ~inside


def prolonged(inside: Bool[Array, "runs samples"], n: int) -> Bool[Array, "runs samples"]:
    """Return which samples are inside, or at most n samples after one that is."""
    k = np.arange(inside.shape[1])
    n = min(n, len(k))
    latest = np.maximum.accumulate(np.where(inside, k, -n - 1), axis=1)
    chosen: Array = k - latest <= n
    return chosen
