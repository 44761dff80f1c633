"""Sizes of a signal over the samples that count, run by run."""

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
