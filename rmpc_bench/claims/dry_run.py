"""Dry run of a claim on placeholder data before any run: finds what no results could answer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rmpc_bench.claims import tree
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.values import EvaluationError, NoSample, NoValue
from rmpc_bench.expressions.arithmetic import Node
from rmpc_bench.types import Array, MetricInfo

_RUNS = 2
_PLACES = ("at", "since", "upto", "entry", "quantile")
"""Functions whose second argument must lie in a range."""


@dataclass(frozen=True)
class Expected:
    """What stands in for the table of trials.

    Parameters
    ----------
    methods : names
    metrics : one record per column
    shapes : method -> series -> shape of the array, axis 0 = k; without the methods of which it is not known
    point, keys : as those of `Trials`
    points : the tables of a sweep's points; empty for one of them
    """

    methods: Sequence[str]
    metrics: Sequence[MetricInfo]
    shapes: Mapping[str, Mapping[str, tuple[int, ...]]]
    point: Mapping[str, str]
    keys: Mapping[str, str]
    points: tuple[Expected, ...] = ()
    confidence: float = 0.95
    seed: int = 0

    @property
    def each(self) -> Sequence[Expected]:
        """The tables of all points."""
        return self.points or (self,)

    @property
    def runs(self) -> Array:
        """Indices of the runs."""
        return np.arange(_RUNS)

    def column(self, metric: str, method: str, /) -> Array:
        """Ones, whatever they are asked of."""
        return np.ones(_RUNS)

    def n_failed(self, method: str, /) -> int:
        """One, which may be divided by."""
        return 1

    def matrix_series(self, quantity: str, method: str, /) -> Array:
        """Views of ones, and of the identity where entries are square; KeyError where there is no such series."""
        if method not in self.shapes:
            raise NoValue(f"the series of {method} are not known")
        shape = self.shapes[method][quantity]
        if 0 in shape:
            raise KeyError(quantity)
        square = len(shape) == 3 and shape[1] == shape[2]
        return np.broadcast_to(np.eye(shape[1]) if square else np.ones(shape[1:]), shape)


def dry_run(node: Node, expected: Expected, at: Mapping[str, str], *, pooled: bool, short: bool) -> list[str]:
    """Evaluate a check, or the expression of a size, with the right shapes in place of results.

    Parameters
    ----------
    node : the tree
    expected : the shapes
    at, pooled : as of `Evaluator`
    short : whether the series are shorter than what the claim was written for

    Returns
    -------
    why it has no value, whatever the numbers will be; empty where nothing is wrong with it
    """
    statements: Sequence[Node] = (node,)
    if isinstance(node, tree.Chain) and not node.everywhere:
        statements = node.links
    found = []
    for statement in statements:
        if any(call.function in _PLACES and tree.terms(call.arguments[1]) for call in tree.calls(statement)):
            continue  # a place that depends on results
        try:
            _evaluate(statement, Evaluator(expected, statement, at, pooled=pooled))
        except NoValue:
            continue
        except EvaluationError as error:
            if not (short and isinstance(error, NoSample)):
                found.append(f"{getattr(statement, 'text', 'the size')}: {error}")
    return found


def _evaluate(statement: Node, evaluator: Evaluator) -> None:
    if isinstance(statement, tree.Chain):
        for link in statement.links:
            evaluator.sides(link)
    elif isinstance(statement, tree.Link):
        evaluator.sides(statement)
    else:
        evaluator.number(statement)
