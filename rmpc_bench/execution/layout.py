"""From a configuration to the record of its experiment that reports read."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from hashlib import sha256
from typing import Any

import numpy as np

from rmpc_bench.components.designs import is_built_in
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.identity import SweepPoint, digest, independent_laws, set_keys
from rmpc_bench.config.statistics import read_requirement
from rmpc_bench.config_file.tree import plain
from rmpc_bench.results.record import (
    PointMethod,
    StoredExperiment,
    StoredPoint,
    added_methods,
    stop_of,
    write_experiment,
)
from rmpc_bench.simulation.closed_loop import metric_remarks
from rmpc_bench.simulation.moments import exact_laws, exact_moments
from rmpc_bench.simulation.recording import design_series, kept
from rmpc_bench.simulation.scenario import Experiment, random_besides
from rmpc_bench.store.store import Store
from rmpc_bench.types import Array, Method
from rmpc_bench.types.tuning import StoredTuning

BUILT_IN = ("rmpc_bench.estimators.", "rmpc_bench.controllers.")


def keep_layout(config: ExperimentConfig, store: Store, methods: Collection[str]) -> None:
    """Store beside its trials what reports need of an experiment; what has changed without new trials is renewed."""
    layout = _Layout(config, store, methods)
    write_experiment(store, layout.experiment(), layout.arrays)


class _Layout:
    """Makes the record of an experiment and collects the arrays that it names."""

    def __init__(self, config: ExperimentConfig, store: Store, methods: Collection[str]) -> None:
        self._config = config
        # A program that runs the configuration without the option leaves the record of added methods alone.
        self._added = {**added_methods(store), **config.added}
        self._shown = {name for name in config.methods if name in methods or _has_results(config, store, name)}
        self._series: dict[tuple[str, str], tuple[dict[str, str], tuple[str, str] | None]] = {}
        self.arrays: dict[str, Array] = {}

    def experiment(self) -> StoredExperiment:
        """Return the record."""
        config, statistics = self._config, self._config.statistics
        metrics = [info.name for info in config.experiment.metric_infos]
        return StoredExperiment(
            name=config.name,
            paper=config.paper,
            title=config.title,
            hash=config.hash,
            n_runs=config.experiment.n_runs,
            has_runs="runs" in config.evaluate,
            axes=config.axes,
            labels=dict(config.labels),
            primary=config.primary,
            baseline=config.baseline,
            confidence=statistics.confidence,
            relevant=statistics.relevant_change,
            margins=dict(statistics.margins),
            average=statistics.average,
            headline=config.headline,
            max_failures=config.execution.max_failures,
            alike=all(point.methods == config.methods for point in config.points),
            overrides=config.overrides,
            figures=tuple(plain(set_keys(figure)) for figure in config.figures),
            claims=config.claims,
            points=tuple(self._point(point) for point in config.points),
            expected_failures=_declared(config),
            report=config.report,
            requirements=tuple(read_requirement(text, metrics) for text in statistics.requirements),
            **statistics.comparison_keys(),
            added=self._added,
            stop=stop_of(config, None),
            parameters=dict(config.parameters),
            tuning=_tuning(config),
            calibration=config.calibration,
        )

    def _point(self, point: SweepPoint) -> StoredPoint:
        experiment, plant = point.experiment, point.experiment.plant
        # The shares are those of the first run of the experiment.
        has_first = point is self._config.points[0] and "runs" in self._config.evaluate
        remarks = metric_remarks(experiment) if has_first else ()
        recording = experiment.recording
        is_recorded = bool(recording.n_runs and recording.signals)
        extra = {name: unit for name, unit in plant.extra_signals.items() if name in recording.signals}
        units, names = {"u": plant.u_unit, **plant.units}, dict(plant.names)
        time = {"t": experiment.time_unit} if experiment.time_unit != "s" else {}
        if "u_command" in recording.signals:
            units |= {f"u_command{place[1:]}": unit for place, unit in units.items() if place[0] == "u"}
            names |= {f"u_command{place[1:]}": f"{name}, command" for place, name in names.items() if place[0] == "u"}
        return StoredPoint(
            coordinates=dict(point.coordinates),
            title=point.title,
            seed=experiment.scenario.seed,
            Ts=0.0 if self._config.in_samples else float(plant.Ts),
            nx=int(plant.nx),
            n_steps=experiment.n_steps,
            units={"y": plant.y_unit, **units, **extra, **time},
            metrics=experiment.metric_infos,
            metric_keys=dict(point.metric_keys),
            methods={method.name: self._method(point, method) for method in experiment.methods},
            n_recorded=recording.n_runs,
            has_ensemble=recording.ensemble,
            reference=self._keep(experiment.scenario.reference.sample(experiment.n_steps + 1)) if is_recorded else None,
            uncertainty_key=point.uncertainty_key,
            uncertainty=experiment.scenario.quantities,
            names={**names, **{f"{name}.0": name.replace("_", " ") for name in extra}},
            random_besides=random_besides(experiment),
            limitations=(*plant.limitations, *remarks),
            angles=dict(experiment.angles),
            laws=independent_laws(experiment),
        )

    def _method(self, point: SweepPoint, method: Method) -> PointMethod:
        experiment, name = point.experiment, method.name
        series_key = _series_key(point, name)
        shown = name in self._shown
        series, moments = self._series_of(experiment, method, series_key) if shown else ({}, None)
        signals = kept(experiment, name).signals
        return PointMethod(
            definition=point.definitions[name],
            code=point.code[name],
            is_oracle=name in experiment.oracles,
            signals=signals,
            shapes={signal: tuple(map(int, shape)) for signal, shape in method.reports.items() if signal in signals},
            series_key=series_key,
            series=series,
            moments=moments,
            holds=method.estimator.holds or method.controller.holds,
            optimises=method.controller.optimises,
            limits=_limits(point.methods[name]["controller"]) if _is_of_bench(point, name) else {},
            P_is=method.estimator.P_is,
        )

    def _series_of(
        self, experiment: Experiment, method: Method, key: str
    ) -> tuple[dict[str, str], tuple[str, str] | None]:
        """Name the arrays of the series of a design and of its exact moments; points may share them."""
        if (method.name, key) not in self._series:
            series = {quantity: self._keep(values) for quantity, values in design_series(method).items()}
            self._series[method.name, key] = series, self._moments(experiment, method)
        return self._series[method.name, key]

    def _moments(self, experiment: Experiment, method: Method) -> tuple[str, str] | None:
        schedule = method.estimator.gain_schedule
        if not experiment.recording.ensemble or "moments" not in self._config.evaluate or schedule is None:
            return None
        laws = exact_laws(experiment.plant, method, experiment.scenario)
        if isinstance(laws, str):
            return None
        mean, cov = exact_moments(experiment.plant, schedule, laws, experiment.n_steps, method.n_disturbances)
        return self._keep(mean), self._keep(cov)

    def _keep(self, values: Array) -> str:
        """Keep an array under the hash of its content."""
        array = np.ascontiguousarray(values, dtype="<f8")
        name = sha256(repr(array.shape).encode() + array.tobytes()).hexdigest()
        self.arrays[name] = array
        return name


def _is_of_bench(point: SweepPoint, name: str) -> bool:
    """Whether a method has a controller of this package; the keys of any other mean what its author says."""
    component = None if point.draft is None else point.draft.methods[name].controller
    return component is not None and component.code is None and is_built_in("controllers", component.kind)


def _limits(controller: Mapping[str, Any]) -> dict[str, tuple[float | None, float | None]]:
    """Return the limits of signals, hard and soft ones, that the keys of a controller name."""
    soft = controller.get("soft") or {}
    named = {**(controller.get("limits") or {}), **{name: keys.get("limits") for name, keys in soft.items()}}
    found: dict[str, tuple[float | None, float | None]] = {}
    for name, ends in named.items():
        if name.startswith("du") or not isinstance(ends, list) or len(ends) != 2:
            continue
        sides = [end if isinstance(end, list) else [end] for end in ends]
        n = max(map(len, sides))
        for i in range(n):
            low, high = (_number(side[i] if len(side) > i else side[0]) for side in sides)
            found[f"{name}.{i}" if n > 1 else name] = low, high
    return found


def _number(value: Any) -> float | None:
    """Return a finite number; anything else is no limit."""
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None


def _tuning(config: ExperimentConfig) -> StoredTuning | None:
    if config.tuning is None:
        return None
    searches = tuple((each.point, each.method, each.key) for each in config.tuning.searches)
    return StoredTuning(config.tuning.protocol, searches)


def _declared(config: ExperimentConfig) -> dict[str, dict[str, str]]:
    """Return the failures of checks that own components declare, by method; those of this package are in its tests."""
    found: dict[str, dict[str, str]] = {}
    for method in (method for point in config.points for method in point.experiment.methods):
        for design in (method.estimator, method.controller):
            if not type(design).__module__.startswith(BUILT_IN) and isinstance(design.expected_failures, Mapping):
                declared = {str(check): str(reason) for check, reason in design.expected_failures.items()}
                found.setdefault(method.name, {}).update(declared)
    return {name: declared for name, declared in found.items() if declared}


def _has_results(config: ExperimentConfig, store: Store, name: str) -> bool:
    """Whether there is something to show of a method at some point of the sweep."""
    stored = any(store.has_trials(point.method_keys[name]) for point in config.points)
    return stored or "runs" not in config.evaluate


def _series_key(point: SweepPoint, name: str) -> str:
    """Return what the series of a method depend on; those of an ensemble depend on all that its trials do."""
    if point.experiment.recording.ensemble:
        return point.method_keys[name]
    design = {key: value for key, value in point.methods[name].items() if key != "controller"}
    return digest([design, point.experiment.n_steps, point.experiment.plant.Ts, point.code[name]])
