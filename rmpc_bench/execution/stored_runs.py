"""Which runs of a method are stored, as one flag per run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from rmpc_bench.execution.chunks import Column, Columns
from rmpc_bench.types import Array, Status

_MAYBE_WITHOUT_TRACES = [int(Status.CRASHED), int(Status.TIMEOUT)]
"""Statuses of runs that may have no trajectories, because their block was not simulated to its end."""


def runs_with(columns: Columns, method: str, metrics: Iterable[str], n_runs: int) -> Bool[Array, " runs"]:
    """Return which runs of a method have a status and all given metrics."""
    status = Column("status", method)
    n = min(n_runs, columns.stop(status))
    there = columns.stored(status, n)
    for metric in metrics:
        there &= columns.stored(Column("metric", method, metric), n)
    return there


def without_traces(
    columns: Columns, method: str, there: Bool[Array, " runs"], n_recorded: int, found: Sequence[Sequence[tuple[int]]]
) -> Bool[Array, " runs"]:
    """Return which of some runs have the trajectories that they need."""
    runs, status = columns.read(Column("status", method), len(there))
    complete = np.arange(len(there)) >= n_recorded
    complete[runs[np.isin(status, _MAYBE_WITHOUT_TRACES)]] = True
    for rows in found:
        recorded = complete.copy()
        recorded[[run for (run,) in rows if run < len(there)]] = True
        there = there & recorded
    return there


def covered(n_runs: int, spans: Iterable[tuple[int, int]]) -> Bool[Array, " n_runs"]:
    """Return which runs lie in one of some ranges.

    Examples
    --------
    >>> covered(5, [(0, 2), (4, 9)])
    array([ True,  True, False, False,  True])
    """
    found = np.zeros(n_runs, dtype=bool)
    for first, stop in spans:
        found[first:stop] = True
    return found


def rows_of_others(
    columns: Columns, method: str, others: Mapping[str, Any], n_runs: int
) -> list[tuple[list[Any], int]]:
    """Count the runs that only other code has computed, by what identifies this code."""
    kept = {key: code for key, code in others.items() if key != method}
    n = min(n_runs, max((columns.stop(Column("status", key)) for key in kept), default=0))
    missing, label = ~columns.stored(Column("status", method), n), np.zeros(n, dtype=np.int64)
    codes: list[list[Any]] = [[]]
    for key, code in kept.items():
        # Every set of codes so far is split into the runs that this code has computed too, and the others.
        there = columns.stored(Column("status", key), n) & missing
        used, label = np.unique(2 * label + there, return_inverse=True)
        codes = [[*codes[each // 2], code] if each % 2 else codes[each // 2] for each in used.tolist()]
    counts = np.bincount(label, minlength=len(codes)).tolist()
    return [(each, count) for each, count in zip(codes, counts, strict=True) if each]
