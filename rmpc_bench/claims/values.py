"""Values in a claim: arrays over runs, over k or over neither, and their combination entry by entry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from rmpc_bench.analysis.intervals import difference
from rmpc_bench.types import Array


class EvaluationError(Exception):
    """A claim that the stored results cannot answer; the message is the reason that claims.md gives."""


class NoValue(EvaluationError):
    """These numbers give no value; others may."""


class NoSample(EvaluationError):
    """A series is too short; a longer one would have the sample."""


@dataclass(frozen=True)
class Value:
    """An array whose axis 0 is ``runs`` or ``k``, or has no such axis (a number or a matrix).

    Parameters
    ----------
    array : the numbers
    axis : what axis 0 is; empty for none
    cut : first and last sample of a series that is a part of one; None for a whole one
    """

    array: Array
    axis: str = ""
    cut: tuple[int, int] | None = None

    @property
    def entry(self) -> tuple[int, ...]:
        """Shape of what stands at one run or one k."""
        return tuple(self.array.shape[1:] if self.axis else self.array.shape)

    @property
    def span(self) -> tuple[int, int]:
        """First and last sample."""
        return self.cut or (0, len(self.array) - 1)

    @property
    def constant(self) -> bool:
        """Whether a series has the same entry at all k, which is then stored once; a cut to one sample has not."""
        return self.cut is None and len(self.array) == 1

    def of(self, array: ArrayLike) -> Value:
        """Return another array for the same runs or samples."""
        return replace(self, array=np.asarray(array))


def joined(*values: Value) -> list[Value]:
    """Give values the same axis 0, of length 1 where a value does not change along it.

    Columns do not meet series, nor series those of other samples: this is an EvaluationError.
    """
    axes = {value.axis for value in values if value.axis}
    if len(axes) > 1:
        raise EvaluationError("a column over runs and a series over k cannot be combined entry by entry")
    axis = axes.pop() if axes else ""
    changing = [value for value in values if value.axis and not value.constant]
    spans = list(dict.fromkeys(value.span for value in changing))
    if len(spans) > 1:
        counts = " and ".join(str(last - first + 1) for first, last in spans)
        ends = " and ".join(f"{first} to {last}" for first, last in spans)
        raise EvaluationError(f"series of {counts} samples (k = {ends}) cannot be combined")
    cut = changing[0].cut if changing else None
    return [Value(value.array if value.axis or not axis else value.array[None], axis, cut) for value in values]


def aligned(*values: Value) -> list[Value]:
    """Give values the same axis 0 and the same number of dimensions; a number fits entries of any shape."""
    shapes = list(dict.fromkeys(value.entry for value in values if value.entry))
    if len(shapes) > 1:
        raise EvaluationError(f"entries of shapes {' and '.join(map(str, shapes))} cannot be combined")
    depth = len(shapes[0]) if shapes else 0
    return [
        value.of(value.array.reshape(value.array.shape + (1,) * (depth - len(value.entry))))
        for value in joined(*values)
    ]


def combine(function: Callable[..., Array], *values: Value) -> Value:
    """Apply a function entry by entry."""
    parts = aligned(*values)
    with np.errstate(all="ignore"):
        return parts[0].of(function(*(part.array for part in parts)))


def divided(a: Array, b: Array) -> Array:
    """Divide entry by entry; nothing can be divided by 0."""
    return np.where(b == 0, np.nan, a / b)


def negative(value: Value) -> Value:
    """Change the sign, entry by entry; of 0 it is 0, without a sign."""
    return value.of(difference(np.zeros(()), value.array))


def listed(items: Sequence[Value]) -> Value:
    """Put the entries of a list together: numbers to a vector, columns or series to a column or series of vectors."""
    shapes = list(dict.fromkeys(item.entry for item in items))
    if len(shapes) > 1:
        raise EvaluationError(f"the entries of a list must have one shape, got {' and '.join(map(str, shapes))}")
    parts = joined(*items)
    arrays = np.broadcast_arrays(*(part.array for part in parts))
    return parts[0].of(np.stack(arrays, axis=1 if parts[0].axis else 0))


def compare(operator: str, left: Array, right: Array, tolerance: Array) -> Array:
    """Compare entry by entry; ~ means equal up to the tolerance, and inf equals inf."""
    if operator == "~":
        gap = np.abs(difference(left, right))
        return np.asarray((gap == 0) | (np.isfinite(gap) & (gap <= tolerance)))
    functions = {
        "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal,
    }  # fmt: skip
    return np.asarray(functions[operator](left, right))
