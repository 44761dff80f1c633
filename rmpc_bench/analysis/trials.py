"""The table of trials: points x methods x runs x metrics, the series of the designs and the recorded runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.analysis.adjustment import Adjustment, adjustment_of
from rmpc_bench.analysis.columns import Columns, Series, data_frame, rows_at, series_columns, stacked, with_point
from rmpc_bench.analysis.levels import PlannedLook
from rmpc_bench.analysis.runs import RunNotes, common_runs
from rmpc_bench.analysis.traces import RunGroups, Traces, last_new_sample
from rmpc_bench.types import Array, MetricInfo, Status
from rmpc_bench.types.metric import CalibrationKeys, ComparisonKeys, Requirement
from rmpc_bench.types.tuning import Tuning

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Trials(ComparisonKeys):
    """What an experiment left behind, ready for statistics.

    The table of a sweep consists of `points`, each of them a table of its own; what concerns single runs (`column`,
    `pairs`, `n_failed`, `matrix_series`, `traces`) belongs to a point.

    Parameters
    ----------
    name : name of the experiment
    methods : names in the order of the configuration
    labels : method name -> text for tables and figures
    metrics : one record per metric of `columns`
    columns : columns `method, run, status` and one of floats per metric (NaN where the run failed, inf where an event
        did not occur), sorted by method (order of the configuration), then run; `frame` is the same as a data frame
    over_time : series of the designs and of the ensemble; `series` is a data frame of them
    baseline : the method that all others are compared with
    confidence : level of every interval, such as 0.95
    relevant : the smallest relative change that matters, such as 0.01
    margins : metric -> the smallest difference that matters where it is not `relevant`: a relative change, or a number
        in the unit of a signed metric
    primary : name of the metric that has a verdict; the first one if empty
    average : averages that are asked for: ``geometric``, ``mean`` or ``both``
    headline : the average that the verdict rests on where both are asked for
    axes : paths of every axis of the sweep
    look : how often a verdict was published with other numbers of runs, this one included
    planned : look of a stopping rule that the table rests on; `confidence` is then the level of each interval
    with_verdicts : whether comparisons have a verdict; those of a smoke run have none
    seed : seed of the experiment
    Ts : sampling time [s]; 0 where it is not known
    units : signal -> unit, such as y -> rad; of a component with a unit of its own y.2 -> rad, of the
        time t -> min unless it is s
    names : component of a signal, such as y.0 -> its name
    traces : method -> its recorded runs
    paths : the columns of a sweep, which come first in `columns` and `series`; empty without one
    points : the tables of a sweep's points; empty without one
    alike : whether the methods are the same at all points, which then differ in the true system only
    point : path -> value as text, where the table is a point of a sweep
    title : the point in words, such as ``controller.Hp=10, controller.Hu=8``; empty without a sweep
    keys : method -> what identifies its trials, the same at points that share them
    oracles : methods whose estimator is an oracle
    declared : all methods of the experiment, also those that have no stored runs; `methods` if empty
    notes : method -> failures, held steps and warnings of its runs
    quantities : column ``run``, ascending, and one per named uncertain quantity; empty for a whole sweep, whose points
        have it; `uncertainty` is the same as a data frame
    requirements : what the metric of a run must keep
    laws : uncertain quantity -> keys of its law, such as ``dist``, where it has one of its own
    random_besides : what else is random in a run, such as ``noise``; None where the store does not say
    limitations : what a comparison with this plant cannot show, as sentences
    groups : method -> moments over the runs by groups of runs, where they are not exact
    expected_failures : method -> check of its components that is meant to fail -> reason
    parameters : method -> where its parameters come from, such as ``default``; nothing is said of methods without one
    limits : method -> component of a signal, such as u.0, or u of all -> its limits in the controller
    tuning : how the parameters of tuned methods were chosen, at all points; None where it is not known
    calibration : how reported covariances are compared with the errors; None where they are not
    bounds : methods whose P is an upper bound of the covariance
    elsewhere : whether another program has made the runs
    run_names : original names of the runs by their index, where another program has made them
    unpaired : whether run i of two methods has nothing in common, so that methods are compared without pairs

    Examples
    --------
    >>> import rmpc_bench
    >>> trials = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4}).trials
    >>> trials.column("mse", "R-MPC").shape, trials.frame["status"].unique().tolist()
    ((4,), ['ok'])
    """

    name: str
    methods: tuple[str, ...]
    labels: Mapping[str, str]
    metrics: tuple[MetricInfo, ...]
    columns: Columns
    over_time: Sequence[Series]
    baseline: str
    confidence: float
    relevant: float
    seed: int
    Ts: float = 0.0
    units: Mapping[str, str] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)
    traces: Mapping[str, Traces] = field(default_factory=dict)
    paths: tuple[str, ...] = ()
    points: tuple[Trials, ...] = ()
    alike: bool = False
    point: Mapping[str, str] = field(default_factory=dict)
    title: str = ""
    keys: Mapping[str, str] = field(default_factory=dict)
    oracles: frozenset[str] = frozenset()
    margins: Mapping[str, float] = field(default_factory=dict)
    primary: str = ""
    average: str = "both"
    headline: str = "geometric"
    axes: tuple[tuple[str, ...], ...] = ()
    look: int = 1
    planned: PlannedLook | None = None
    with_verdicts: bool = True
    groups: Mapping[str, RunGroups] = field(default_factory=dict)
    expected_failures: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    notes: Mapping[str, RunNotes] = field(default_factory=dict)
    quantities: Columns = field(default_factory=dict)
    laws: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    random_besides: tuple[str, ...] | None = None
    limitations: tuple[str, ...] = ()
    requirements: tuple[Requirement, ...] = ()
    declared: tuple[str, ...] = ()
    parameters: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, Mapping[str, tuple[float | None, float | None]]] = field(default_factory=dict)
    tuning: Tuning | None = None
    calibration: CalibrationKeys | None = None
    bounds: frozenset[str] = frozenset()
    elsewhere: bool = False
    run_names: Sequence[int | str] = ()
    unpaired: bool = False

    def __repr__(self) -> str:
        return f"<Trials of {self.name!r}: {len(self.runs)} runs of {len(self.methods)} methods>"

    @cached_property
    def frame(self) -> pd.DataFrame:
        """The table of trials."""
        return data_frame(self.columns)

    @cached_property
    def series(self) -> pd.DataFrame:
        """Columns `method, quantity, component, k, n, value`; `component` is such as "0,1", n = 0 means exact."""
        return data_frame(series_columns(self.over_time, self.paths))

    @cached_property
    def uncertainty(self) -> pd.DataFrame:
        """The named uncertain quantities."""
        return data_frame(self.quantities)

    def with_tuning(self, tuning: Tuning | None) -> Trials:
        """Return the same trials, and points of a sweep, with a record of how parameters were chosen."""
        return replace(self, tuning=tuning, points=tuple(replace(point, tuning=tuning) for point in self.points))

    @cached_property
    def adjustment(self) -> Adjustment:
        """What the comparisons of this point are adjusted for."""
        return adjustment_of(self.adjust, self.runs, self.quantities, self.laws, self.random_besides)

    @property
    def all_methods(self) -> tuple[str, ...]:
        """All methods of the experiment; the place of a method among them gives its style in figures."""
        return self.declared or self.methods

    @property
    def is_random(self) -> bool:
        """Whether runs differ by chance, as far as the store says; else a single run is all there is."""
        return self.random_besides != () or any(len(point.quantities) > 1 for point in self.each)

    @property
    def time_unit(self) -> str:
        """Unit of the time, as `time.unit` of the configuration gives it."""
        return self.units.get("t", "s")

    @property
    def primary_info(self) -> MetricInfo | None:
        """The metric that has a verdict; None where it is not in this table."""
        if not self.primary:
            return self.metrics[0] if self.metrics else None
        return next((info for info in self.metrics if info.name == self.primary), None)

    def relevant_of(self, metric: str, *, default: float | None = None) -> float:
        """Return the smallest difference of a metric that matters; `default`, or `relevant`, without its own margin."""
        return self.margins.get(metric, self.relevant if default is None else default)

    @property
    def each(self) -> tuple[Trials, ...]:
        """The tables of all points; the table itself where there is no sweep."""
        return self.points or (self,)

    @cached_property
    def common(self) -> Trials:
        """The same trials in the runs that every method with rows has, finished or failed: statistics rest on these.

        A method without a row leaves no run out.  Points of a sweep without a common run are left out.
        """
        if self.points:
            points = tuple(point.common for point in self.points)
            if all(new is old for new, old in zip(points, self.points, strict=True)):
                return self
            return self.with_points([point for point in points if len(point.runs)] or points[:1])
        runs = common_runs([self.runs[places] for _, places, _ in self._rows.values()])
        return self if runs is None else self._of_runs(runs)

    def _of_runs(self, runs: Array) -> Trials:
        def kept(table: Columns) -> Columns:
            return rows_at(table, np.isin(table["run"], runs)) if "run" in table else table

        return replace(
            self,
            columns=kept(self.columns),
            quantities=kept(self.quantities),
            traces={name: traces.of_runs(runs) for name, traces in self.traces.items()},
            notes={name: notes.of_runs(runs) for name, notes in self.notes.items()},
        )

    def with_points(self, points: Sequence[Trials]) -> Trials:
        """Return the table of a sweep with other tables of its points, and the methods that these have."""
        present = {method for point in points for method in point.methods}
        methods = tuple(name for name in self.methods if name in present)
        return replace(
            self,
            methods=methods,
            columns=stacked([with_point(point.columns, point.point) for point in points]),
            baseline=self.baseline if self.baseline in methods else (*methods, "")[0],
            points=tuple(points),
        )

    @property
    def is_population(self) -> bool:
        """Whether the points can be taken together: the same methods, each of them on plants that all differ.

        Points of several runs cannot: every point has the same draws, so the runs would not be independent.
        """
        if any(len(table.runs) != 1 for table in self.points):
            return False
        keys = [(method, key) for table in self.points for method, key in table.keys.items()]
        return self.alike and len(set(keys)) == len(keys)

    def pooled(self) -> Trials:
        """Take the runs of all points of a sweep together, numbered on from point to point."""
        n_runs = max(int(table.runs[-1]) for table in self.points) + 1
        tables = [{**table.columns, "run": table.columns["run"] + n * n_runs} for n, table in enumerate(self.points)]
        return replace(
            self,
            columns=stacked(tables),
            over_time=(),
            paths=(),
            points=(),
            title=f"all {len(self.points)} points together",
        )

    @cached_property
    def runs(self) -> Array:
        """The run indices of the table, ascending."""
        return np.unique(self.columns["run"])

    @cached_property
    def _rows(self) -> dict[str, tuple[Array, Array, Array]]:
        """Per method the positions of its rows in the table and in `runs`, and which of them ended well."""
        names, runs, ok = self.columns["method"], self.columns["run"], self.columns["status"] == Status.OK.word
        rows = {name: np.flatnonzero(names == name).astype(np.int32) for name in self.methods}
        places = {name: np.searchsorted(self.runs, runs[found]).astype(np.int32) for name, found in rows.items()}
        return {name: (found, places[name], ok[found]) for name, found in rows.items()}

    @cached_property
    def _complete(self) -> dict[str, slice]:
        """Methods of which every run ended well, in rows that follow each other -> these rows."""
        found, n = {}, len(self.runs)
        for name, (rows, places, ok) in self._rows.items():
            if len(rows) == n > 0 and rows[-1] - rows[0] == n - 1 and ok.all() and (np.diff(places) == 1).all():
                found[name] = slice(int(rows[0]), int(rows[-1]) + 1)
        return found

    @cached_property
    def _finished(self) -> Array:
        """Of every row whether its run ended well."""
        found = np.zeros(len(self.columns["run"]), dtype=bool)
        for rows, _, ok in self._rows.values():
            found[rows] = ok
        return found

    def has_negative(self, metric: str) -> bool:
        """Whether a metric is negative in a run that ended well."""
        return bool(((self.columns[metric] < 0) & self._finished).any())

    def with_numbers(self, **changes: Any) -> Trials:
        """Return the same trials with other metrics, or other values of them; methods, runs and statuses stay."""
        made = replace(self, **changes)
        # Which row belongs to which run is found once: millions of texts are compared for it.
        for name in {"runs", "_rows", "_complete", "_finished", "adjustment"} & set(self.__dict__):
            made.__dict__[name] = self.__dict__[name]
        return made

    def column(self, metric: str, method: str) -> Array:
        """Values of one metric of one method over all runs.

        Parameters
        ----------
        metric : name of a metric column
        method : name of a method

        Returns
        -------
        (n_runs,) values in the order of `runs`; NaN where the run failed or has no value, inf without the event
        """
        if method in self._complete:
            return np.array(self.columns[metric][self._complete[method]])
        values = np.full(len(self.runs), np.nan)
        if method in self._rows:
            rows, places, ok = self._rows[method]
            values[places[ok]] = self.columns[metric][rows[ok]]
        return values

    def pairs(self, metric: str, method: str, other: str) -> tuple[Array, Array]:
        """Values of two methods in the runs that both finished.

        Parameters
        ----------
        metric : name of a metric column
        method, other : names of the two methods

        Returns
        -------
        two arrays of shape (n_pairs,), entry i of both from the same run
        """
        a, b = self.column(metric, method), self.column(metric, other)
        both = ~(np.isnan(a) | np.isnan(b))
        return a[both], b[both]

    def statuses(self, method: str) -> dict[int, str]:
        """Return run -> word of its status, of the runs of a method."""
        rows = rows_at({name: self.columns[name] for name in ("run", "status")}, self.columns["method"] == method)
        return dict(zip(rows["run"].tolist(), rows["status"].tolist(), strict=True))

    def failed(self, method: str) -> Array:
        """Return whether a method failed, (n_runs,) in the order of `runs`; an absent run did not."""
        found = np.zeros(len(self.runs), dtype=bool)
        if method in self._rows:
            _, places, ok = self._rows[method]
            found[places[~ok]] = True
        return found

    def n_failed(self, method: str) -> int:
        """Count the runs of `method` that ended with any status but ok."""
        return int((~self._rows[method][2]).sum()) if method in self._rows else 0

    @property
    def n_failed_trials(self) -> int:
        """Failed trials of all methods at all points; trials that points share count once."""
        failed: dict[tuple[str, str | None], int] = {}
        for table in self.each:
            failed |= {(name, table.keys.get(name)): table.n_failed(name) for name in table.methods}
        return sum(failed.values())

    def series_of(self, quantity: str, method: str) -> list[Series]:
        """Return the series of a quantity of a method, the exact one first, then that from most runs."""
        found = [each for each in self.over_time if (each.quantity, each.method) == (quantity, method)]
        return sorted(found, key=lambda each: -each.n if each.n else -math.inf)

    def n_of(self, quantity: str, method: str) -> int:
        """Count the runs that `matrix_series` of a quantity stands on; 0 where it is exact."""
        return next((each.n for each in self.series_of(quantity, method)), 0)

    def run_groups(self, quantity: str, method: str) -> RunGroups | None:
        """Groups of runs that can be left out of a moment of the ensemble, such as ``cov(e)``.

        Single runs where the trajectories of every finished run are recorded, else the stored groups; None without any.
        """
        found = (self._recorded(method), self.groups.get(method))
        return next((groups for groups in found if groups is not None and groups.has(quantity)), None)

    def exported_traces(self) -> dict[str, Traces]:
        """Return method -> its recorded runs, with NaN after the sample at which a run has failed."""
        found = {}
        for method, trace in self.traces.items():
            failed = {*self.runs[self.failed(method)].tolist()}
            # A built-in component says no sample; nothing of the plant moves after it.
            state = trace.signals.get("x", trace.signals.get("y", ()))
            recorded = zip(trace.runs.tolist(), state, strict=False)
            last = {run: last_new_sample(x) for run, x in recorded if run in failed}
            for each in self.notes[method].failures if method in self.notes else ():
                if each.component == "metric":
                    last.pop(each.run, None)
                elif each.k is not None:
                    last[each.run] = each.k
            found[method] = trace.until(last)
        return found

    def _recorded(self, method: str) -> RunGroups | None:
        if method not in self._recorded_groups:
            trace = self.traces.get(method)
            ok = self._rows[method][1][self._rows[method][2]] if method in self._rows else np.zeros(0, dtype=np.int64)
            complete = trace is not None and len(ok) > 0 and bool(np.isin(self.runs[ok], trace.runs).all())
            self._recorded_groups[method] = trace.groups(self.runs[ok]) if trace is not None and complete else None
        return self._recorded_groups[method]

    @cached_property
    def _recorded_groups(self) -> dict[str, RunGroups | None]:
        return {}

    def matrix_series(self, quantity: str, method: str) -> Array:
        """Return a series of a design; where it exists exactly and from runs, the exact one counts.

        Parameters
        ----------
        quantity : name in the column `quantity`
        method : name of a method

        Returns
        -------
        (samples,), (samples, rows) or (samples, rows, columns) array with axis 0 = k

        Raises
        ------
        KeyError
            when the method has no such series
        """
        found = self.series_of(quantity, method)
        if not found:
            raise KeyError(f"{method} has no series {quantity}")
        return found[0].values
