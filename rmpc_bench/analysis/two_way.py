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
    reference: tuple[int, int]
    """Places of the entries that the others are compared with."""
    values: Array
    """(first, second, runs) logarithms, or distances from the best value if signed; NaN where a method is left out."""
    effects: Mapping[tuple[str, str], Array]
    """Entries of both axes -> interaction of every run; of a main effect the entry of the other axis is empty."""
    runs: Array
    """Indices of the runs that all methods finished."""
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
    named = {name: name.partition("+")[::2] for name in trials.methods}
    given, signed = [*trials.two_way.values()], is_signed(trials, info)
    cells = {cell: name for name, cell in named.items() if cell[0] in given[0] and cell[1] in given[1]}
    first, second = ([name for name in axis if name in {cell[k] for cell in cells}] for k, axis in enumerate(given))
    if min(len(first), len(second)) < 2:
        return None
    columns = {cell: distance_from_best(trials.column(info.name, name), info.direction) for cell, name in cells.items()}
    has_value = np.isfinite([*columns.values()]).all(axis=0)
    values = np.full((len(first), len(second), int(has_value.sum())), np.nan)
    for (a, b), column in columns.items():
        values[first.index(a), second.index(b)] = column[has_value]
    if not values.shape[-1] or (not signed and (values <= 0).any()):
        return None
    scale, values = (float(np.nanmean(np.abs(values))), values) if signed else (1.0, np.log(values))
    a0, b0 = found if (found := named.get(trials.baseline)) in cells else next(iter(cells))
    i0, j0 = first.index(a0), second.index(b0)
    rows, over = values.mean(axis=1), values - values[:, [j0]]
    effects = {(a, ""): rows[i] - rows[i0] for i, a in enumerate(first) if i != i0}
    for j, b in ((j, b) for j, b in enumerate(second) if j != j0):
        effects |= {("", b): over[:, j].mean(axis=0)}
        effects |= {(a, b): over[i, j] - over[i0, j] for i, a in enumerate(first) if i != i0}
    known = {cell: each for cell, each in effects.items() if not np.isnan(each).any()}
    known = {cell: np.where(np.abs(each) <= NEGLIGIBLE * scale, 0.0, each) for cell, each in known.items()}
    axes, runs = [*trials.two_way], trials.runs[has_value]
    return TwoWay(axes, (first, second), (i0, j0), values, known, runs, signed, scale)
