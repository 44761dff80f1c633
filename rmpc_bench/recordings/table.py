"""Columns of a csv or npz file by their names.

.csv  the first line names the columns, with commas or semicolons between them; an empty cell is a missing number (NaN).
.npz  every array is a column, or one per output: an array ``y`` of shape (samples, 2) has the columns y.0 and y.1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.received.arrays import ArrayFileError, columns
from rmpc_bench.types import Array, DesignError
from rmpc_bench.types.errors import unknown

File: TypeAlias = Path
"""A recorded file, for rooms that touch no files themselves."""

ENDINGS = (".csv", ".npz")
Columns = Mapping[str, Float[Array, " samples"]]


def read_table(file: Path) -> Columns:
    """Read a file."""
    try:
        if file.suffix.lower() not in ENDINGS:
            raise ArrayFileError(f"the ending must be one of {', '.join(ENDINGS)}")
        return columns(file)
    except ArrayFileError as error:
        raise DesignError(f"{file.name}: {error}") from None


def columns_of(table: Columns, names: str | Sequence[str], file: Path, key: str) -> Float[Array, "samples n"]:
    """Return the columns of some names, side by side."""
    found = []
    for name in [names] if isinstance(names, str) else names:
        numbered = [f"{name}.{i}" for i in range(len(table)) if f"{name}.{i}" in table]
        if name not in table and not numbered:
            raise DesignError(f"{file.name}: {unknown(name, table, 'column')}", key)
        found += [table[each] for each in ([name] if name in table else numbered)]
    return np.stack(found, axis=1) if found else np.zeros((len(next(iter(table.values()))), 0))
