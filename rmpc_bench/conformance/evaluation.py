"""Checks of metrics and figures: they depend on trajectories and stored results alone; with an example of these."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, get_args

import numpy as np
from jaxtyping import Float

from rmpc_bench.analysis.columns import Series, data_frame, series_columns
from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.conformance.results import FROZEN, Check, base_class, copies, require, require_same, require_unchanged
from rmpc_bench.simulation.checked_calls import declared
from rmpc_bench.types import Array, Direction, Figure, Issue, Metric, MetricInfo, MetricLayout, Record, ResultLayout

if TYPE_CHECKING:
    from rmpc_bench.analysis.traces import Traces
    from rmpc_bench.analysis.trials import Trials


PER_RUN = ("x", "y", "x_hat", "u")
"""Arrays of a record whose axis 0 is the run, whatever the method reports."""


@dataclass(frozen=True, eq=False)
class MetricExample:
    """Trajectories that a metric is checked with."""

    record: Record  # trajectories of at least four runs and three samples, with everything that the metric needs
    # for a metric of an extra signal: what the plant has drawn for the runs of the given indices
    delta: Callable[[Sequence[int]], Any] | None = None
    checks: ClassVar[tuple[Check, ...]]

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.record.x)

    def values(self, metric: Metric) -> Float[Array, " runs"]:
        """Evaluate a metric on a copy of the trajectories."""
        return metric.evaluate(declared(self.some(range(self.n_runs)), metric))

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


def _facts(metric: Metric, example: MetricExample) -> None:
    info = metric.info(example.record.layout)
    known = get_args(Direction)
    require(info.direction in known, f"{info.direction!r} is no direction (known: {', '.join(known)})")
    require(info.name.isidentifier(), f"{info.name!r} is no name: letters, digits and _")
    issues = list(metric.check(example.record.layout))
    require(not issues, "check refuses the example: " + "; ".join(issue.message for issue in issues))


def _metric_shapes(metric: Metric, example: MetricExample) -> None:
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
    base_class(Metric, "metric"),
    FROZEN,
    Check("facts", "the metric has a direction and a name for claims; check accepts what can be computed", _facts),
    Check(
        "shapes",
        "there is one number per run, within the bounds; inf only where the event may not occur",
        _metric_shapes,
    ),
    Check("arguments", "evaluate is pure and leaves the record unchanged; a copy made by pickle agrees", _arguments),
    Check("batch-independence", "a run has the same bits alone and inside any block", _alone),
    Check("order", "permuting the runs permutes the values, bit for bit", _order),
    Check("diverged-run", "a run that diverges changes no other run's value", _diverged),
)


@dataclass(frozen=True, eq=False)
class FigureExample:
    """Results that a figure is checked with."""

    results: Trials  # a table of trials that the figure can draw
    checks: ClassVar[tuple[Check, ...]]

    def drawn(self, figure: Figure) -> Any:
        """Draw the figure; a metric that it does not name is the primary one, as in an experiment."""
        primary = self.results.primary or self.results.metrics[0].name
        keys: dict[str, Any] = {key: primary for key in figure.metric_keys if getattr(figure, key) is None}
        return replace(figure, **keys).draw(self.results)

    def svg(self, figure: Figure) -> bytes:
        """Draw the figure and write it without its date."""
        from rmpc_bench.figures.style import style

        buffer = io.BytesIO()
        with style():
            self.drawn(figure).savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        return buffer.getvalue()


def _accepted(figure: Figure, example: FigureExample) -> None:
    issues = list(figure.check(layout_of(example.results)))
    require(not issues, "; ".join(issue.message for issue in issues))


def _refused(figure: Figure, example: FigureExample) -> None:
    methods = example.results.methods
    issues = list(figure.check(ResultLayout(methods=methods, has_runs=False)))
    require(bool(issues), "an experiment without runs, series and recorded signals is not refused")
    require(all(isinstance(issue, Issue) and bool(issue.message) for issue in issues), "an issue has no message")


def _tables(trials: Trials) -> list[Any]:
    """Return all numbers, and the data frames of them that a figure may have read."""
    return [trials.frame, trials.series, data_frame(trials.columns), data_frame(series_columns(trials.over_time))]


def _same_bytes(figure: Figure, example: FigureExample) -> None:
    before = [table.copy() for table in _tables(example.results)]
    require(example.svg(figure) == example.svg(figure), "the second picture has other bytes than the first")
    same = all(table.equals(old) for table, old in zip(_tables(example.results), before, strict=True))
    require(same, "drawing changes the results")


def _width(figure: Figure, example: FigureExample) -> None:
    width = example.drawn(figure).get_figwidth()
    require(abs(width - figure.width) < 1e-9, f"the picture is {width:g} in wide instead of {figure.width:g} in")


FigureExample.checks = (
    base_class(Figure, "figure"),
    FROZEN,
    Check("accepted", "check accepts the layout of results that the figure can draw", _accepted),
    Check("refused", "check refuses, before any run, an experiment that has nothing to draw", _refused),
    Check("same-bytes", "drawing twice gives the same bytes and leaves the results unchanged", _same_bytes),
    Check("width", "the picture is as wide as its key `width` says", _width),
)


RUNS, STEPS = 11, 130
"""Size of the trajectories; 130 samples of three states make NumPy's sums pairwise."""
METRICS = (MetricInfo("mse", "m^2", "lower"), MetricInfo("power", "V^2", "lower"))


