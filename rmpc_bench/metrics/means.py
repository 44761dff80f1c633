"""Averages over time and coordinates, one value per run.

Every function reduces each run on contiguous memory, so that its bits do not depend on the other runs of the block.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array


def time_mean(values: Float[Array, "runs window n"]) -> Float[Array, " runs"]:
    """Mean over time and coordinates."""
    means: Array = np.ascontiguousarray(values.reshape(len(values), -1)).mean(axis=1)
    return means


def mean_square(values: Float[Array, "runs window n"]) -> Float[Array, " runs"]:
    """Mean of the squares over time and coordinates."""
    return time_mean(values**2)


def mean_absolute(values: Float[Array, "runs window n"]) -> Float[Array, " runs"]:
    """Mean of the absolute values over time and coordinates."""
    return time_mean(np.abs(values))


def moving_mean(values: Float[Array, "runs samples n"], length: int) -> Float[Array, "runs samples n"]:
    """Centred moving average over `length` samples, one more before than after if even; shorter at the ends."""
    n_samples = values.shape[1]
    before, after = length // 2, (length - 1) // 2
    total, count = np.zeros(values.shape), np.zeros((n_samples, 1))
    for shift in range(-min(before, n_samples - 1), min(after, n_samples - 1) + 1):
        here = slice(max(0, -shift), n_samples - max(0, shift))
        there = slice(max(0, shift), n_samples - max(0, -shift))
        # One sample after the other, so that the bits do not depend on the other runs.
        total[:, here] += values[:, there]
        count[here] += 1.0
    return total / count
