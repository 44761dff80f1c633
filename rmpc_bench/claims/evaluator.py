"""Values of the expressions of a claim, from the tables of trials, one per point of a sweep."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from copy import copy
from functools import cached_property

import numpy as np

from rmpc_bench.analysis.intervals import difference
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims import grammar
from rmpc_bench.claims.values import (
    EvaluationError,
    NoValue,
    Value,
    aligned,
    applied,
    combine,
    compare,
    divided,
    listed,
    negative,
    of_matrix,
)
from rmpc_bench.expressions.arithmetic import Call, Negation, Node, Number, Operation, Percent
from rmpc_bench.types import Array
from rmpc_bench.types.sweep_points import lies_at

__all__ = ["EvaluationError", "Evaluator", "Value", "compare"]


def tables_of(trials: Trials, term: grammar.Term, at: Mapping[str, str], *, pooled: bool) -> list[Trials]:
    """Points of a sweep that a term is about: one, or all that it leaves open where they are pooled."""
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


_NOWHERE: Mapping[str, str] = {}
_OPERATORS: Mapping[str, Callable[..., Array]] = {"+": np.add, "-": difference, "*": np.multiply, "/": divided}


class Evaluator:
    """Evaluates expressions on the runs that every column named in them finished.

    `node` is the tree that is about to be evaluated, or the part of it that is one statement, `at` the point of a sweep
    for terms that name none.  In a `pooled` one a term may be about several points, whose runs are taken together.
    """

    def __init__(self, trials: Trials, node: Node, at: Mapping[str, str] = _NOWHERE, *, pooled: bool = False) -> None:
        self.trials, self.pooled = trials, pooled
        self.fixed: dict[Node, Value] = {}
        self._left_out: int | None = None
        self._by_groups = False
        metrics = {info.name for info in trials.metrics}
        self.tables = {term: tables_of(trials, term, at, pooled=pooled) for term in sorted(grammar.terms(node))}
        self.columns = {
            term: np.concatenate([table.column(term.quantity, term.method) for table in tables])
            for term, tables in self.tables.items()
            if term.quantity in metrics
        }
        if len({len(column) for column in self.columns.values()}) > 1:
            raise EvaluationError("the terms are about different numbers of runs")
        missing = [np.isnan(column) for column in self.columns.values()]
        self.shared: Array = ~np.any(missing, axis=0) if missing else np.zeros(0, dtype=bool)
        self.n = int(self.shared.sum())
        tables = self.tables[next(iter(self.columns))] if self.columns else []
        self.run: Array = np.concatenate([table.runs for table in tables]) if tables else np.zeros(0, dtype=np.int64)
        self.n_excluded = len(self.shared) - self.n
        if missing and not self.n:
            raise NoValue("no run was finished by every method that is compared")
        self.sampled = self._moments_from_runs(node)
        if self.sampled and not self.columns:
            self.n = min(self.tables[term][0].n_of(quantity, term.method) for term, quantity in self.sampled)

    def resampled(self, rng: np.random.Generator, most: int, together: int = 0) -> Evaluator:
        """Return an evaluator on as many runs, at most `most`, drawn from the shared ones with replacement.

        In a pooled claim a run is drawn with all its points, which have the same draws.  With `together` a column has
        so many resamples side by side, (runs, resamples), which not every function can take.
        """
        other = copy(self)
        if together:
            other.shared = rng.choice(self._shared_rows, (together, min(self.n, most))).T
            return other
        if self.pooled:
            groups = self._points_of_runs
            other.shared = np.concatenate([groups[i] for i in rng.choice(len(groups), min(len(groups), most))])
        else:
            other.shared = rng.choice(self._shared_rows, min(self.n, most))
        return other

    @cached_property
    def _shared_rows(self) -> Array:
        """Positions of the shared runs in the columns."""
        return np.flatnonzero(self.shared)

    def with_values(self, values: Mapping[Node, Value]) -> Evaluator:
        """Return an evaluator in which some expressions have given values."""
        other = copy(self)
        other.fixed = {**self.fixed, **values}
        return other

    def is_estimated(self, node: Node) -> bool:
        """Whether a value depends on runs that are random; ``n_failed`` by itself counts the runs at hand."""
        return bool(self.sampled) or any(
            table.is_random for term in grammar.terms(node) & self.columns.keys() for table in self.tables[term]
        )

    def _moments_from_runs(self, node: Node) -> set[tuple[grammar.Term, str]]:
        """Collect the signals whose moments are not exact, each with the series of the moment."""
        found = {
            (term, f"{grammar.MOMENTS[function]}({term.quantity})")
            for term, function in grammar.uses(node)
            if function in grammar.MOMENTS and self.is_signal(term)
        }
        return {(term, quantity) for term, quantity in found if self.tables[term][0].n_of(quantity, term.method)}

    @property
    def groups(self) -> list[Array] | None:
        """Runs of every group that can be left out of the moments; None where there are none."""
        found = [self.tables[term][0].run_groups(quantity, term.method) for term, quantity in sorted(self.sampled)]
        runs = [each.runs for each in found if each is not None]
        if not runs or len(runs) < len(found):
            return None
        first, *others = runs
        same = all(len(first) == len(other) and all(map(np.array_equal, first, other)) for other in others)
        return list(first) if same else None

    def without(self, number: int | None, runs: Collection[int]) -> Evaluator:
        """Return an evaluator without a group of runs; its moments are those of the other groups."""
        other = copy(self)
        other._left_out, other._by_groups = number, True
        other.shared = self.shared & ~np.isin(self.run, list(runs)) if len(self.shared) else self.shared
        from_runs = {term for term, _ in self.sampled}
        other.fixed = {node: value for node, value in self.fixed.items() if grammar.terms(node).isdisjoint(from_runs)}
        return other

    @cached_property
    def _points_of_runs(self) -> list[Array]:
        """For every shared run its positions in the columns: one per point."""
        rows = np.flatnonzero(self.shared)
        return [rows[self.run[rows] == run] for run in self.runs]

    @property
    def runs(self) -> Array:
        """Indices of the shared runs, each once."""
        found = self.run[self.shared]
        # The runs of one table are ascending.
        return found if self.shared.dtype == bool and not self.pooled else np.unique(found)

    def by_run(self, column: Array) -> Array | None:
        """Average of every run over its points in a pooled claim; None where runs have different numbers of them."""
        if not self.pooled:
            return column
        run = self.run[self.shared]
        counts = np.unique(run, return_counts=True)[1]
        if counts.min() < counts.max():
            return None
        return np.asarray(column[np.argsort(run, kind="stable")].reshape(len(counts), -1).mean(axis=1))

    def column(self, term: grammar.Term) -> Array | None:
        """Values of a metric over the shared runs; None when the term is not a metric."""
        column = self.columns.get(term)
        return None if column is None else column[self.shared]

    def value(self, node: Node) -> Value:
        """Evaluate an expression; raises EvaluationError where it has no value."""
        if node in self.fixed:
            return self.fixed[node]
        found = self._value(node)
        if not grammar.terms(node) & self.columns.keys():
            # It uses no run, hence it is the same when the runs are drawn again.
            self.fixed[node] = found
        return found

    def _value(self, node: Node) -> Value:
        match node:
            case Number():
                return Value(np.array(node.value))
            case grammar.Term():
                return self._term(node)
            case grammar.Listing():
                return listed([self.value(item) for item in node.items])
            case Negation():
                return negative(self.value(node.operand))
            case Percent():
                return combine(np.divide, self.value(node.operand), Value(np.array(100.0)))
            case Operation():
                return self._operation(node)
            case Call():
                return self._call(node)
        raise TypeError(f"{type(node).__name__} has no value in a claim")

    def number(self, node: Node) -> float:
        """Evaluate an expression that must be one number, possibly inf."""
        value = self.value(node)
        if value.array.ndim:
            raise EvaluationError("the expression is not one number")
        if math.isnan(value.array):
            raise NoValue("the expression is not one number")
        return float(value.array)

    def sides(self, link: grammar.Link) -> tuple[Value, Array, Array]:
        """Evaluate both sides of a comparison and its tolerance: of one shape, NaN-free, with the axis of the left."""
        left, right, tolerance = self.value(link.left), self.value(link.right), Value(np.array(0.0))
        if link.tolerance is not None:
            tolerance = self.value(link.tolerance)
            if (tolerance.array < 0).any():
                kind = NoValue if grammar.terms(link.tolerance) else EvaluationError
                raise kind(f"the tolerance of {link.text} is negative")
        if link.relative:
            tolerance = combine(np.multiply, tolerance, right.of(np.abs(right.array)))
        parts = aligned(left, right, tolerance)
        arrays = np.broadcast_arrays(*(part.array for part in parts))
        if any(np.isnan(array).any() for array in arrays):
            raise NoValue(f"a side of {link.text} is not a number")
        return parts[0].of(arrays[0]), arrays[1], arrays[2]

    def side_arrays(self, link: grammar.Link) -> tuple[Array, Array, Array]:
        """The numbers of both sides and of the tolerance; see `sides`."""
        left, right, tolerance = self.sides(link)
        return left.array, right, tolerance

    def holds(self, links: tuple[grammar.Link, ...]) -> Value:
        """Whether all comparisons of a chain hold, entry by entry over runs or over k; matrices as a whole."""
        found: Value | None = None
        for link in links:
            left, right, tolerance = self.sides(link)
            if not left.axis:
                raise EvaluationError(f"{link.text} compares numbers; share needs columns over runs or series over k")
            entries = compare(link.operator, left.array, right, tolerance)
            # Resamples stand side by side; entries of a run or sample count together.
            side_by_side = left.axis == "runs" and self.shared.ndim > 1
            value = left.of(entries if side_by_side else entries.reshape(len(entries), -1).all(axis=1))
            found = value if found is None else combine(np.logical_and, found, value)
        # The grammar has no empty chain.
        assert found is not None
        return found

    def _term(self, term: grammar.Term, function: str = "") -> Value:
        """Evaluate a term that is an argument of `function` by itself."""
        column, signal = self.column(term), self.is_signal(term)
        reason = grammar.misuse(term, function, signal=signal)
        if reason:
            raise EvaluationError(reason)
        if term.quantity in grammar.COUNTS:
            return Value(np.array(float(sum(table.n_failed(term.method) for table in self.tables[term]))))
        if column is not None:
            return Value(column, "runs")
        if signal:
            return self._moment(term, function)
        absent = f"{term.quantity}[{term.method}] is neither a metric nor a stored series"
        return self._series(term, term.quantity, absent)

    def is_signal(self, term: grammar.Term) -> bool:
        """Whether a term is a signal, of which moments over the runs exist only."""
        return term.quantity in grammar.SIGNALS and term not in self.columns

    def _moment(self, term: grammar.Term, function: str) -> Value:
        """Evaluate mean, var, std or cov of a signal over the runs, at every k."""
        quantity = f"{grammar.MOMENTS[function]}({term.quantity})"
        found = self._series(term, quantity, grammar.unknown_moment(term, function))
        if function in ("mean", "cov"):
            return found
        variance = of_matrix("diag", found)
        # Rounding may leave the variance of what does not vary below 0.
        return variance if function == "var" else variance.of(np.sqrt(np.maximum(variance.array, 0.0)))

    def _series(self, term: grammar.Term, quantity: str, absent: str) -> Value:
        """Read a series of the method and point of a term; `absent` is the reason where there is none."""
        tables = self.tables[term]
        if len({table.keys.get(term.method, "") for table in tables}) > 1:
            what = f"{term.quantity}[{term.method}]"
            raise EvaluationError(f"{what} is a series, of one of {len(tables)} points: name one")
        by_groups = self._by_groups and (term, quantity) in self.sampled
        groups = tables[0].run_groups(quantity, term.method) if by_groups else None
        if groups is not None:
            return Value(groups.series(quantity, self._left_out), "k")
        try:
            return Value(tables[0].matrix_series(quantity, term.method), "k")
        except KeyError:
            raise EvaluationError(absent) from None

    def _operation(self, node: Operation) -> Value:
        found = self.value(node.first)
        for operand in node.rest:
            value = self.value(operand.node)
            if operand.operator == "/" and not grammar.terms(operand.node) and not value.array.all():
                raise EvaluationError("division by 0")
            found = combine(_OPERATORS[operand.operator], found, value)
        return found

    def _call(self, node: Call) -> Value:
        name, first = node.function, node.arguments[0]
        if isinstance(first, grammar.Chain):
            return Value(np.mean(self.holds(first.links).array, axis=0))
        if isinstance(first, grammar.Term) and (name == "cov" or (name in grammar.MOMENTS and self.is_signal(first))):
            return self._term(first, name)
        if name == "cov":
            raise EvaluationError("cov needs a signal by itself, as cov(e[METHOD])")
        return applied(name, [self.value(part) for part in node.arguments])
