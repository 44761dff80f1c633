"""The stored trials of an experiment as tables: trials, series over time, recorded runs, times of the calls."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import Columns, Series, n_rows, one_text, stacked, with_point
from rmpc_bench.analysis.levels import look_of, number_of_look
from rmpc_bench.analysis.runs import RunNotes, common_runs
from rmpc_bench.analysis.traces import COVARIANCE, RunGroups, Traces
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.received.store import MissingError, decoded
from rmpc_bench.results import manifest
from rmpc_bench.results.other_code import rows_kept_apart
from rmpc_bench.results.record import StoredExperiment, StoredPoint
from rmpc_bench.simulation.block_times import BLOCK
from rmpc_bench.simulation.ensemble import Group, joined
from rmpc_bench.simulation.moments import Moments, signals
from rmpc_bench.store.store import WORDS, Store
from rmpc_bench.types import Array
from rmpc_bench.types.sweep_points import relevant_paths

SAME = (
    *("name", "labels", "relevant", "margins", "primary", "average", "headline", "axes", "expected_failures"),
    *("requirements", "calibration"),
)  # fields that the record of an experiment and every table of its trials have
OF_POINT = ("metrics", "seed", "Ts", "title", "random_besides", "laws", "limitations")  # those of the record of a point


class StoredTables:
    """Reads the tables of an experiment from its store; what points of a sweep share is read once."""

    def __init__(self, experiment: StoredExperiment, store: Store) -> None:
        self._experiment, self._store, self._n_runs = experiment, store, experiment.n_runs
        self._sampled: dict[str, Columns] = {}
        self._series: dict[tuple[str, str, bytes], list[Series]] = {}

    def trials(self) -> Trials:
        """Read the trials, without methods that have no stored run; a MissingError if there are none."""
        experiment, place = self._experiment, self._store.directory
        points = experiment.points
        self._columns = [{name: self._columns_of(point, name) for name in point.methods} for point in points]
        self._common = [common_runs(columns["run"] for columns in found.values()) for found in self._columns]
        tables = [table for number in range(len(points)) if (table := self._at_point(number)).methods]
        if not tables:
            apart = self.other_code
            stored = f"{apart}; no trial" if apart else "no trial of this configuration"
            raise MissingError(f"{place}: {stored} is stored; continue with `rmpc-bench run`")
        n_runs = max(len(table.common.runs) for table in tables)
        if experiment.has_runs and not n_runs:
            raise MissingError(f"{place}: no run is stored of every method yet; continue with `rmpc-bench run`")
        look = number_of_look(manifest.looks_of_store(self._store), look_of(n_runs, experiment.adjust))
        tables = [replace(table, look=look) for table in tables]
        return self._joined(tables) if experiment.paths else tables[0]

    def _joined(self, tables: Sequence[Trials]) -> Trials:
        """Put the tables of all points of a sweep into one."""
        experiment = self._experiment
        whole = replace(
            tables[0],
            methods=experiment.methods,
            baseline=experiment.baseline,
            traces={},
            paths=experiment.paths,
            alike=experiment.alike,
            point={},
            title="",
            keys={},
        ).with_points(tables)
        return replace(whole, over_time=self._series_of_sweep(whole.methods))

    def _at_point(self, number: int) -> Trials:
        """Read the table of one point."""
        experiment = self._experiment
        # The columns of a point are in memory once: what is read of a large experiment fills it.
        point, found, self._columns[number] = experiment.points[number], self._columns[number], {}
        methods = tuple(name for name, columns in found.items() if n_rows(columns) or not experiment.has_runs)
        columns = stacked([*found.values()])
        del found
        traces = {name: trace for name in methods if (trace := traces_of(point, self._store, name)) is not None}
        groups = {name: self._groups(point, name, self._common[number]) for name in methods}
        return Trials(
            **self._same_at_all_points(),
            **_of_record(point),
            methods=methods,
            columns=columns,
            over_time=self._series_at(number, methods),
            baseline=experiment.baseline if experiment.baseline in methods else (*methods, "")[0],
            units=with_estimates(point, point.units, traces.values()),
            names=with_estimates(point, point.names, traces.values()),
            traces=traces,
            groups={name: each for name, each in groups.items() if each is not None},
            notes=self._notes(point, methods),
            quantities=self._quantities(point),
        )

    def _same_at_all_points(self) -> dict[str, Any]:
        """Return the fields of a table that do not depend on the point of the sweep."""
        experiment, imported = self._experiment, self._experiment.imported
        elsewhere = {} if imported is None else {"run_names": imported.names, "unpaired": imported.unpaired}
        return {
            **{name: getattr(experiment, name) for name in SAME},
            **experiment.comparison_keys(),
            "confidence": experiment.level,
            "planned": None if experiment.stop is None else experiment.stop.planned,
            "with_verdicts": not experiment.is_smoke,
            "declared": experiment.methods,
            "parameters": experiment.origins,
            "elsewhere": imported is not None,
            **elsewhere,
        }

    def _columns_of(self, point: StoredPoint, name: str) -> dict[str, Array]:
        key = point.methods[name].key
        runs, status = self._store.statuses(key, self._n_runs)
        columns = {metric: self._store.values(key, stored, runs) for metric, stored in point.metric_keys.items()}
        return {"method": one_text(name, len(runs)), "run": runs, "status": WORDS[status], **columns}

    def _notes(self, point: StoredPoint, methods: Sequence[str]) -> dict[str, RunNotes]:
        """Read what happened in the runs of every method besides their numbers."""
        notes = {}
        for name, method in ((name, point.methods[name]) for name in methods):
            of = method.key, self._n_runs
            failures, failed = tuple(self._store.failures(*of)), self._store.failed_steps(*of)
            held, warnings = self._store.held(*of), self._store.warnings(*of)
            notes[name] = RunNotes(
                point.n_steps, method.holds, failures, held, warnings, None, method.optimises, failed
            )
        return notes

    def _groups(self, point: StoredPoint, name: str, common: Array | None) -> RunGroups | None:
        """Read the moments over the runs, group by group; None where none are stored, or fewer than two groups."""
        parts = [part for part in self._ensemble(point, name, common) if part.n]
        whole = [part for part in parts if not part.is_single] or parts
        if len(whole) < 2:
            return None
        runs = tuple(np.arange(part.first, part.stop) for part in whole)
        zero = np.zeros((*whole[0].mean.shape, whole[0].mean.shape[1]))
        second = np.array([zero if part.is_single else part.second for part in whole])
        n, mean = np.array([part.n for part in whole]), np.array([part.mean for part in whole])
        return RunGroups(runs, n, mean, second, point.nx)

    def _ensemble(self, point: StoredPoint, name: str, runs: Array | None) -> list[Group]:
        """Read the stored groups of which all runs are among some; None for all runs."""
        found = self._store.ensemble(point.methods[name].key, self._n_runs) if point.has_ensemble else []
        return [each for each in found if runs is None or np.isin(np.arange(each.first, each.stop), runs).all()]

    @property
    def other_code(self) -> str:
        """The stored rows of other code that are missing in the tables, in words; empty where there are none."""
        return str(rows_kept_apart(self._experiment.stored_methods, self._store, self._n_runs))

    def n_complete(self) -> dict[str, int]:
        """Count the runs of every method that are stored with all metrics and traces, at the point where fewest are."""
        counts: dict[str, int] = {}
        for point in self._experiment.points:
            for name, method in point.methods.items():
                metrics, recording = point.metric_keys.values(), point.recording(name)
                done = self._store.finished(method.key, metrics, recording, self._n_runs)
                counts[name] = min(counts.get(name, self._n_runs), len(done))
        return counts

    def uncertainty(self) -> dict[str, Array]:
        """Read every sampled value of the named uncertain quantities: sweep columns, ``run`` and one per quantity."""
        return stacked([with_point(self._quantities(each), each.coordinates) for each in self._experiment.points])

    def _quantities(self, point: StoredPoint) -> Columns:
        """Read the sampled values at one point: ``run`` and one column per quantity."""
        if point.uncertainty_key not in self._sampled:
            runs, columns = self._store.uncertainty(point.uncertainty_key, self._n_runs)
            names = [*point.uncertainty, *(name for name in columns if name not in point.uncertainty)]
            missing = np.full(len(runs), np.nan)
            sampled = {"run": runs, **{name: columns.get(name, missing) for name in names}}
            self._sampled[point.uncertainty_key] = sampled
        return self._sampled[point.uncertainty_key]

    def _series_at(self, number: int, methods: Sequence[str]) -> list[Series]:
        """Read the series of some methods at a point; points that share a series get the same arrays.

        An ensemble has the common runs of its point.
        """
        point, runs = self._experiment.points[number], self._common[number]
        chosen = runs.tobytes() if runs is not None and point.has_ensemble else b""
        found = []
        for name in methods:
            key = name, point.methods[name].series_key, chosen
            if key not in self._series:
                self._series[key] = [*self._of_design(point, name), *self._of_ensemble(point, name, runs)]
            found += self._series[key]
        return found

    def _series_of_sweep(self, methods: Sequence[str]) -> list[Series]:
        """Series of some methods at all points, each once: the values of paths it does not depend on are empty."""
        points, found = self._experiment.points, list[Series]()
        for name in methods:
            rows = [(point.coordinates, point.methods[name].series_key) for point in points]
            paths = relevant_paths(rows, self._experiment.axes)
            seen: set[tuple[str, ...]] = set()
            for number, point in enumerate(points):
                where = {path: point.coordinates[path] if path in paths else "" for path in self._experiment.paths}
                if tuple(where.values()) not in seen:
                    seen.add(tuple(where.values()))
                    found += [each._replace(point=where) for each in self._series_at(number, [name])]
        return found

    def _of_design(self, point: StoredPoint, method: str) -> list[Series]:
        """Gains, covariances, multipliers of a design over k."""
        series = point.methods[method].series
        return [Series(method, quantity, self._store.array(name)) for quantity, name in series.items()]

    def _of_ensemble(self, point: StoredPoint, method: str, runs: Array | None) -> list[Series]:
        """Mean and covariance of state, estimate and error over the runs: exact where they can be, and from groups."""
        parts, exact = [], point.methods[method].moments
        if exact is not None:
            moments = Moments(*(self._store.array(name) for name in exact))
            # The error of an unstable estimator may grow until it overflows.
            with np.errstate(over="ignore", invalid="ignore"):
                parts += [Series(method, name, values) for name, values in signals(moments, point.nx).items()]
        if groups := self._ensemble(point, method, runs):
            n, mean, cov = joined(groups)
            sampled = signals(Moments(mean, cov), point.nx) if n > 1 else {}
            parts += [Series(method, name, values, n) for name, values in sampled.items()]
        return parts

    def timings(self) -> Columns:
        """Read how long the calls of components took: sweep columns, method, component, phase, calls and quantiles.

        The phase is ``step``, ``first step`` (which may compile) or ``start``; ``block`` is the time per run and step
        of a component that computes all runs of a block at once, with every run as a call.  The quantiles have the
        relative error of a histogram (`Durations`), 1 %.  They differ from computation to computation.  Without
        components that are called run by run, and without ranks, there are none.
        """
        rows, has_own = [], False
        for point in self._experiment.points:
            for name, method in point.methods.items():
                stored = self._store.durations(method.key, self._n_runs)
                has_own = has_own or any(not phase.endswith(f", {BLOCK}") for phase in stored)
                for component, durations in stored.items():
                    part, _, phase = component.partition(", ")
                    seconds = [durations.quantile(0.5), durations.quantile(0.95), durations.largest]
                    share = seconds[1] / point.Ts if point.Ts and "t" not in point.units else math.nan
                    numbers = [float(f"{value:.4g}") for value in (*seconds, share)]
                    rows.append([*point.coordinates.values(), name, part, phase or "step", durations.n, *numbers])
        names = ("method", "component", "phase", "calls", "median_s", "q95_s", "largest_s", "q95_share_of_Ts")
        cells = [*zip(*rows, strict=True)] if rows and (has_own or self._experiment.ranks) else ()
        return {name: cells[place] if cells else () for place, name in enumerate((*self._experiment.paths, *names))}


def _of_record(point: StoredPoint) -> dict[str, Any]:
    """Return the fields of a table that the record of its point has as they are, without a look at the trials."""
    return {
        **{name: getattr(point, name) for name in OF_POINT},
        "point": point.coordinates,
        "keys": {name: method.key for name, method in point.methods.items()},
        "oracles": frozenset(name for name, method in point.methods.items() if method.is_oracle),
        "limits": {name: method.limits for name, method in point.methods.items()},
        "bounds": frozenset(name for name, method in point.methods.items() if method.P_is == "bound"),
    }


def traces_of(point: StoredPoint, store: Store, name: str) -> Traces | None:
    """Read the recorded runs of a method; None where there are none."""
    method, n_runs = point.methods[name], point.n_recorded
    if point.reference is None or not method.signals:
        return None
    found = {signal: store.traces(method.key, signal, n_runs) for signal in method.signals}
    runs = sorted(set.intersection(*(set(stored) for stored, _ in found.values())))
    signals = {signal: array[np.isin(stored, runs)] for signal, (stored, array) in found.items()}
    r = store.array(point.reference)
    shapes = dict(method.shapes)
    with decoded(store.directory):
        _check(point, signals if runs else {}, r, shapes)
    if COVARIANCE in signals and COVARIANCE not in shapes:
        n = math.isqrt(signals[COVARIANCE].shape[2])
        shapes[COVARIANCE] = (n, n)
    return Traces(np.array(runs, dtype=np.int64), signals, r, shapes, point.angles) if runs else None


def _check(point: StoredPoint, signals: Mapping[str, Array], r: Array, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse recorded runs that do not have the samples and the components of their experiment."""
    if r.ndim != 2 or len(r) <= point.n_steps:
        raise ValueError(f"the reference has the shape {r.shape} with {point.n_steps} steps")
    for name, values in signals.items():
        n_samples, width = values.shape[1:]
        if n_samples not in (point.n_steps, point.n_steps + 1) or width != math.prod(shapes.get(name, (width,))):
            raise ValueError(f"traces.data of {name} has {n_samples} samples of {width} components")
    if COVARIANCE in signals and math.isqrt(signals[COVARIANCE].shape[2]) ** 2 != signals[COVARIANCE].shape[2]:
        raise ValueError(f"traces.width of {COVARIANCE} is no square")


