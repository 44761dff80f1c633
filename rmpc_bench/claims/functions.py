"""The functions of claims, applied to values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rmpc_bench.analysis.intervals import quantile
from rmpc_bench.claims.matrices import distance, excess, of_matrix
from rmpc_bench.claims.values import EvaluationError, NoSample, NoValue, Value, combine, divided
from rmpc_bench.types import Array


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