def example_record() -> Record:
    """Return trajectories with everything that a metric may read; P and M belong to a run."""
    rng = np.random.default_rng(21)
    x, x_hat, y = rng.standard_normal((3, RUNS, STEPS + 1, 3))
    u, r = rng.standard_normal((RUNS, STEPS, 2)), 0.1 * rng.standard_normal((STEPS + 1, 3))
    roots = rng.standard_normal((2, RUNS, STEPS + 1, 3, 3))
    P, M = np.eye(3) + np.einsum("...ij,...kj->...ik", roots, roots)
    bursts = rng.random((RUNS, STEPS + 1)) < 0.3
    return Record(0.5, x, y, x_hat, u, r, P, M, bursts=bursts, experiment=MetricLayout(STEPS, 0.5, "m", "V"))


def example_results() -> Trials:
    """Return results of two methods: two metrics, recorded runs, a reported matrix and ensemble moments."""
    from rmpc_bench.analysis.trials import Trials

    rng, runs, steps = np.random.default_rng(2), 6, 20
    k = np.arange(steps + 1.0)
    mse, power = rng.uniform(1.0, 2.0, (2 * runs, 2)).T
    columns = {
        "method": np.repeat(np.array(["A", "B"], dtype=object), runs),
        "run": np.tile(np.arange(runs), 2),
        "status": np.full(2 * runs, "ok", dtype=object),
    }
    return Trials(
        name="example",
        methods=("A", "B"),
        labels={"A": "A", "B": "B"},
        metrics=METRICS,
        columns=columns | {"mse": mse, "power": power},
        over_time=[Series(method, name, values) for method in "AB" for name, values in _series(k)],
        baseline="A",
        confidence=0.95,
        relevant=0.01,
        seed=7,
        traces={method: _traces(rng, runs, steps) for method in "AB"},
        Ts=0.5,
    )


def _traces(rng: np.random.Generator, runs: int, steps: int) -> Traces:
    from rmpc_bench.analysis.traces import Traces

    sizes = {"y": (2, steps + 1), "u": (1, steps), "x": (2, steps + 1), "x_hat": (2, steps + 1)}
    signals = {name: rng.standard_normal((runs, n_samples, n)) for name, (n, n_samples) in sizes.items()}
    return Traces(np.arange(runs), signals, np.zeros((steps + 1, 2)))


def _series(k: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return name and values of the series of a method."""
    matrix, vector = (2.0 + k)[:, None, None] * np.eye(2), np.sin(k)[:, None] + np.arange(2)
    return [("P", matrix), ("cov(e)", matrix), ("mean(x)", vector), ("mean(x_hat)", vector)]
