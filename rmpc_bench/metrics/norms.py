"""Sizes of a signal over the samples that count, and averages over time and coordinates: one value per run.

Every function reduces each run on contiguous memory, so that its bits do not depend on the other runs of the block.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from rmpc_bench.types import Array

Norm: TypeAlias = Literal["rms", "peak", "length", "bias"]


def rms(values: Float[Array, "kept n"]) -> float:
    """Root of the mean square over samples and components."""
    return float(np.sqrt(np.mean(values**2)))


def peak(values: Float[Array, "kept n"]) -> float:
    """Largest size of a component."""
    return float(np.abs(values).max())


def length(values: Float[Array, "kept n"]) -> float:
    """Largest Euclidean length of the vector of components."""
    return float(np.sqrt((values**2).sum(axis=1)).max())


def bias(values: Float[Array, "kept n"]) -> float:
    """Largest size of a component's mean over time."""
    return float(np.abs(values.mean(axis=0)).max())


def mean_sum(values: Float[Array, "kept n"]) -> float:
    """Mean over time of the sum of the sizes of the components."""
    return float(np.abs(values).sum() / len(values))


NORMS: Mapping[Norm, Callable[[Float[Array, "kept n"]], float]] = {
    "rms": rms,
    "peak": peak,
    "length": length,
    "bias": bias,
}


def per_run(
    values: Float[Array, "runs window n"],
    counted: Bool[Array, "runs window"],
    reduce: Callable[[Float[Array, "kept n"]], float],
) -> Float[Array, " runs"]:
    """Reduce the samples that count to a number, run by run; NaN where no sample counts."""
    rows = zip(values, counted, strict=True)
    return np.array([reduce(row[kept]) if kept.any() else np.nan for row, kept in rows], dtype=float)


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
