"""Stage 5, build: from the sections of every point to an Experiment, with every design made once, before any run.

An error that a design function raises is reported at its parameter.  The remaining designs are still made, so that all
errors are reported at once.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from rmpc_bench.config.draft import AlreadyNoted, DraftConfig, MethodComponents
from rmpc_bench.config.identity import Built, ModelFacts, sweep_point
from rmpc_bench.config.input import built_controller
from rmpc_bench.config.noise import (
    UNCERTAIN_MATRIX,
    NoiseLaws,
    delay_of,
    refuse_feedthrough,
    refuse_unbridged,
    with_prediction,
)
from rmpc_bench.config.own_code import FirstCalls, OwnCode
from rmpc_bench.config.plant import (
    UncertainParameter,
    angles_of,
    build_range,
    given_bounds,
    mean_start,
    metric_problem,
    refuse_other_sizes,
    refuse_reference,
    refuse_runs,
    refuse_start,
    refuse_unreachable,
)
from rmpc_bench.config.warnings import warnings_of
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Map, Problems, error_at, locate
from rmpc_bench.diagnostics.stability import loop_remarks
from rmpc_bench.received.names import wrong_metric
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.adversary import worst_sequence
from rmpc_bench.simulation.moments import exact_laws
from rmpc_bench.simulation.open_loop import OpenLoop, Rest
from rmpc_bench.simulation.recording import has_bursts, with_bursts
from rmpc_bench.simulation.scenario import Experiment, Recording, Scenario, initial_covariance, initial_state
from rmpc_bench.simulation.threads import single_thread
from rmpc_bench.types import (
    Array,
    DesignError,
    Estimate,
    KnownDelay,
    Method,
    Metric,
    MetricLayout,
    Plant,
    PlantInfo,
    Problem,
    Reference,
)
from rmpc_bench.types.angles import period_of, places


class DesignCache:
    """Designs that methods and points of a sweep share."""

    def __init__(self) -> None:
        self._designs: dict[str, Any] = {}

    def __len__(self) -> int:
        """Return the number of designs."""
        return len(self._designs)

    def get(self, description: Any, make: Callable[[], Any]) -> Any:
        """Return the design that plain data determine, made once; after an error again, so that it is reported."""
        key = json.dumps(description, sort_keys=True)
        if key not in self._designs:
            self._designs[key] = make()
        return self._designs[key]


START = ("x_hat", "P", "M")  # keys under `initial` that say where the estimators start


class MethodBuilder:
    """Builds the methods of a draft with a valid time; the cache shares designs with other points.

    What cannot be built raises a ConfigError; it has no problems where something invalid is needed.
    """

    def __init__(self, draft: DraftConfig, cache: DesignCache) -> None:
        self.draft, self.cache, self.time = draft, cache, draft.time
        self.n_steps = self.time.n_steps
        self.plant: Plant | None = None  # the nominal plant, for models made from it; set once it has been built
        self.angles: Mapping[str, float] = {}  # places of its angles with their periods

    def key(
        self, role: str, parts: Sequence[Component | None], *, of_plant: bool = False, start: Sequence[str] = START
    ) -> list[Any]:
        """Return all plain data that designs made of some components depend on, for the cache.

        The plant is among them, with its bounds and its start, where it is asked for or where a component takes it.
        """
        plant = self.draft.plant
        of_plant = of_plant or any(part and (part.takes("plant") or _is_informed(part)) for part in parts)
        nominal = None
        if of_plant and plant is not None:
            nominal = [plant.resolved(), self.draft.limits.data]
            # Only such a plant depends on it; others are shared by all starts.
            nominal += [mean_start(self.draft)] if plant.takes("x0") else []
        given = [None if part is None else part.resolved() for part in parts]
        time = self.time.step, self.time.unit, self.n_steps
        return [role, *time, given, nominal, [self.draft.initial.start[key] for key in start]]

    def model(self, component: Component | None) -> Any:
        """Build a design model; methods with equal models share one."""
        if component is None or (component.takes("plant") and self.plant is None):
            raise AlreadyNoted
        size = {"Ts": self.time.step, "n_steps": self.n_steps, "time_unit": self.time.unit}
        # A delay is known to a method, and changes no matrix.
        component = component.without_shared("delay")
        # The disturbances of a model that depends on the state are checked at the initial estimate.
        key = self.key("model", [component], start=("x_hat",) if component.shared else ())
        return self.cache.get(key, lambda: self._model(component, {**size, "plant": self.plant}))

    def undisturbed(self, component: Component | None) -> Any:
        """Build a design model without its disturbances, as the plant has none."""
        return self.model(None if component is None else component.without_shared())

    def _model(self, component: Component, provided: Mapping[str, Any]) -> Any:
        """Build a design model with its disturbances; methods with other disturbances share the model without them."""
        if not component.shared:
            return component.build(**provided)
        made, x_hat = self.undisturbed(component), self.draft.initial.x_hat
        self.sized("x_hat", initial_state, x_hat, made.nx)
        return component.extended(made, n_steps=self.n_steps, x_hat=x_hat)

    def start(self, model: Any) -> Any:
        """Return x0, P0 and M0 of the estimators by their names, for the size of a model."""
        given, undisturbed, problems = self.draft.initial, model.undisturbed, Problems()
        if any(value is None for value in given.start.values()):
            raise AlreadyNoted
        nx = undisturbed.nx
        x0 = problems.tried(self.sized, "x_hat", initial_state, given.x_hat, nx)
        of_process = isinstance(given.P, str)
        P0 = undisturbed.Q_w if of_process else problems.tried(self.sized, "P", initial_covariance, given.P, nx)
        M0 = problems.tried(self.sized, "M", initial_covariance, given.M, nx)
        problems.stop()
        return model.start(x0, P0, M0)

    def facts(self) -> tuple[ModelFacts, ...]:
        """Return what every design model says about itself, such as an operating point, for a draft without errors."""
        found: dict[str, ModelFacts] = {}
        for name, components in self.draft.methods.items():
            where = "model" if components.model is self.draft.model else f"methods.{name}.model"
            made = self.model(components.model)
            if where not in found:
                found[where] = ModelFacts(where, tuple(made.facts()), tuple(made.remarks))
        return tuple(each for each in found.values() if each.facts or each.remarks)

    def sized(self, key: str, expand: Callable[[Any, int], Array], value: Any, n: int) -> Array:
        """Expand a short form under `initial`; a wrong size is an error there."""
        if value is None:
            raise AlreadyNoted
        try:
            return expand(value, n)
        except DesignError as error:
            raise error_at(self.draft.tree, ["initial", key], str(error)) from None

    def method(self, name: str, components: MethodComponents, plant: Plant | None) -> Method:
        """Build an estimator and a controller; points of a sweep with equal methods share one.

        The plant is disclosed to an estimator that takes it; it is None where it cannot be built.
        """
        # Recorded runs have their inputs in the plant.
        is_recorded = plant is not None and plant.recorded is not None
        # An invalid delay hides no error of a design.
        delay = self.draft.tried(delay_of, self.draft, components.model, plant)
        parts = [*components.named.values(), self.draft.input]
        key = [name, delay, *self.key("method", parts, of_plant=is_recorded), self.draft.limits.angles]
        return cast("Method", self.cache.get(key, lambda: self._method(name, components, plant, delay)))

    def _method(self, name: str, components: MethodComponents, plant: Plant | None, delay: KnownDelay | None) -> Method:
        model, info = self.model(components.model), None if plant is None else PlantInfo.of(plant)
        common = {"model": model, "n_steps": self.n_steps, "Ts": self.time.step, "plant_info": info}
        common["limits"] = None if info is None else info.limits
        # The errors of an estimator hide none of the controller.
        estimator = self.draft.tried(self._estimator, components, common, plant)
        controller = self._controller(name, components, {**common, "estimator": estimator}, plant)
        if estimator is None or delay is None:
            raise AlreadyNoted
        remarks = () if isinstance(controller, Rest | OpenLoop) else loop_remarks(model, estimator, controller)
        made = Method(name, estimator, controller, model.n_disturbances, remarks, delay)
        period = model.undisturbed.y_period
        period = period_of(self.angles, places("y", model.ny)) if period is None else period
        if period is not None:
            made = made._replace(controller=controller.with_period(period), period=period, model=model)
        return with_prediction(made, model, components.controller)

    def _controller(
        self, name: str, components: MethodComponents, provided: Mapping[str, Any], plant: Plant | None
    ) -> Any:
        """Build a controller, or what stands for one where there is none."""
        controller = components.controller
        if controller is None:
            if components.controlled:
                raise AlreadyNoted
            return self._open_loop(name, provided["model"], plant)
        needs_estimator = provided["estimator"] is None and controller.takes("estimator")
        if needs_estimator or (plant is None and _is_informed(controller)):
            raise AlreadyNoted
        return built_controller(self.draft, controller, plant, provided)

    def _open_loop(self, name: str, model: Any, plant: Plant | None) -> OpenLoop | Rest:
        """Return what stands for a controller where there is none."""
        component = self.draft.input
        if self.draft.plant is not None and (plant is None or plant.recorded is not None):
            if plant is None or plant.recorded is None or refuse_other_sizes(self.draft, name, model, plant):
                raise AlreadyNoted
            return OpenLoop(plant.recorded.input, self.n_steps) if plant.nu else Rest(model.nu)
        if component is not None and "only" in component.shared:
            if self.draft.with_controller or "controller" in self.draft.tree:  # otherwise `check_input` says so
                self.draft.note(["input", "only"], f"needs a controller of the other inputs, which {name!r} has not")
            raise AlreadyNoted
        if component is None and "input" in self.draft.tree:
            raise AlreadyNoted
        if component is None:
            return Rest(model.nu)
        size = {"nu": model.nu, "Ts": self.time.step, "n_steps": self.n_steps}
        key = [model.nu, *self.key("input", [component], start=())]
        signal = self.cache.get(key, lambda: component.build(**size))
        refuse_runs(self.draft, signal.n_runs, "input.file")
        return OpenLoop(signal, self.n_steps)

    def _estimator(self, components: MethodComponents, common: Mapping[str, Any], plant: Plant | None) -> Any:
        """Build an estimator; methods and points with equal estimators share one."""
        start, estimator = self.start(common["model"]), components.estimator
        if estimator is None or (plant is None and (estimator.takes("plant") or _is_informed(estimator))):
            raise AlreadyNoted
        key = self.key("estimator", [components.model, estimator])
        return self.cache.get(key, lambda: estimator.build(**common, **start, plant=plant))


def _is_informed(component: Component) -> bool:
    """Whether a component takes nominal data of the plant."""
    return component.takes("plant_info") or component.takes("limits")


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
        made = [draft.tried(self.methods.method, name, each, plant) for name, each in draft.methods.items()]
        methods = tuple(method for method in made if method is not None)
        if plant is None or draft.reference is None:
            return None
        reference: Reference | None = draft.tried(draft.reference.build, ny=plant.ny, Ts=plant.Ts)
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
        plant: Plant | None = self.draft.tried(self.cache.get, described, lambda: component.build(**size))
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
        x0 = draft.tried(self.methods.sized, "x", initial_state, draft.initial.x, plant.nx)
        laws = NoiseLaws(draft, lambda: draft.tried(self.methods.undisturbed, draft.model), plant)
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
        made = [self.draft.tried(_metric, each, layout) for each in self.draft.metrics if each is not None]
        self.calibration = _calibration(self.draft, plant.nx)
        for component in self.calibration:
            made.append(self.draft.tried(_metric, component, layout))
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
        first = {"none": 0, "all": n_runs}.get(keys.runs, keys.runs)
        ensemble = not {"moments", "ensemble"}.isdisjoint(self.draft.keys.evaluate)
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
    draft.warnings.extend(warnings_of(draft, experiment, methods.undisturbed, methods.start))
    point = sweep_point(draft, experiment, builder.calibration, own)
    return Built(point, builder.calibration, methods.facts() if first else ())
