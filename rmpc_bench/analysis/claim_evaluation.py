"""Values of the expressions of a claim, from the table of trials."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rmpc_bench.analysis import claim_tree as tree
from rmpc_bench.analysis.intervals import difference, geometric, quantile
from rmpc_bench.analysis.points import lies_at
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import Array


class EvaluationError(Exception):
    """A claim that the stored results cannot answer; the message is the reason a reader sees."""


_NOWHERE: Mapping[str, str] = {}


@dataclass(frozen=True)
class Value:
    """An array whose axis 0 is ``runs`` or ``k``, or has no such axis (a number or a matrix)."""

    array: Array
    axis: str = ""

    @property
    def entry(self) -> tuple[int, ...]:
        """Shape of what stands at one run or one k."""
        return tuple(self.array.shape[1:] if self.axis else self.array.shape)


class Evaluator:
    """Evaluates expressions on the runs that every column named in them finished.

    Parameters
    ----------
    trials : the table of trials
    node : the tree that is about to be evaluated, or the part of it that is one statement
    at : point of a sweep for terms that name none
    pooled : whether a term may speak of several points, whose runs are then taken together

    Raises
    ------
    EvaluationError
        when a method or point is unknown or no run is left
    """

    def __init__(self, trials: Trials, node: object, at: Mapping[str, str] = _NOWHERE, *, pooled: bool = False) -> None:
        self.trials, self.pooled = trials, pooled
        metrics = {info.name for info in trials.metrics}
        self.tables = {term: _tables(trials, term, at, pooled=pooled) for term in sorted(tree.terms(node))}
        self.columns = {
            term: np.concatenate([table.column(term.quantity, term.method) for table in tables])
            for term, tables in self.tables.items()
            if term.quantity in metrics
        }
        if len({len(column) for column in self.columns.values()}) > 1:
            raise EvaluationError("the terms speak of different numbers of runs")
        missing = [np.isnan(column) for column in self.columns.values()]
        self.shared: Array = ~np.any(missing, axis=0) if missing else np.zeros(0, dtype=bool)
        self.n = int(self.shared.sum())
        tables = self.tables[next(iter(self.columns))] if self.columns else []
        self.run: Array = np.concatenate([table.runs for table in tables]) if tables else np.zeros(0, dtype=np.int64)
        self.left_out = len(self.shared) - self.n
        if missing and not self.n:
            raise EvaluationError("no run was finished by every method that is compared")

    def resampled(self, rng: np.random.Generator) -> Evaluator:
        """Return an evaluator on as many runs, drawn from the shared ones with replacement.

        In a pooled claim a run is drawn with all its points, which have the same draws.
        """
        other = copy(self)
        if self.pooled:
            groups = self._points_of_runs
            other.shared = np.concatenate([groups[i] for i in rng.choice(len(groups), len(groups))])
        else:
            other.shared = rng.choice(np.flatnonzero(self.shared), self.n)
        return other

    @cached_property
    def _points_of_runs(self) -> list[Array]:
        """For every shared run where it stands in the columns: once at every point."""
        rows = np.flatnonzero(self.shared)
        return [rows[self.run[rows] == run] for run in self.runs]

    @property
    def runs(self) -> Array:
        """Indices of the shared runs, each once."""
        return np.unique(self.run[self.shared])

    def column(self, term: tree.Term) -> Array | None:
        """Values of a metric over the shared runs; None when the term is not a metric."""
        column = self.columns.get(term)
        return None if column is None else column[self.shared]

    def value(self, node: tree.Expression) -> Value:
        """Evaluate an expression; raises EvaluationError where it has no value."""
        if isinstance(node, tree.Number):
            return Value(np.array(node.value))
        if isinstance(node, tree.Term):
            return self._term(node)
        if isinstance(node, tree.Listing):
            items = [self.value(item) for item in node.items]
            if any(item.axis for item in items) or len({item.array.shape for item in items}) > 1:
                raise EvaluationError("the entries of a list must be numbers, not columns or series")
            return Value(np.array([item.array for item in items]))
        if isinstance(node, tree.Operation):
            return self._operation(node)
        return self._call(node)

    def number(self, node: tree.Expression) -> float:
        """Evaluate an expression that must be one number, possibly inf."""
        value = self.value(node)
        if value.array.ndim or math.isnan(value.array):
            raise EvaluationError("the expression is not one number")
        return float(value.array)

    def sides(self, link: tree.Link) -> tuple[Array, Array, Array, str]:
        """Evaluate both sides of a comparison.

        Returns
        -------
        left, right and tolerance of one shape, NaN-free, and the axis 0 of that shape
        """
        tolerance = self.value(link.tolerance) if link.tolerance is not None else Value(np.array(0.0))
        right = self.value(link.right)
        if link.relative:
            tolerance = _combine(np.multiply, tolerance, Value(np.abs(right.array), right.axis))
        left, right = _aligned(self.value(link.left), right)
        arrays = np.broadcast_arrays(left.array, right.array)
        both, tolerance = _aligned(Value(arrays[0], left.axis), tolerance)
        arrays = np.broadcast_arrays(*arrays, tolerance.array)
        if any(np.isnan(array).any() for array in arrays):
            raise EvaluationError(f"a side of {link.text} is not a number")
        return arrays[0], arrays[1], arrays[2], both.axis

    def holds(self, links: tuple[tree.Link, ...]) -> Value:
        """Whether all comparisons of a chain hold, entry by entry over runs or over k; matrices as a whole."""
        found: Value | None = None
        for link in links:
            left, right, tolerance, axis = self.sides(link)
            if not axis:
                raise EvaluationError(f"{link.text} compares numbers; share needs columns over runs or series over k")
            entries = compare(link.operator, left, right, tolerance)
            value = Value(np.asarray(entries.reshape(len(entries), -1).all(axis=1)), axis)
            found = value if found is None else _combine(np.logical_and, found, value)
        assert found is not None  # the grammar has no empty chain
        return found

    def _term(self, term: tree.Term) -> Value:
        if term.quantity in tree.COUNTS:
            return Value(np.array(float(sum(table.n_failed(term.method) for table in self.tables[term]))))
        column = self.column(term)
        if column is not None:
            return Value(column, "runs")
        try:
            return Value(self.tables[term][0].matrix_series(term.quantity, term.method), "k")
        except KeyError:
            message = f"{term.quantity}[{term.method}] is neither a metric nor a stored series"
            raise EvaluationError(message) from None

    def _operation(self, node: tree.Operation) -> Value:
        left, right = self.value(node.left), self.value(node.right)
        if node.operator == "-":
            return _combine(difference, left, right)
        function = {"+": np.add, "*": np.multiply, "/": np.divide}[node.operator]
        return _combine(function, left, right)

    @np.errstate(all="ignore")
    def _call(self, node: tree.Call) -> Value:
        name = node.function
        values = [self.value(part) for part in node.arguments if not isinstance(part, tree.Chain)]
        if name == "share":
            holds = [self.holds(part.links) for part in node.arguments if isinstance(part, tree.Chain)]
            return Value(np.mean(holds[0].array, axis=0))
        if name in _REDUCTIONS:
            array = values[0].array if values[0].axis else values[0].array.reshape(-1)
            return Value(np.asarray(_REDUCTIONS[name](array)))
        if name == "abs":
            return Value(np.abs(values[0].array), values[0].axis)
        if name in _MATRIX:
            return _of_matrix(name, values[0])
        if name == "ratio":
            return _ratio(*values)
        if name == "quantile":
            q = values[1].array
            if q.ndim or not 0 <= q <= 1:
                raise EvaluationError("the second argument of quantile is a number from 0 to 1")
            return Value(quantile(values[0].array if values[0].axis else values[0].array.reshape(-1), float(q)))
        return _of_series(name, values)


def _tables(trials: Trials, term: tree.Term, at: Mapping[str, str], *, pooled: bool) -> list[Trials]:
    """Points of a sweep that a term speaks of: one, or all that it leaves open where they are pooled."""
    wanted = {**at, **dict(term.point)}
    found = [table for table in trials.each if lies_at(table.point, wanted)]
    where = ", ".join(f"{path}={value}" for path, value in wanted.items())
    if not found:
        raise EvaluationError(f"there is no point {where}")
    found = [table for table in found if term.method in table.methods]
    if not found:
        raise EvaluationError(f"there is no method {term.method}")
    if pooled:
        return found
    if len({table.keys.get(term.method, "") for table in found}) > 1:
        raise EvaluationError(f"{term.quantity}[{term.method}] may be at any of {len(found)} points of the sweep")
    return found[:1]


def compare(operator: str, left: Array, right: Array, tolerance: Array) -> Array:
    """Compare entry by entry; ~ means equal up to the tolerance, and never equals never."""
    if operator == "~":
        gap = np.abs(difference(left, right))
        return np.asarray((gap == 0) | (np.isfinite(gap) & (gap <= tolerance)))
    functions = {
        "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal,
    }  # fmt: skip
    return np.asarray(functions[operator](left, right))


def _spread(array: Array) -> Array:
    return np.full(array.shape[1:], np.nan) if len(array) < 2 else np.asarray(np.var(array, axis=0, ddof=1))


_REDUCTIONS: dict[str, Callable[[Array], Array]] = {
    "mean": lambda array: np.mean(array, axis=0),
    "median": lambda array: quantile(array, 0.5),
    "min": lambda array: np.min(array, axis=0),
    "max": lambda array: np.max(array, axis=0),
    "var": _spread,
    "std": lambda array: np.sqrt(_spread(array)),
}
_MATRIX = ("diag", "trace", "det")


def _aligned(a: Value, b: Value) -> tuple[Value, Value]:
    """Give two values the same axis 0 and the same number of dimensions."""
    if a.axis and b.axis and a.axis != b.axis:
        raise EvaluationError("a column over runs and a series over k cannot be combined entry by entry")
    if a.entry != b.entry and a.entry and b.entry:
        raise EvaluationError(f"entries of shapes {a.entry} and {b.entry} cannot be combined")
    axis, depth = a.axis or b.axis, max(len(a.entry), len(b.entry))
    a, b = (_expanded(value, axis, depth) for value in (a, b))
    if axis and len(a.array) != len(b.array) and 1 not in (len(a.array), len(b.array)):
        raise EvaluationError(f"series of {len(a.array)} and {len(b.array)} samples cannot be combined")
    return a, b


def _expanded(value: Value, axis: str, depth: int) -> Value:
    array = value.array if value.axis or not axis else value.array[None]
    return Value(array.reshape(array.shape + (1,) * (depth - len(value.entry))), axis)


def _combine(function: Callable[[Array, Array], Array], a: Value, b: Value) -> Value:
    a, b = _aligned(a, b)
    with np.errstate(all="ignore"):
        return Value(np.asarray(function(a.array, b.array)), a.axis)


def _ratio(a: Value, b: Value) -> Value:
    if not (a.axis == b.axis == "runs"):
        return _combine(np.divide, a, b)
    if not ((a.array > 0) & (b.array > 0) & np.isfinite(a.array) & np.isfinite(b.array)).all():
        raise EvaluationError("ratio of two columns needs positive, finite values in every run")
    return Value(np.array(geometric(a.array, b.array, 0.95)[0]))


def _of_matrix(name: str, value: Value) -> Value:
    if not value.entry:
        return value
    if len(value.entry) != 2 or value.entry[0] != value.entry[1]:
        raise EvaluationError(f"{name} needs square matrices, got entries of shape {value.entry}")
    if name == "det":
        return Value(np.asarray(np.linalg.det(value.array)), value.axis)
    diagonal = np.diagonal(value.array, axis1=-2, axis2=-1)
    return Value(np.asarray(diagonal.sum(axis=-1)) if name == "trace" else diagonal, value.axis)


def _of_series(name: str, values: list[Value]) -> Value:
    """Evaluate at, last or slope."""
    series = values[0]
    if series.axis != "k":
        raise EvaluationError(f"{name} needs a series over k")
    if name == "last":
        return Value(series.array[-1])
    if name == "at":
        k = values[1].array
        if k.ndim or not 0 <= k < len(series.array) or k != int(k):
            raise EvaluationError(f"at needs a sample from 0 to {len(series.array) - 1}")
        return Value(series.array[int(k)])
    steps = np.arange(len(series.array)) - (len(series.array) - 1) / 2
    if len(steps) < 2:
        raise EvaluationError("slope needs two samples")
    return Value(np.asarray(np.tensordot(steps, series.array, axes=1) / (steps @ steps)))
