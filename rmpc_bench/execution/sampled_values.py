"""Named uncertain quantities of the runs in the trial store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Int

from rmpc_bench.execution.chunks import Column, Columns
from rmpc_bench.types import Array

Sampled = Sequence[Mapping[str, float]] | Mapping[str, Array]
"""Values of some runs: name -> value for every run, or name -> (runs,) values, NaN where there is none."""


def by_name(sampled: Sampled) -> dict[str, Array]:
    """Return name -> (runs,) values, NaN where a run has none.

    Examples
    --------
    >>> by_name([{"a": 1.0}, {"a": 2.0, "b": 3.0}])
    {'a': array([1., 2.]), 'b': array([nan,  3.])}
    """
    if isinstance(sampled, Mapping):
        return {name: np.array(values, dtype=float) for name, values in sampled.items()}
    names = dict.fromkeys(name for row in sampled for name in row)
    return {name: np.array([row.get(name, np.nan) for row in sampled]) for name in names}


def read_sampled(columns: Columns, draw: str, n_runs: int) -> tuple[Int[Array, " runs"], dict[str, Array]]:
    """Return the runs that have a value, ascending, and name -> (runs,) values, NaN where there is none."""
    found = {
        name: columns.read(Column("uncertainty", draw, name), n_runs) for name in columns.names("uncertainty", draw)
    }
    stop = max((int(stored[-1]) + 1 for stored, _ in found.values() if len(stored)), default=0)
    there, whole = np.zeros(stop, dtype=bool), dict[str, Array]()
    for name, (stored, values) in found.items():
        whole[name] = np.full(stop, np.nan)
        whole[name][stored] = values
        there |= ~np.isnan(whole[name])
    return np.flatnonzero(there), {name: values[there] for name, values in whole.items()}
