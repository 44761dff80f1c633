"""Main effects and interactions of two axes of methods, such as estimators and controllers, run by run.

Model   With m_ab the metric of the method a+b, and a0+b0 the baseline, or the first method where that is another one:
            main effect of a         the mean over all b of ln(m_ab / m_a0b), of b in the same way
            interaction of a and b   ln(m_ab m_a0b0 / (m_ab0 m_a0b))
        For a signed metric differences stand in place of the logarithms of ratios.
Failed  A run that failed with one of the methods, or has no value there, is left out of all effects.
Limit   An entry has no main effect if a method of it, or of the entry of the baseline, is left out of the grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from rmpc_bench.analysis.pairs import distance_from_best, is_signed
from rmpc_bench.analysis.rounding import NEGLIGIBLE
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array, MetricInfo


class TwoWay(NamedTuple):
    """One metric of all methods of two axes."""

    axes: Sequence[str]
    entries: tuple[list[str], list[str]]
    """Names on both axes."""
    values: Array
    """(first, second, runs) logarithms, or distances from the best value if signed; NaN where a method is left out."""
    gains: Array
    """(first, second, runs) differences from the method with the entry of the baseline on the first axis."""
    effects: Mapping[tuple[str, str], Array]
    """Entries of both axes -> interaction of every run; of a main effect the entry of the other axis is empty."""
    runs: Array
    """Indices of the runs that all methods finished."""
    n_left_out: int
    """Number of the other runs."""
    signed: bool
    """Whether differences have the unit of the metric."""
    scale: float
    """Size of the numbers that effects are computed from."""


def two_way(trials: Trials, info: MetricInfo) -> TwoWay | None:
    """Compare a metric at one point of a sweep; None without two axes, and where the metric has no average.

    It has none if its event may not occur, or a value of 0 has no ratio.
    """
    if trials.two_way is None or len(trials.two_way) != 2 or info.may_not_occur:
        return None
    axes = [*trials.two_way.values()]
    named = {name: name.partition("+")[::2] for name in trials.methods}
    cells = {cell: name for name, cell in named.items() if cell[0] in axes[0] and cell[1] in axes[1]}
    first, second = ([name for name in axis if name in {cell[k] for cell in cells}] for k, axis in enumerate(axes))
    if min(len(first), len(second)) < 2:
        return None
    values = np.full((len(first), len(second), len(trials.runs)), np.nan)
    has_value, signed = np.ones(len(trials.runs), dtype=bool), is_signed(trials, info)
    for (a, b), name in cells.items():
        column = distance_from_best(trials.column(info.name, name), info.direction)
        values[first.index(a), second.index(b)] = column
        has_value &= np.isfinite(column)
    values = values[:, :, has_value]
    if not has_value.any() or (not signed and (values <= 0).any()):
        return None
    reference = named.get(trials.baseline)
    a0, b0 = reference if reference in cells else next(iter(cells))
    scale = float(np.nanmean(np.abs(values))) if signed else 1.0
    values = values if signed else np.log(values)
    i0, j0 = first.index(a0), second.index(b0)
    gains, over = values - values[i0], values - values[:, [j0]]
    effects = {(a, ""): gains[i].mean(axis=0) for i, a in enumerate(first) if i != i0}
    effects |= {("", b): over[:, j].mean(axis=0) for j, b in enumerate(second) if j != j0}
    effects |= {(a, b): gains[i, j] - gains[i, j0] for i, a in enumerate(first) for j, b in enumerate(second)
                if i != i0 and j != j0}  # fmt: skip
    kept = {
        cell: np.where(np.abs(each) <= NEGLIGIBLE * scale, 0.0, each)
        for cell, each in effects.items()
        if not np.isnan(each).any()
    }
    left_out = int((~has_value).sum())
    return TwoWay(
        [*trials.two_way], (first, second), values, gains, kept, trials.runs[has_value], left_out, signed, scale
    )
