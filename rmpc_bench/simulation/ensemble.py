"""Mean and covariance over the runs at every k, computed in groups so that trajectories need not be stored.

A group is a fixed range of 50 runs, or the part of it in a block.  The moments of the groups are combined in the order
of the runs, so that the result depends on the block size only by rounding.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types import Array

SIZE = 50


class Group(NamedTuple):
    """Runs first..stop-1, without those that failed."""

    first: int
    stop: int
    n: int
    """How many of them ended well."""
    mean: Float[Array, "samples nz"]
    """Of z = (x, x_hat); zero where there is none."""
    second: Float[Array, "samples nz nz"]
    """Sum of (z - mean)(z - mean)'."""


def groups(
    x: Float[Array, "runs samples nx"],
    x_hat: Float[Array, "runs samples nx_hat"],
    ok: Bool[Array, " runs"],
    runs: range,
) -> list[Group]:
    """Gather the runs of a block.

    Parameters
    ----------
    x, x_hat : true state and estimate
    ok : which runs ended well
    runs : their indices
    """
    found = []
    for first, stop in _ranges(runs):
        rows = slice(first - runs.start, stop - runs.start)
        good = ok[rows]
        z = np.concatenate([x[rows][good], x_hat[rows][good]], axis=2)
        n = len(z)
        mean = z.sum(axis=0) / max(n, 1)
        deviation = np.ascontiguousarray((z - mean).transpose(1, 2, 0))
        found.append(Group(first, stop, n, mean, deviation @ deviation.mT))
    return found


def _ranges(runs: range) -> Iterator[tuple[int, int]]:
    first = runs.start
    while first < runs.stop:
        stop = min(runs.stop, (first // SIZE + 1) * SIZE)
        yield first, stop
        first = stop


def joined(parts: Sequence[Group]) -> tuple[int, Float[Array, "samples nz"], Float[Array, "samples nz nz"]]:
    """Return the number of runs, their mean and their covariance (over n - 1; NaN of less than two runs).

    Parameters
    ----------
    parts : groups in the order of the runs, not empty
    """
    _, _, n, mean, second = parts[0]
    for part in parts[1:]:
        if part.n:
            gap, total = part.mean - mean, n + part.n
            mean = mean + gap * (part.n / total)
            second = second + part.second + gap[..., :, None] * gap[..., None, :] * (n * part.n / total)
            n = total
    return n, mean, second / (n - 1) if n > 1 else np.full_like(second, np.nan)
