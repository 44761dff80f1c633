"""Sizes of the matrices of a model, and messages about a matrix that does not fit.

A matrix that is square by its meaning (A, a covariance, the shape of a set) may be a number, which stands for that
number times the identity, or a list, its diagonal.  Any other matrix (B, C, D, H, G) is written row by row, because a
flat list is a row as well as a column.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from rmpc_bench.types import Array, DesignError, row_by_row

Sizes = Mapping[str, tuple[str, str]]
"""Matrix -> names of the number of its rows and of its columns."""

NOUNS: Mapping[str, str] = {
    "nx": "state", "nu": "input", "ny": "output", "nw": "process noise", "nv": "measurement noise"
}  # fmt: skip
MAX_ENTRIES = 12
"""Entries of the largest matrix that a message repeats."""


def sizes_of(read: Mapping[str, Array], table: Sizes) -> dict[str, int]:
    """Determine all sizes: first from lists in the order of the table, then from numbers.

    Numbers are (k,), diagonals (k, n), matrices (k, rows, columns).  A DesignError says that a size contradicts those
    before, or that a matrix which is not square by its meaning is a flat list.
    """
    sizes: dict[str, int] = {}
    given = {name: matrix for name, matrix in read.items() if matrix.ndim > 1}
    # In the order of the table: A gives the number of states, so that errors name the matrix to be transposed.
    for name in [name for name in table if name in given]:
        _learn(name, given[name], sizes, table)
    numbers = [name for name, matrix in read.items() if matrix.ndim == 1 and matrix.any()]
    # Repeated passes, as a number may determine a size that an earlier one needs.
    for name in numbers * len(numbers):
        known = [sizes[size] for size in table[name] if size in sizes]
        if len(set(known)) == 1:
            _learn(name, np.empty((1, known[0], known[0])), sizes, table)
    return {size: sizes.get(size, 1) for pair in table.values() for size in pair}


def expanded(name: str, matrix: Array, shape: tuple[int, int]) -> Float[Array, "k rows columns"]:
    """Expand numbers (k,) and diagonals (k, n) to matrices."""
    if matrix.ndim == 3:
        return matrix
    if matrix.ndim == 1 and not matrix.any():
        return np.zeros((1, *shape))
    if shape[0] != shape[1]:
        message = f"a number stands for a multiple of the identity, but {shape[0]} x {shape[1]} entries are required"
        raise DesignError(f"{message}, written row by row", name)
    return matrix.reshape(len(matrix), 1, -1) * np.eye(shape[0])


def refuse_flat(name: str, values: Array, sizes: Mapping[str, int], names: tuple[str, str]) -> None:
    """Refuse a flat list for a matrix that is not square by its meaning; both of its meanings are shown."""
    known = [sizes.get(size) for size in names]
    fits = [
        matrix
        for matrix, shape in ((values[None], (1, len(values))), (values[:, None], (len(values), 1)))
        if all(n in (None, length) for n, length in zip(known, shape, strict=True))
    ]
    meanings = row_by_row(values.tolist(), lambda *shape: _meaning(names, shape))
    only = f"; the other matrices fit {_shown(fits[0])}" if len(fits) == 1 and len(values) > 1 else ""
    raise DesignError(f"a flat list is ambiguous here: {meanings}{only}", name)


def misfit(matrix: Array, sizes: Mapping[str, int], names: tuple[str, str]) -> str:
    """Describe a matrix of the wrong shape, with the shape given and the one that the names of its sizes expect."""
    rows, columns = matrix.shape
    if names[0] == names[1] and rows != columns:
        return f"has the shape {rows} x {columns}; a square matrix is expected ({names[0]} x {names[1]})"
    expected = [sizes.get(size) for size in names]
    known = dict.fromkeys(f"{size} = {sizes[size]}" for size in names if size in sizes)
    shape = " x ".join(size if n is None else str(n) for size, n in zip(names, expected, strict=True))
    message = f"has the shape {rows} x {columns}; {shape} fits the other matrices ({', '.join(known)})"
    turned = all(n in (None, length) for n, length in zip(expected, (columns, rows), strict=True))
    if not turned or rows == columns:
        return message
    return f"{message}, which its transpose has" + (f": {_shown(matrix.T)}" if matrix.size <= MAX_ENTRIES else "")


def _learn(name: str, matrix: Array, sizes: dict[str, int], table: Sizes) -> None:
    """Add the sizes that a matrix (k, rows, columns) or a diagonal (k, n) gives."""
    names = table[name]
    is_square = names[0] == names[1]
    if matrix.ndim == 2 and not is_square:
        refuse_flat(name, matrix[0], sizes, names)
    shape = matrix.shape[1:] if matrix.ndim == 3 else matrix.shape[1:] * 2
    wrong = [size for size, length in zip(names, shape, strict=True) if sizes.get(size, length) != length]
    if wrong and matrix.ndim == 2:
        raise DesignError(f"is a diagonal: it {misfit(np.diag(matrix[0]), sizes, names)}", name)
    if wrong or (is_square and shape[0] != shape[1]):
        raise DesignError(misfit(matrix[0], sizes, names), name)
    sizes.update(zip(names, shape, strict=True))


def _meaning(names: tuple[str, str], shape: tuple[int, int]) -> str:
    """Say what the rows and columns of a matrix stand for, such as ``1 output, 2 states``."""
    words = [
        f"{n} {NOUNS[size]}{'s' * (n > 1)}" if size in NOUNS else f"{size} = {n}"
        for size, n in zip(names, shape, strict=True)
    ]
    return ", ".join(words)


def _shown(matrix: Array) -> str:
    """Write a matrix as a list of rows."""
    return "[" + ", ".join(f"[{', '.join(f'{value:g}' for value in row)}]" for row in matrix) + "]"
