"""Dry run of a claim on placeholder results before the experiment: finds checks that no results can evaluate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rmpc_bench.analysis.columns import Series
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims import grammar
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.values import EvaluationError, NoSample, NoValue
from rmpc_bench.expressions.arithmetic import Node
from rmpc_bench.types import Array, MetricInfo, ResultLayout, Status

_N_RUNS = 2
_PLACES = ("at", "since", "upto", "entry", "quantile")
"""Functions whose second argument must lie in a range."""


@dataclass(frozen=True, eq=False, repr=False)
class PlaceholderResults(Trials):
    """Ones and identity matrices in the layout of the results."""

    known: frozenset[str] = frozenset()  # methods whose series are known at this point

    def n_failed(self, method: str) -> int:
        """One, since a claim may divide by it."""
        return 1

    def matrix_series(self, quantity: str, method: str) -> Array:
        """Return a series; a NoValue says that those of the method are not known."""
        if method not in self.known:
            raise NoValue(f"the series of {method} are not known")
        return super().matrix_series(quantity, method)


def placeholder_results(layout: ResultLayout) -> PlaceholderResults:
    """Make placeholder results for all points of a sweep.

    The series are those of the first point, known at another one of the methods that are the same there.
    """
    first = layout.trials[0]
    tables = []
    for point, keys in zip(layout.points, layout.trials, strict=True):
        methods, known = tuple(keys), [name for name in layout.arrays if keys.get(name, "") == first.get(name)]
        columns = {"method": np.repeat(np.array(methods, dtype=object), _N_RUNS)}
        columns |= {"run": np.tile(np.arange(_N_RUNS), len(methods))}
        columns |= {"status": np.full(len(columns["run"]), Status.OK.word, dtype=object)}
        tables.append(
            PlaceholderResults(
                name="",
                methods=methods,
                labels={},
                metrics=tuple(MetricInfo(name, "", "") for name in layout.metrics),
                columns=columns | {name: np.ones(len(columns["run"])) for name in layout.metrics},
                over_time=[
                    Series(method, quantity, _ones(shape))
                    for method in known
                    for quantity, shape in layout.arrays[method].items()
                    if 0 not in shape
                ],
                baseline="",
                confidence=0.95,
                relevant=0.0,
                seed=0,
                point=point,
                keys=keys,
                known=frozenset(known),
            )
        )
    return replace(tables[0], points=tuple(tables))


def _ones(shape: tuple[int, ...]) -> Array:
    """Views of ones, and of the identity where entries are square."""
    square = len(shape) == 3 and shape[1] == shape[2]
    return np.broadcast_to(np.eye(shape[1]) if square else np.ones(shape[1:]), shape)


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
            evaluator = Evaluator(results, statement, at, pooled=pooled)
            for part in statement.links if isinstance(statement, grammar.Chain) else (statement,):
                if isinstance(part, grammar.Link):
                    evaluator.sides(part)
                else:
                    evaluator.number(part)
        except NoValue:
            continue
        except EvaluationError as error:
            if not (short and isinstance(error, NoSample)):
                found.append(f"{getattr(statement, 'text', 'the size')}: {error}")
    return found
