"""Stage 5, build: from the sections of every point to an Experiment, with every design made once, before any run.

An error that a design function raises is reported at its parameter.  The remaining designs are still made, so that all
errors are reported at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

from rmpc_bench.config.delay import refuse_feedthrough, refuse_unbridged
from rmpc_bench.config.designs import DesignCache, MethodBuilder
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.identity import Built, sweep_point
from rmpc_bench.config.noise import UNCERTAIN_MATRIX, NoiseLaws
from rmpc_bench.config.own_code import FirstCalls, OwnCode
from rmpc_bench.config.plant import (
    UncertainParameter,
    angles_of,
    build_range,
    given_bounds,
    mean_start,
    metric_problem,
    refuse_reference,
    refuse_runs,
    refuse_start,
    refuse_unreachable,
)
from rmpc_bench.config.warnings import warnings_of
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Map, locate
from rmpc_bench.received.names import wrong_metric
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.adversary import worst_sequence
from rmpc_bench.simulation.moments import exact_laws
from rmpc_bench.simulation.recording import has_bursts, with_bursts
from rmpc_bench.simulation.scenario import Experiment, Recording, Scenario, initial_state
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.types import DesignError, Estimate, Method, Metric, MetricLayout, Plant, PlantInfo, Problem, Reference


def _metric(component: Component, layout: MetricLayout) -> Metric:
    """Build a metric; a ConfigError has every reason for which it cannot be computed."""
    metric: Metric = component.build()
    reason = "" if layout.plant is None else metric_problem(component, metric, layout.plant)
    if reason:
        raise component.error(reason)
    component.check(lambda: metric.check(layout))
    return metric


def _calibration(draft: DraftConfig, nx: int) -> tuple[Component, ...]:
    """Return the metrics of each level of `calibration`, for all states and, of several, each; none after an error."""
    keys, path = draft.keys.calibration, ["calibration"]
    if keys is None or any(problem.path.startswith("calibration") for problem in draft.problems):
        return ()
    found, mark = [], locate(draft.tree, path)
    for of in ("joint", *(f"x.{i}" for i in range(nx) if nx > 1)):
        for level in keys.levels:
            given = {"kind": "coverage", "name": keys.name(level, of), "level": level, "of": of}
            given |= {} if keys.from_ is None else {"from": keys.from_}
            found.append(draft.component("metrics", Map(given, mark=mark), path))
    return tuple(component for component in found if component is not None)


class _ExperimentBuilder:
    """Makes the designs of a draft; the errors of those that cannot be made are added to its problems.

    The cache shares designs with other points.  In a `smoke` run windows of metrics are cut where a run is too short.
    """

    def __init__(self, draft: DraftConfig, cache: DesignCache, *, smoke: bool) -> None:
        self.draft, self.cache, self.smoke, self.time = draft, cache, smoke, draft.time
        self.n_steps = self.time.n_steps
        self.calibration: tuple[Component, ...] = ()
        self.methods = MethodBuilder(draft, cache)
        self.first_estimates: Mapping[str, Estimate | None] = {}

    def experiment(self, calls: FirstCalls) -> Experiment | None:
        """Make all designs of the point."""
        draft = self.draft
        plant = self.methods.plant = self.plant()
        made = [draft.problems.tried(self.methods.method, name, each, plant) for name, each in draft.methods.items()]
        methods = tuple(method for method in made if method is not None)
        if plant is None or draft.reference is None:
            return None
        reference: Reference | None = draft.problems.tried(draft.reference.build, ny=plant.ny, Ts=plant.Ts)
        scenario = self.scenario(plant, reference) if reference is not None else None
        if scenario is not None:
            self.first_estimates = calls.estimates(draft, plant, methods, scenario, self.n_steps)
        metrics = self.metrics(plant, methods, scenario)
        if reference is None:
            return None
        r = reference.sample(self.n_steps + 1)
        refuse_reference(draft, r, methods)
        refuse_unreachable(draft, r, plant, None if scenario is None else scenario.x0)
        state_range = build_range(draft, plant, None if scenario is None else scenario.x0)
        if scenario is None:
            return None
        refuse_unbridged(draft, scenario, methods)
        refuse_feedthrough(draft, plant, scenario, methods)
        opposed = self.opposed(plant, methods, scenario)
        if opposed is None or draft.keys.runs is None or draft.problems or len(methods) < len(made):
            return None
        return Experiment(
            opposed,
            methods,
            scenario,
            metrics,
            n_runs=draft.keys.runs,
            n_steps=self.n_steps,
            recording=self.recording(scenario, draft.keys.runs),
            tick=self.time.tick,
            cut_windows=self.smoke,
            state_range=state_range,
            time_unit=self.time.unit,
            angles=self.methods.angles,
        )

    def plant(self) -> Plant | None:
        """Build the plant and check the names under `perturb` and `set`."""
        component = self.draft.plant
        if component is None:
            return None
        size = {"Ts": self.time.step, "n_steps": self.n_steps, "time_unit": self.time.unit}
        size |= {"angles": self.draft.limits.angles}
        range_of = {"x0": mean_start(self.draft), "bounds": given_bounds(self.draft)}
        size |= {name: value for name, value in range_of.items() if component.takes(name)}
        described = self.methods.key("plant", [], of_plant=True, start=())
        plant: Plant | None = self.draft.problems.tried(self.cache.get, described, lambda: component.build(**size))
        if plant is not None:
            refuse_runs(self.draft, plant.recorded and plant.recorded.n_runs, "plant.data")
            refuse_start(self.draft, plant)
            self.methods.angles = angles_of(self.draft, plant)
            for name, change in self.draft.changes.items():
                if name not in plant.nominal:
                    key = "perturb" if change.relative else "set"
                    message = unknown(name, plant.nominal, f"parameter of {component.kind}")
                    if not plant.nominal:
                        without = f"{component.kind} has no named parameters"
                        message = f"{without}; {UNCERTAIN_MATRIX}, or take an `ode` with `perturb`"
                    self.draft.problems.append(Problem(*change.mark, f"plant.{key}.{name}", message))
        return plant

    def opposed(self, plant: Plant, methods: Sequence[Method], scenario: Scenario) -> Plant | None:
        """Return the plant with the sequence of its adversary, if it has one, against the method that it names."""
        if plant.opponent is None:
            return plant
        name, radius = plant.opponent
        path: list[str | int] = ["plant", "uncertainty", "against"]
        if name not in self.draft.methods:
            self.draft.note(path, unknown(name, self.draft.methods, "method"))
            return None
        method = next((method for method in methods if method.name == name), None)
        if method is None:
            return None
        laws, schedule = exact_laws(plant, method, scenario), method.estimator.gain_schedule
        if not isinstance(laws, str) and laws.u is not None:
            laws = "there is an input"
        n_disturbances = method.n_disturbances
        if isinstance(laws, str) or schedule is None:
            self.draft.note(path, f"{name}: {laws}")
            return None
        components = self.draft.methods[name]
        described = self.methods.key("opposed", [components.model, components.estimator], of_plant=True)
        key = [*described, [each.tolist() for each in laws[:4]]]
        try:
            made = self.cache.get(
                key, lambda: plant.against(worst_sequence(plant, schedule, laws, self.n_steps, radius, n_disturbances))
            )
        except DesignError as error:
            self.draft.note(path, f"{name}: {error}")
            return None
        return cast("Plant", made)

    def scenario(self, plant: Plant, reference: Reference) -> Scenario | None:
        """Collect the random inputs of a run and the reference."""
        draft = self.draft
        x0 = draft.problems.tried(self.methods.sized, "x", initial_state, draft.initial.x, plant.nx)
        laws = NoiseLaws(draft, lambda: draft.problems.tried(self.methods.undisturbed, draft.model), plant)
        x0_noise = laws.terms(draft.initial.laws, plant.nx, "initial")
        process = laws.terms(draft.noise.of("process"), plant.nw, "process")
        info = PlantInfo.of(plant)
        measurement = laws.terms(draft.noise.of("measurement"), plant.nv, "measurement", info.outputs)
        of_input = laws.terms(draft.noise.of("input"), plant.nu, "input", info.inputs)
        if x0 is None or draft.keys.seed is None or not set(draft.changes) <= set(plant.nominal):
            return None
        scenario = Scenario(
            seed=draft.keys.seed,
            uncertainty=draft.uncertainty.scaled,
            parameters={
                name: UncertainParameter(change.expression, plant.nominal[name] if change.relative else 1.0)
                for name, change in draft.changes.items()
            },
            x0=x0,
            x0_noise=x0_noise,
            process=process,
            measurement=measurement,
            reference=reference,
            input=of_input,
        )
        laws.refuse_names(scenario)
        return laws.correlated(plant, scenario)

    def metrics(self, plant: Plant, methods: tuple[Method, ...], scenario: Scenario | None) -> tuple[Metric, ...]:
        """Build the metrics; two of the same name are refused."""
        invalid = any(problem.path.startswith("noise") for problem in self.draft.problems)
        bursts = None if scenario is None or invalid else has_bursts(scenario)
        units, time = (plant.y_unit, plant.u_unit), self.time
        r = None if scenario is None else scenario.reference.sample(self.n_steps + 1)
        layout = MetricLayout(
            self.n_steps, time.tick, *units, self.smoke, plant, methods, bursts, self.first_estimates, r, time.unit
        )
        tried = self.draft.problems.tried
        made = [None if each is None else tried(_metric, each, layout) for each in self.draft.metrics]
        self.calibration = _calibration(self.draft, plant.nx)
        for component in self.calibration:
            made.append(tried(_metric, component, layout))
            if made[-1] is None:
                # The others have the same error.
                break
        names: set[str] = set()
        for number, metric in enumerate(made):
            if metric is None:
                continue
            name = metric.name
            if name in names:
                path: list[str | int] = ["metrics", number] if number < len(self.draft.metrics) else ["calibration"]
                self.draft.note(path, f"{name!r} is given twice; give one a `name`")
            elif name in ("method", "run", "status", "n_failed"):
                message = f"{name!r} is a column of the tables already; choose another name"
                self.draft.note(["metrics", number], message)
            elif wrong_metric(name):
                self.draft.note(["metrics", number], f"{name!r} is no name: letters, digits and _, since claims use it")
            names.add(name)
        return tuple(metric for metric in made if metric is not None)

    def recording(self, scenario: Scenario, n_runs: int) -> Recording:
        """Return which signals of which runs are recorded."""
        keys = self.draft.keys.record
        assert keys is not None
        first = n_runs if keys.runs == "all" else 0 if keys.runs == "none" else keys.runs
        ensemble = not {"moments", "ensemble"}.isdisjoint(self.draft.keys.evaluate)
        plant = self.methods.plant
        # Recorded runs may have no state.
        absent = [name for name in ("x", "u") if plant is not None and getattr(plant, f"n{name}") == 0]
        without = [*absent, *(["u_command"] if "u" in absent else [])]
        signals = dict.fromkeys(name for name in keys.signals if name not in without)
        asked = Recording(tuple(signals), min(first, n_runs), ensemble)
        return with_bursts(asked, bursts=has_bursts(scenario))


def build(
    drafts: Sequence[DraftConfig],
    own: OwnCode,
    *,
    smoke: bool,
    cache: DesignCache | None = None,
    calls: FirstCalls | None = None,
) -> list[Built]:
    """Make every design of every point; the reasons for which one cannot be made are in the problems of the draft.

    Points of a sweep share equal designs, also with earlier points by `cache` and `calls`.  `own` gets the files of the
    user that the points use.  In a smoke run windows of metrics are cut where a run is too short for them.
    """
    cache = DesignCache() if cache is None else cache
    calls = FirstCalls() if calls is None else calls
    with single_thread():
        return [_built(draft, own, cache, calls, smoke=smoke, first=draft is drafts[0]) for draft in drafts]


def _built(
    draft: DraftConfig, own: OwnCode, cache: DesignCache, calls: FirstCalls, *, smoke: bool, first: bool
) -> Built:
    """Make every design of a point; the first one describes its models."""
    if draft.keys.time is None:
        return Built(None)
    builder = _ExperimentBuilder(draft, cache, smoke=smoke)
    experiment, methods = builder.experiment(calls), builder.methods
    if experiment is None:
        return Built(None, builder.calibration)
    draft.warnings.extend(warnings_of(draft, experiment, methods))
    point = sweep_point(draft, experiment, builder.calibration, own)
    return Built(point, builder.calibration, methods.facts() if first else ())
