"""Which samples of a run count beside bursts of its measurement noise, and what is made of them.

A burst counts until its end + memory, as long as it is felt: an estimator that looks at the last samples sees it for
some time.  The samples in bursts and the quiet ones are together all samples of a window.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.metrics.tracking import Units, Window
from rmpc_bench.noise.bursts import ROUNDING
from rmpc_bench.types import Array, DesignError, Record

When = Literal["all", "bursts", "quiet"]


class During(NamedTuple):
    """The samples that count."""

    when: When
    memory: float
    """How long a burst is felt after its end [s]."""

    def among(self, record: Record, window: Window) -> Bool[Array, "runs window"]:
        """Tell them among the samples of a window; a record that knows of no bursts is quiet."""
        shape = (len(record.y), window.last - window.first + 1)
        if self.when == "all" or record.bursts is None:
            return np.full(shape, self.when != "bursts")
        felt = lasting(record.bursts, whole_samples(self.memory, record.Ts))[:, window.slice]
        return felt if self.when == "bursts" else ~felt


def during_of(units: Units, when: When, memory: float) -> During:
    """Check which samples are to count.

    Parameters
    ----------
    units : what the metric must know of the experiment
    when : all samples, those in bursts or the quiet ones
    memory : how long a burst is felt after its end [s]

    Raises
    ------
    DesignError
        If there are no bursts, or the memory has no meaning.
    """
    if when != "all" and units.bursts is False:
        raise DesignError(
            f"{when!r} needs bursts of the measurement noise, {{uniform: {{.., bursts: ..}}}}; there are none",
            "during",
        )
    if when == "all" and memory:
        raise DesignError("belongs to during: bursts or during: quiet", "memory")
    return During(when, memory)


def whole_samples(seconds: float, Ts: float) -> int:
    """Return how many samples a time lasts at most."""
    return int(seconds / Ts + ROUNDING)


def lasting(inside: Bool[Array, "runs samples"], samples: int) -> Bool[Array, "runs samples"]:
    """Tell which samples are inside, or at most so many behind one that is."""
    k = np.arange(inside.shape[1])
    samples = min(samples, len(k))
    latest = np.maximum.accumulate(np.where(inside, k, -samples - 1), axis=1)
    lasts: Array = k - latest <= samples
    return lasts


def moving_mean(values: Float[Array, "runs samples n"], length: int) -> Float[Array, "runs samples n"]:
    """Mean over so many samples about each, those that there are at the ends; of an even number, one more before it.

    Parameters
    ----------
    values : signals over time
    length : number of samples, at least 1
    """
    n_samples = values.shape[1]
    before, after = length // 2, (length - 1) // 2
    total, count = np.zeros(values.shape), np.zeros((n_samples, 1))
    for shift in range(-min(before, n_samples - 1), min(after, n_samples - 1) + 1):
        here = slice(max(0, -shift), n_samples - max(0, shift))
        there = slice(max(0, shift), n_samples - max(0, -shift))
        total[:, here] += values[:, there]  # one after the other: the bits do not depend on the other rows
        count[here] += 1.0
    return total / count


def per_run(
    values: Float[Array, "runs window n"],
    among: Bool[Array, "runs window"],
    reduce: Callable[[Float[Array, "kept n"]], float],
) -> Float[Array, " runs"]:
    """Reduce the samples that count to a number, run by run; NaN where none does.

    Parameters
    ----------
    values : signals over time
    among : the samples that count
    reduce : makes a number of at least one sample
    """
    rows = zip(values, among, strict=True)
    return np.array([reduce(row[kept]) if kept.any() else np.nan for row, kept in rows], dtype=float)
