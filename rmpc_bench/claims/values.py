"""Values in a claim: arrays over runs, over k or over neither, and the functions of claims applied to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rmpc_bench.analysis.intervals import difference, quantile
from rmpc_bench.types import Array

SINGULAR = 1e-12
"""Share of the largest eigenvalue below which an eigenvalue counts as 0."""
ASYMMETRIC = 1e-9
"""Share of the largest entry that mirrored entries may differ by; text files and long recursions keep more digits."""


class EvaluationError(Exception):
    """A claim that the stored results cannot answer; the message is the reason that claims.md gives."""


class NoValue(EvaluationError):
    """These numbers give no value; others may."""


class NoSample(EvaluationError):
    """A series is too short; a longer one would have the sample."""


@dataclass(frozen=True)
class Value:
    """An array whose axis 0 is ``runs`` or ``k``, or has no such axis (a number or a matrix)."""

    array: Array  # the numbers
    axis: str = ""  # what axis 0 is; empty for none
    cut: tuple[int, int] | None = None  # first and last sample of a series that is a part of one; None for a whole one

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


def of_matrix(name: str, value: Value) -> Value:
    """Evaluate diag, trace or det of a matrix, or of each of a series; of a number it is the number."""
    if not value.entry:
        return value
    _check_square(name, value)
    if name == "det":
        return value.of(np.linalg.det(value.array))
    diagonal = np.diagonal(value.array, axis1=-2, axis2=-1)
    return value.of(diagonal.sum(axis=-1) if name == "trace" else diagonal)


class Spectrum(NamedTuple):
    """Eigenvalues of a stack of symmetric matrices, with those apart that are 0 up to rounding."""

    directions: Array  # (..., n, n) eigenvectors in the columns
    kept: Array  # (..., n) whether the direction lies in the range
    scale: Array  # (..., n) 1 / sqrt(eigenvalue); 0 for what is not kept
    largest: Array  # (...) eigenvalue
    finite: Array  # (...) whether the matrix is finite; the identity replaces the others here

    @classmethod
    def of(cls, name: str, matrices: Array) -> Spectrum:
        """Decompose matrices (..., n, n), the last argument of a function."""
        finite = np.asarray(np.isfinite(matrices).all(axis=(-2, -1)))
        values, directions = np.linalg.eigh(np.where(finite[..., None, None], matrices, np.eye(matrices.shape[-1])))
        size = np.abs(values).max(axis=-1, keepdims=True)
        if (values < -SINGULAR * size).any():
            raise NoValue(f"the last argument of {name} has a negative eigenvalue, {values.min():.3g}")
        kept = values > SINGULAR * size
        return cls(directions, kept, kept / np.sqrt(np.where(kept, values, 1.0)), size[..., 0], finite)


def excess(a: Value, b: Value) -> Value:
    """Compute the largest generalised eigenvalue, max z'az / z'bz: above 1 where b does not cover a.

    Where b is singular it is inf if a reaches outside its range, else the value on the range (0 where both are 0); NaN
    where an entry is missing.
    """
    a, b = aligned(_symmetric("excess", a), _symmetric("excess", b))
    part = Spectrum.of("excess", b.array)
    finite = np.asarray(np.isfinite(a.array).all(axis=(-2, -1)))
    inner = np.where(finite[..., None, None], a.array, 0.0)
    inner = np.swapaxes(part.directions, -2, -1) @ inner @ part.directions
    null = ~part.kept
    # Rounding of a, or of what b may have there, is no reach.
    limit = SINGULAR * np.maximum(np.abs(inner).max(axis=(-2, -1)), part.largest)
    outside = (np.abs(inner) * null[..., :, None] * null[..., None, :]).max(axis=(-2, -1)) > limit
    inner = inner * part.scale[..., :, None] * part.scale[..., None, :]
    # Directions that b does not have are put below all others, or their 0 would hide a negative largest eigenvalue.
    below = null * np.linalg.norm(inner, axis=(-2, -1))[..., None]
    largest = np.linalg.eigvalsh(inner - below[..., None] * np.eye(inner.shape[-1]))[..., -1]
    return a.of(np.where(finite & part.finite, np.where(outside, np.inf, largest), np.nan))


def distance(x: Value, centre: Value, P: Value) -> Value:
    """Compute sqrt((x - centre)' P^-1 (x - centre)): at most 1 in the ellipsoid of P.

    Where P is singular it is inf if x - centre reaches outside its range, else the distance in the range; inf where an
    entry of x - centre is infinite, NaN where one is missing.
    """
    gap, P = combine(difference, x, centre), _symmetric("distance", P)
    gap = gap if gap.entry else gap.of(gap.array[..., None])
    if P.entry != gap.entry * 2:
        raise EvaluationError(f"distance needs a vector and a matrix, got entries of shapes {gap.entry} and {P.entry}")
    gap, P = joined(gap, P)
    part, finite = Spectrum.of("distance", P.array), np.isfinite(gap.array)
    along = np.einsum("...ji,...j->...i", part.directions, np.where(finite, gap.array, 0.0))
    limit = SINGULAR * np.maximum((along**2).max(axis=-1), part.largest)
    outside = (along**2 * ~part.kept).max(axis=-1) > limit
    found = np.where(outside, np.inf, np.sqrt(((along * part.scale) ** 2).sum(axis=-1)))
    found = np.where(finite.all(axis=-1), found, np.inf)
    return gap.of(np.where(np.isnan(gap.array).any(axis=-1) | ~part.finite, np.nan, found))


def _symmetric(name: str, value: Value) -> Value:
    """Check that matrices are symmetric up to rounding, and make them so; a number is a matrix of one entry."""
    if value.entry:
        _check_square(name, value)
    array = value.array if value.entry else value.array[..., None, None]
    mirrored = np.swapaxes(array, -2, -1)
    if (np.abs(array - mirrored) > ASYMMETRIC * np.abs(array).max(axis=(-2, -1), keepdims=True)).any():
        raise NoValue(f"{name} needs symmetric matrices")
    return value.of((array + mirrored) / 2)


def _check_square(name: str, value: Value) -> None:
    if len(value.entry) != 2 or value.entry[0] != value.entry[1]:
        raise EvaluationError(f"{name} needs square matrices, got entries of shape {value.entry}")


@np.errstate(all="ignore")
def applied(name: str, values: list[Value]) -> Value:
    """Apply a function of the grammar, other than share and all; NaN where there is no value."""
    first = values[0]
    if name in _REDUCTIONS:
        return Value(np.asarray(_REDUCTIONS[name](_sample(first))))
    if name == "quantile":
        q = values[1].array
        if q.ndim or not 0 <= q <= 1:
            raise EvaluationError("the second argument of quantile is a number from 0 to 1")
        return Value(_quantile(_sample(first), float(q)))
    if name in ("last", "at", "slope", "since", "upto"):
        return _of_series(name, values)
    if name == "abs":
        return first.of(np.abs(first.array))
    if name in ("diag", "trace", "det"):
        return of_matrix(name, first)
    return _OF_SEVERAL[name](*values)


def _sample(value: Value) -> Array:
    """Array that a reduction takes along axis 0: a column or series, or all numbers of a list or matrix."""
    return value.array if value.axis else value.array.reshape(-1)


def _spread(array: Array) -> Array:
    return np.full(array.shape[1:], np.nan) if len(array) < 2 else np.asarray(np.var(array, axis=0, ddof=1))


def _quantile(array: Array, q: float) -> Array:
    return np.where(np.isnan(array).any(axis=0), np.nan, quantile(array, q))


_REDUCTIONS: dict[str, Callable[[Array], Array]] = {
    "mean": lambda array: np.mean(array, axis=0),
    "median": lambda array: _quantile(array, 0.5),
    "min": lambda array: np.min(array, axis=0),
    "max": lambda array: np.max(array, axis=0),
    "var": _spread,
    "std": lambda array: np.sqrt(_spread(array)),
}


def _ratio(a: Value, b: Value) -> Value:
    if not (a.axis == b.axis == "runs"):
        return combine(divided, a, b)
    if not ((a.array > 0) & (b.array > 0) & np.isfinite(a.array) & np.isfinite(b.array)).all():
        raise NoValue("ratio of two columns needs positive, finite values in every run")
    return Value(np.asarray(np.exp(np.mean(np.log(a.array) - np.log(b.array), axis=0))))


def _entry(x: Value, i: Value) -> Value:
    """Take an entry of a vector, or a row of a matrix."""
    if not x.entry or i.array.ndim or not 0 <= i.array < x.entry[0] or i.array != int(i.array):
        raise EvaluationError("entry needs a vector or a matrix, or a series of them, and a place that counts from 0")
    return x.of(x.array.take(int(i.array), axis=x.array.ndim - len(x.entry)))


_OF_SEVERAL: dict[str, Callable[..., Value]] = {
    "ratio": _ratio,
    "entry": _entry,
    "excess": excess,
    "distance": distance,
}


def _of_series(name: str, values: list[Value]) -> Value:
    """Evaluate at, last, slope, since or upto."""
    series = values[0]
    if series.axis != "k":
        raise EvaluationError(f"{name} needs a series over k")
    if name == "last":
        return Value(series.array[-1])
    if name == "slope":
        steps = np.arange(len(series.array)) - (len(series.array) - 1) / 2
        if len(steps) < 2:
            raise NoSample("slope needs two samples")
        return Value(np.asarray(np.tensordot(steps, series.array, axes=1) / (steps @ steps)))
    if series.constant:
        return Value(series.array[0]) if name == "at" else series
    first, last = series.span
    k = values[1].array
    if k.ndim or not first <= k <= last or k != int(k):
        raise NoSample(f"{name} needs a sample from {first} to {last}")
    if name == "at":
        return Value(series.array[int(k) - first])
    cut = (int(k), last) if name == "since" else (first, int(k))
    # A whole series is returned as it is: one that does not change over k is stored once, and fits any other.
    return series if cut == series.span else Value(series.array[cut[0] - first : cut[1] - first + 1], "k", cut)
