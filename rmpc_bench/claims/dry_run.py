"""Dry run of a claim on placeholder results before the experiment: finds checks that no results can evaluate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rmpc_bench.claims import grammar
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.values import EvaluationError, NoSample, NoValue
from rmpc_bench.expressions.arithmetic import Node
from rmpc_bench.types import Array, MetricInfo, ResultLayout

_N_RUNS = 2
_PLACES = ("at", "since", "upto", "entry", "quantile")
"""Functions whose second argument must lie in a range."""


@dataclass(frozen=True)
class PlaceholderResults:
    """Ones and identity matrices in the layout of the results; an evaluator reads them as it reads `Trials`."""

    layout: ResultLayout  # names and shapes that the results will have
    known: frozenset[str]  # methods whose series have the shapes of the layout at this point
    point: Mapping[str, str]  # point, keys: as those of `Trials`
    keys: Mapping[str, str]
    points: tuple[PlaceholderResults, ...] = ()  # the placeholder results of a sweep's points; empty for one of them
    confidence: float = 0.95
    seed: int = 0
    is_random: bool = True

    @property
    def methods(self) -> Sequence[str]:
        """Names of the methods."""
        return tuple(self.keys)

    @property
    def metrics(self) -> Sequence[MetricInfo]:
        """One record per column."""
        return [MetricInfo(name, "", "") for name in self.layout.metrics]

    @property
    def each(self) -> Sequence[PlaceholderResults]:
        """The placeholder results of all points."""
        return self.points or (self,)

    @property
    def runs(self) -> Array:
        """Indices of the runs."""
        return np.arange(_N_RUNS)

    def column(self, metric: str, method: str, /) -> Array:
        """Ones for every metric and method."""
        return np.ones(_N_RUNS)

    def relevant_of(self, metric: str, *, default: float | None = None) -> float:
        """No margin: placeholders are not compared."""
        return 0.0

    def n_failed(self, method: str, /) -> int:
        """One, since a claim may divide by it."""
        return 1

    def n_of(self, quantity: str, method: str, /) -> int:
        """Count the runs from which a series is computed: none, as it is a placeholder."""
        return 0

    def run_groups(self, quantity: str, method: str, /) -> None:
        """Return no groups of runs."""

    def matrix_series(self, quantity: str, method: str, /) -> Array:
        """Views of ones, and of the identity where entries are square; KeyError where there is no such series."""
        if method not in self.known or method not in self.layout.arrays:
            raise NoValue(f"the series of {method} are not known")
        shape = self.layout.arrays[method][quantity]
        if 0 in shape:
            raise KeyError(quantity)
        square = len(shape) == 3 and shape[1] == shape[2]
        return np.broadcast_to(np.eye(shape[1]) if square else np.ones(shape[1:]), shape)


def placeholder_results(layout: ResultLayout) -> PlaceholderResults:
    """Make placeholder results for all points of a sweep.

    The series are those of the first point, known at another one of the methods that are the same there.
    """
    first = layout.trials[0]
    tables = [
        PlaceholderResults(
            layout=layout,
            known=frozenset(name for name, key in keys.items() if key == first.get(name)),
            point=coordinates,
            keys=keys,
        )
        for coordinates, keys in zip(layout.points, layout.trials, strict=True)
    ]
    return replace(tables[0], points=tuple(tables))


def dry_run(node: Node, results: PlaceholderResults, at: Mapping[str, str], *, pooled: bool, short: bool) -> list[str]:
    """Say why a check, or the expression of a size, has no value on placeholder results; empty where it has one.

    Series may be `short`er than what the claim was written for.
    """
    statements: Sequence[Node] = (node,)
    if isinstance(node, grammar.Chain) and not node.everywhere:
        statements = node.links
    found = []
    for statement in statements:
        if any(call.function in _PLACES and grammar.terms(call.arguments[1]) for call in grammar.calls(statement)):
            # The place depends on results.
            continue
        try:
            _evaluate(statement, Evaluator(results, statement, at, pooled=pooled))
        except NoValue:
            continue
        except EvaluationError as error:
            if not (short and isinstance(error, NoSample)):
                found.append(f"{getattr(statement, 'text', 'the size')}: {error}")
    return found


def _evaluate(statement: Node, evaluator: Evaluator) -> None:
    if isinstance(statement, grammar.Chain):
        for link in statement.links:
            evaluator.sides(link)
    elif isinstance(statement, grammar.Link):
        evaluator.sides(statement)
    else:
        evaluator.number(statement)
