"""Checks of metrics: one number per run that does not depend on the other runs."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, ClassVar, get_args

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.results import FROZEN, Check, copies, require, require_same, require_unchanged
from rmpc_bench.types import Array, Direction, Metric, Record

PER_RUN = ("x", "y", "x_hat", "u")
"""Arrays of a record whose axis 0 is the run, whatever the method reports."""


@dataclass(frozen=True, eq=False)
class MetricExample:
    """Trajectories that a metric is checked with.

    Parameters
    ----------
    record : trajectories of at least four runs and three samples, with everything that the metric needs
    delta : for a metric of an extra signal: what the plant has drawn for the runs of the given indices
    """

    record: Record
    delta: Callable[[Sequence[int]], Any] | None = None
    checks: ClassVar[tuple[Check, ...]]

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.record.x)

    def values(self, metric: Metric) -> Float[Array, " runs"]:
        """Evaluate a metric on a copy of the trajectories."""
        return metric.evaluate(self.some(range(self.n_runs)))

    def some(self, rows: Sequence[int]) -> Record:
        """Trajectories of some runs, in memory of their own."""
        record, rows = self.record, list(rows)
        changed: dict[str, Any] = {name: getattr(record, name)[rows] for name in PER_RUN}
        for name in ("P", "M"):
            matrix = getattr(record, name)
            changed[name] = matrix[rows] if matrix is not None and matrix.ndim == 4 else copy(matrix)
        changed["r"] = record.r.copy()
        changed["info"] = {name: values[rows] for name, values in record.info.items()}
        changed["bursts"] = None if record.bursts is None else record.bursts[rows]
        if self.delta is not None:
            changed["delta"] = self.delta(rows)
        return record._replace(**changed)

    def broken(self, run: int, value: float) -> Record:
        """The same trajectories, those of one run replaced by a number from sample 2 on."""
        record = self.some(range(self.n_runs))
        arrays = [getattr(record, name) for name in PER_RUN]
        arrays += [matrix for matrix in (record.P, record.M) if matrix is not None and matrix.ndim == 4]
        for array in [*arrays, *record.info.values()]:
            array[run, 2:] = value
        return record


def _arrays(record: Record) -> list[Array]:
    given = [getattr(record, name) for name in (*PER_RUN, "r", "P", "M", "bursts")]
    return [array for array in (*given, *record.info.values()) if array is not None]


def _base_class(metric: Any, _: MetricExample) -> None:
    require(isinstance(metric, Metric), f"{type(metric).__name__} is not a subclass of Metric")


def _facts(metric: Metric, example: MetricExample) -> None:
    info = metric.info(example.record.layout)
    known = get_args(Direction)
    require(info.direction in known, f"{info.direction!r} is no direction (known: {', '.join(known)})")
    require(info.name.isidentifier(), f"{info.name!r} is no name: letters, digits and _")
    issues = list(metric.check(example.record.layout))
    require(not issues, "check refuses the example: " + "; ".join(issue.message for issue in issues))


def _shapes(metric: Metric, example: MetricExample) -> None:
    values = example.values(metric)
    require(values.shape == (example.n_runs,), f"the values have shape {values.shape} for {example.n_runs} runs")
    require(values.dtype == np.float64, f"the values are {values.dtype}, not float64")
    require(not np.isnan(values).any(), "a value is NaN; the value of an event that does not occur is inf")
    occurs = not metric.may_not_occur
    require(not (occurs and np.isinf(values).any()), "a value is inf, but `may_not_occur` is False")
    low, high = metric.bounds
    require(bool(((values >= low) & (values <= high)).all()), f"a value lies outside the bounds {low:g} and {high:g}")


def _arguments(metric: Metric, example: MetricExample) -> None:
    record = example.some(range(example.n_runs))
    arrays = _arrays(record)
    before = copies(arrays)
    first = metric.evaluate(record).copy()
    require_unchanged(arrays, before)
    require_same("the second evaluation", metric.evaluate(record), first)
    require_same("the copy's evaluation", example.values(pickle.loads(pickle.dumps(metric))), first)


def _alone(metric: Metric, example: MetricExample) -> None:
    together = example.values(metric)
    for run in range(example.n_runs):
        require_same(f"the value of run {run} alone", metric.evaluate(example.some([run])), together[run : run + 1])


def _order(metric: Metric, example: MetricExample) -> None:
    order = np.random.default_rng(5).permutation(example.n_runs).tolist()
    require_same("the values in another order", metric.evaluate(example.some(order)), example.values(metric)[order])


def _diverged(metric: Metric, example: MetricExample) -> None:
    run, expected = 1, np.delete(example.values(metric), 1)
    for value in (np.nan, np.inf, 1e300):
        with np.errstate(all="ignore"):  # the values of a diverged run are not used
            found = metric.evaluate(example.broken(run, value))
        require_same(f"the values beside a run of {value}", np.delete(found, run), expected)


MetricExample.checks = (
    Check("base-class", "the metric is a subclass of Metric", _base_class, is_first=True),
    FROZEN,
    Check("facts", "the metric has a direction and a name for claims; check accepts what can be computed", _facts),
    Check("shapes", "there is one number per run, within the bounds; inf only where the event may not occur", _shapes),
    Check("arguments", "evaluate is pure and leaves the record unchanged; a copy made by pickle agrees", _arguments),
    Check("batch-independence", "a run has the same bits alone and inside any block", _alone),
    Check("order", "permuting the runs permutes the values, bit for bit", _order),
    Check("diverged-run", "a run that diverges changes no other run's value", _diverged),
)