def with_estimates(point: StoredPoint, texts: Mapping[str, str], traces: Iterable[Traces]) -> dict[str, str]:
    """Return units or names of components; an estimate of the plant's states has those of the states."""
    found = dict(texts)
    widths = {trace.signals["x_hat"].shape[2] for trace in traces if "x_hat" in trace.signals}
    if widths == {point.nx}:
        found |= {f"x_hat.{i}": found[f"x.{i}"] for i in range(point.nx) if f"x.{i}" in found}
    return found


def with_timings(trials: Trials, timings: Columns) -> Trials:
    """Return trials with the times per step that follow from a table of `timings`, such as that of an archive."""
    if not n_rows(timings):
        return trials
    paths = [*trials.each[0].point]
    # Values of the swept paths, and a method -> phase of a component -> median.
    medians: dict[tuple[tuple[str, ...], str], dict[str, float]] = {}
    for cells in zip(*timings.values(), strict=True):
        row = dict(zip(timings, cells, strict=True))
        phase = "" if row["phase"] == "step" else f", {row['phase']}"
        at = tuple(str(row[path]) for path in paths)
        medians.setdefault((at, row["method"]), {})[f"{row['component']}{phase}"] = row["median_s"]

    def noted(table: Trials) -> Trials:
        at, notes = tuple(table.point[path] for path in paths), dict(table.notes)
        for name, each in notes.items():
            notes[name] = replace(each, seconds_per_step=_step_time(medians.get((at, name), {})))
        return replace(table, notes=notes)

    return replace(trials, points=tuple(map(noted, trials.points))) if trials.points else noted(trials)


def _step_time(medians: Mapping[str, float]) -> float | None:
    """Return the median time of a step of estimator and controller together [s]; None where one is not known."""
    found = [medians.get(role, medians.get(f"{role}, {BLOCK}")) for role in ("estimator", "controller")]
    known = [each for each in found if each is not None]
    return sum(known) if len(known) == len(found) else None
