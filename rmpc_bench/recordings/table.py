"""Columns of a csv or npz file by their names.

.csv  the first line names the columns, with commas or semicolons between them; an empty cell is a missing number (NaN).
.npz  every array is a column, or one per output: an array ``y`` of shape (samples, 2) has the columns y.0 and y.1.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, DesignError
from rmpc_bench.types.issue import unknown

File: TypeAlias = Path
"""A recorded file, for rooms that touch no files themselves."""

Columns = Mapping[str, Float[Array, " samples"]]


def read_table(file: Path) -> Columns:
    """Read a file.

    Parameters
    ----------
    file : with the ending .csv or .npz

    Returns
    -------
    Name -> column; all columns have the same length.

    Raises
    ------
    DesignError
        If the file is not such a table; the message begins with its name.
    """
    readers = {".csv": _read_csv, ".npz": _read_npz}
    try:
        if file.suffix.lower() not in readers:
            raise DesignError(f"the ending must be one of {', '.join(readers)}")
        if file.exists() and not file.is_file():
            raise DesignError("is not a regular file")
        table = readers[file.suffix.lower()](file)
        lengths = {len(column) for column in table.values()}
        if len(lengths) > 1:
            raise DesignError(f"has columns of different lengths ({', '.join(map(str, sorted(lengths)))})")
        if not table or lengths == {0}:
            raise DesignError("has no samples")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DesignError(f"{file.name}: cannot be read ({error})") from None
    except DesignError as error:
        raise DesignError(f"{file.name}: {error}") from None
    return table


def columns_of(table: Columns, names: str | Sequence[str], file: Path, key: str) -> Float[Array, "samples n"]:
    """Return the columns of some names, side by side.

    Parameters
    ----------
    table : of a file
    names : names of columns; ``y`` stands for y.0, y.1 and so on where there is no column of this name
    file : for the messages
    key : of the configuration, for the messages

    Raises
    ------
    DesignError
        If there is no such column.
    """
    found = []
    for name in [names] if isinstance(names, str) else names:
        numbered = [f"{name}.{i}" for i in range(len(table)) if f"{name}.{i}" in table]
        if name not in table and not numbered:
            raise DesignError(f"{file.name}: {unknown(name, table, 'column')}", key)
        found += [table[each] for each in ([name] if name in table else numbered)]
    return np.stack(found, axis=1) if found else np.zeros((len(next(iter(table.values()))), 0))


def _read_csv(file: Path) -> Columns:
    with file.open(encoding="utf-8-sig", newline="") as lines:
        first = lines.readline()
        lines.seek(0)
        delimiter = ";" if ";" in first and "," not in first else ","
        rows = [(number, row) for number, row in enumerate(csv.reader(lines, delimiter=delimiter), start=1) if row]
    if not rows:
        raise DesignError("is empty")
    names = [cell.strip() for cell in rows[0][1]]
    if any(_is_number(name) for name in names) or not all(names):
        raise DesignError("the first line must name the columns, such as t,u,y")
    repeated = [name for number, name in enumerate(names) if name in names[:number]]
    if repeated:
        raise DesignError(f"has two columns of the name {repeated[0]!r}")
    values = np.array([_numbers(row, number, names) for number, row in rows[1:]]).reshape(-1, len(names))
    return dict(zip(names, values.T, strict=True))


def _numbers(row: list[str], number: int, names: list[str]) -> list[float]:
    if len(row) != len(names):
        raise DesignError(f"line {number} has {len(row)} cells, and there are {len(names)} columns")
    try:
        return [float(cell) if cell.strip() else np.nan for cell in row]
    except ValueError:
        name, cell = next((name, cell) for name, cell in zip(names, row, strict=True) if not _is_number(cell or "0"))
        raise DesignError(f"line {number}: {cell!r} in the column {name!r} is no number") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_npz(file: Path) -> Columns:
    from zipfile import BadZipFile

    table: dict[str, Array] = {}
    try:
        with np.load(file, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
    except (BadZipFile, AttributeError, ValueError):
        raise DesignError("is not an archive of arrays of numbers, as numpy.savez writes it") from None
    for name, array in arrays.items():
        if array.dtype.kind not in "biuf" or array.ndim not in (1, 2):
            continue
        columns = {name: array} if array.ndim == 1 else {f"{name}.{i}": column for i, column in enumerate(array.T)}
        table |= {each: column.astype(float) for each, column in columns.items()}
    return table
