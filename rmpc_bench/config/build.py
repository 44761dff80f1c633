"""Stage 5, build: from the sections of every point to an Experiment, with every design made once, before any run.

An error that a design function raises is reported at its parameter.  The remaining designs are still made, so that all
errors are reported at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from rmpc_bench.config.build_method import DesignCache, MethodBuilder
from rmpc_bench.config.build_noise import NoiseLaws
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.first_calls import FirstCalls
from rmpc_bench.config.identity import sweep_point
from rmpc_bench.config.missing_measurements import refuse_unbridged
from rmpc_bench.config.model_facts import model_facts
from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config.plant_range import build_range, given_bounds, mean_start, refuse_start
from rmpc_bench.config.plausibility import warnings_of
from rmpc_bench.config.recorded_data import metric_problem, refuse_runs
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.config.uncertain_parameter import UncertainParameter
from rmpc_bench.config_file.component import Component
from rmpc_bench.received.names import wrong_metric
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.adversary import worst_sequence
from rmpc_bench.simulation.moments import exact_laws
from rmpc_bench.simulation.recording import has_bursts, with_bursts
from rmpc_bench.simulation.scenario import (
    Experiment,
    Recording,
    Scenario,
    initial_state,
)
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.types import (
    DesignError,
    Estimate,
    Method,
    Metric,
    MetricLayout,
    Plant,
    Problem,
    Reference,
)

AT_POINT = 1e-6
"""Relative difference up to which a reference is the output of an operating point."""


class _ExperimentBuilder:
    """Makes the designs of a draft; the errors of those that cannot be made are added to its problems.

    Parameters
    ----------
    draft : the sections of one point
    cache : designs of other points, to share; gets the new ones
    smoke : whether windows of metrics are cut where a run is too short for them
    """

    def __init__(self, draft: DraftConfig, cache: DesignCache, *, smoke: bool) -> None:
        self.draft, self.cache, self.smoke = draft, cache, smoke
        self.time = draft.values["time"]
        self.n_steps: int = self.time.n_steps
        self.methods = MethodBuilder(draft, cache)
        self.first_estimates: Mapping[str, Estimate | None] = {}

    def plant(self) -> Plant | None:
        """Build the plant and check the names under `perturb` and `set`."""
        component = self.draft.plant
        if component is None:
            return None
        size = {"Ts": self.time.step, "n_steps": self.n_steps}
        range_of = {"x0": mean_start(self.draft), "bounds": given_bounds(self.draft)}
        size |= {name: value for name, value in range_of.items() if component.takes(name)}
        description = ["plant", size, component.resolved()]
        plant: Plant | None = self.cache.get(description, lambda: component.build(self.draft.problems, **size))
        if plant is not None:
            refuse_runs(self.draft, plant)
            refuse_start(self.draft, plant)
            for name, change in self.draft.parameter_changes.items():
                if name not in plant.nominal:
                    message = unknown(name, plant.nominal, f"parameter of {component.kind}")
                    key = "perturb" if change.relative else "set"
                    self.draft.problems.append(Problem(*change.mark, f"plant.{key}.{name}", message))
        return plant

    def opposed(self, plant: Plant, methods: Sequence[Method | None], scenario: Scenario) -> Plant | None:
        """Return the plant with the sequence of its adversary, if it has one, against the method that it names."""
        if plant.opponent is None:
            return plant
        name, radius = plant.opponent
        path: list[str | int] = ["plant", "uncertainty", "against"]
        if name not in self.draft.methods:
            self.draft.note(path, unknown(name, self.draft.methods, "method"))
            return None
        method = next((method for method in methods if method is not None and method.name == name), None)
        if method is None:
            return None
        laws, schedule = exact_laws(plant, method, scenario), method.estimator.gain_schedule
        n_disturbances = method.n_disturbances
        if isinstance(laws, str) or schedule is None:
            self.draft.note(path, f"{name}: {laws}")
            return None
        components = self.draft.methods[name]
        described = [each.resolved() for each in (components.model, components.estimator) if each is not None]
        resolved = self.draft.plant.resolved() if self.draft.plant is not None else None
        key = ["opposed", self.methods.size(), resolved, described, [each.tolist() for each in laws]]
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
        x = draft.initial["x"]
        x0 = None if x is None else self.methods.sized("x", initial_state, x, plant.nx)
        laws = NoiseLaws(draft, lambda: self.methods.undisturbed(draft.model))
        x0_noise = laws.terms(draft.initial["laws"], plant.nx, "initial")
        process = laws.terms(draft.noise.get("process", ()), plant.nw, "process")
        measurement = laws.terms(draft.noise.get("measurement", ()), plant.nv, "measurement", plant.ny)
        if x0 is None or draft.values["seed"] is None or not set(draft.parameter_changes) <= set(plant.nominal):
            return None
        scenario = Scenario(
            seed=draft.values["seed"],
            uncertainty=draft.uncertainty,
            parameters={
                name: UncertainParameter(change.expression, plant.nominal[name] if change.relative else 1.0)
                for name, change in draft.parameter_changes.items()
            },
            x0=x0,
            x0_noise=x0_noise,
            process=process,
            measurement=measurement,
            reference=reference,
        )
        laws.refuse_names(scenario)
        return laws.correlated(plant, scenario)

    def call_first(self, plant: Plant, methods: Sequence[Method | None], scenario: Scenario, calls: FirstCalls) -> None:
        """Call the methods that have components from files of the user for two samples, and keep their estimates."""
        known = [method for method in methods if method is not None]
        self.first_estimates = calls.estimates(self.draft, plant, known, scenario, self.n_steps)

    def metric(self, component: Component, layout: MetricLayout) -> Metric | None:
        """Build a metric and report every reason for which it cannot be computed."""
        metric: Metric | None = component.build(self.draft.problems)
        reason = "" if metric is None or layout.plant is None else metric_problem(component, metric, layout.plant)
        if reason:
            self.draft.problems.append(component.problem(reason))
            return None
        issues = [] if metric is None else component.check(lambda: metric.check(layout))
        self.draft.problems += issues
        return None if issues else metric

    def metrics(self, plant: Plant, methods: tuple[Method, ...], scenario: Scenario | None) -> tuple[Metric, ...]:
        """Build the metrics; two of the same name are refused."""
        invalid = any(problem.path.startswith("noise") for problem in self.draft.problems)
        bursts = None if scenario is None or invalid else has_bursts(scenario)
        units = plant.y_unit, plant.u_unit
        r = None if scenario is None else scenario.reference.sample(self.n_steps + 1)
        layout = MetricLayout(
            self.n_steps, self.time.tick, *units, self.smoke, plant, methods, bursts, self.first_estimates, r
        )
        made = [self.metric(component, layout) for component in self.draft.metrics if component is not None]
        names: set[str] = set()
        for number, metric in enumerate(made):
            if metric is None:
                continue
            name = metric.name
            if name in names:
                self.draft.note(["metrics", number], f"{name!r} is given twice; give one a `name`")
            elif name in ("method", "run", "status", "n_failed"):
                message = f"{name!r} is a column of the tables already; choose another name"
                self.draft.note(["metrics", number], message)
            elif wrong_metric(name):
                self.draft.note(["metrics", number], f"{name!r} is no name: letters, digits and _, since claims use it")
            names.add(name)
        return tuple(metric for metric in made if metric is not None)

    def refuse_reference(self, reference: Reference, methods: Sequence[Method | None]) -> None:
        """Refuse a reference other than 0, or than the output of the operating point, for a regulator."""
        r = reference.sample(self.n_steps + 1)
        wrong: dict[str, list[str]] = {}
        for each in methods:
            if each is None or not each.controller.regulates:
                continue
            y = each.controller.regulates_to
            if y is None and r.any():
                wrong.setdefault("the state to 0", []).append(each.name)
            elif y is not None and not np.allclose(r, y, rtol=AT_POINT, atol=AT_POINT * float(np.abs(y).max())):
                numbers = ", ".join(f"{value:.9g}" for value in y)
                wrong.setdefault(f"to the operating point, y = {numbers},", []).append(each.name)
        for where, names in wrong.items():
            message = f"the controller of {', '.join(map(repr, names))} regulates {where} and follows no reference"
            self.draft.note(["reference"], message)

    def refuse_unreachable(self, reference: Reference, plant: Plant, scenario: Scenario | None) -> None:
        """Refuse a reference or an initial state outside the workspace of the plant."""
        reason = plant.unreachable(reference.sample(self.n_steps + 1))
        if reason is not None:
            self.draft.note(["reference"], reason)
        reason = plant.unreachable(scenario.x0[None, : plant.ny]) if scenario is not None else None
        if reason is not None:
            self.draft.note(["initial", "x"], reason)

    def recording(self, scenario: Scenario) -> Recording:
        """Return which signals of which runs are recorded."""
        keys, n_runs = self.draft.values["record"], self.draft.values["runs"]
        first = {"none": 0, "all": n_runs}.get(keys.runs, keys.runs)
        ensemble = not {"moments", "ensemble"}.isdisjoint(self.draft.values["evaluate"])
        plant = self.methods.plant
        # Recorded runs may have no state.
        absent = [name for name in ("x", "u") if plant is not None and getattr(plant, f"n{name}") == 0]
        without = [*absent, *(["u_command"] if "u" in absent else [])]
        signals = dict.fromkeys(name for name in keys.signals if name not in without)
        asked = Recording(tuple(signals), min(int(first), n_runs), ensemble)
        return with_bursts(asked, bursts=has_bursts(scenario))


def build(
    drafts: Sequence[DraftConfig],
    own: OwnCode,
    *,
    smoke: bool,
    cache: DesignCache | None = None,
    calls: FirstCalls | None = None,
) -> list[SweepPoint | None]:
    """Make every design of every point; None where one cannot be made, with the reasons in the problems of the draft.

    Points of a sweep share equal designs, also with earlier points by `cache` and `calls`.  `own` gets the files of the
    user that the points use.  In a smoke run windows of metrics are cut where a run is too short for them.
    """
    cache = DesignCache() if cache is None else cache
    calls = FirstCalls() if calls is None else calls
    points: list[SweepPoint | None] = []
    with single_thread():
        for draft in drafts:
            experiment = _experiment(draft, cache, calls, smoke=smoke, first=draft is drafts[0])
            points.append(None if experiment is None else sweep_point(draft, experiment, own))
    return points


def _experiment(
    draft: DraftConfig, cache: DesignCache, calls: FirstCalls, *, smoke: bool, first: bool
) -> Experiment | None:
    """Make all designs of one point; the first point of a sweep describes its models."""
    if draft.values["time"] is None:
        return None
    builder = _ExperimentBuilder(draft, cache, smoke=smoke)
    plant = builder.methods.plant = builder.plant()
    methods = [builder.methods.method(name, components, plant) for name, components in draft.methods.items()]
    if plant is None or draft.reference is None:
        return None
    reference = draft.reference.build(draft.problems, ny=plant.ny, Ts=plant.Ts)
    scenario = builder.scenario(plant, reference) if reference is not None else None
    if scenario is not None:
        builder.call_first(plant, methods, scenario, calls)
    metrics = builder.metrics(plant, tuple(method for method in methods if method is not None), scenario)
    if reference is None:
        return None
    builder.refuse_reference(reference, methods)
    builder.refuse_unreachable(reference, plant, scenario)
    state_range = build_range(draft, plant, None if scenario is None else scenario.x0)
    if scenario is not None:
        refuse_unbridged(draft, scenario, methods)
    opposed = builder.opposed(plant, methods, scenario) if scenario is not None else None
    if scenario is None or opposed is None or draft.problems or any(method is None for method in methods):
        return None
    pairs = tuple(method for method in methods if method is not None)
    recording = builder.recording(scenario)
    experiment = Experiment(
        opposed,
        pairs,
        scenario,
        metrics,
        n_runs=draft.values["runs"],
        n_steps=builder.n_steps,
        recording=recording,
        tick=builder.time.tick,
        cut_windows=builder.smoke,
        state_range=state_range,
    )
    draft.warnings += warnings_of(draft, experiment, builder.methods.undisturbed, builder.methods.start)
    if first:
        draft.model_facts = model_facts(draft, builder.methods.model)
    return experiment
