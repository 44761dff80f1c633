"""Where the terms of a claim are read: the tables of trials, one per point of a sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from rmpc_bench.analysis.run_groups import RunGroups
from rmpc_bench.claims import tree
from rmpc_bench.claims.values import EvaluationError
from rmpc_bench.types import Array, MetricInfo
from rmpc_bench.types.sweep_points import lies_at


class Table(Protocol):
    """What an evaluator reads of `Trials`, or of the placeholder results of a dry run, which do without pandas."""

    @property
    def methods(self) -> Sequence[str]:
        """Names of the methods."""
        ...

    @property
    def metrics(self) -> Sequence[MetricInfo]:
        """One record per column."""
        ...

    @property
    def point(self) -> Mapping[str, str]:
        """Path -> value of the point of a sweep."""
        ...

    @property
    def keys(self) -> Mapping[str, str]:
        """Method -> what identifies its trials."""
        ...

    @property
    def confidence(self) -> float:
        """Level of the intervals."""
        ...

    @property
    def seed(self) -> int:
        """Seed of the experiment."""
        ...

    @property
    def runs(self) -> Array:
        """Indices of the runs."""
        ...

    @property
    def each(self) -> Sequence[Table]:
        """The tables of all points."""
        ...

    @property
    def is_random(self) -> bool:
        """Whether runs differ by chance."""
        ...

    def column(self, metric: str, method: str, /) -> Array:
        """Values of a metric over the runs, NaN where a run failed."""
        ...

    def relevant_of(self, metric: str, *, default: float | None = None) -> float:
        """Return the smallest difference of a metric that matters."""
        ...

    def n_failed(self, method: str, /) -> int:
        """Count the failed runs."""
        ...

    def matrix_series(self, quantity: str, method: str, /) -> Array:
        """Return a series, axis 0 = k."""
        ...

    def n_of(self, quantity: str, method: str, /) -> int:
        """Count the runs from which a series is computed; 0 where it is exact."""
        ...

    def run_groups(self, quantity: str, method: str, /) -> RunGroups | None:
        """Return groups of runs that can be left out of a moment."""
        ...


def tables_of(trials: Table, term: tree.Term, at: Mapping[str, str], *, pooled: bool) -> list[Table]:
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
