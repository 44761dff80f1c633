"""The designs of a method: its model, its estimator and its controller, or what stands in place of one."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from rmpc_bench.config.delay import delay_of, with_prediction
from rmpc_bench.config.draft import AlreadyNoted, DraftConfig, MethodComponents
from rmpc_bench.config.identity import ModelFacts
from rmpc_bench.config.input import built_controller
from rmpc_bench.config.plant import mean_start, refuse_other_sizes, refuse_runs
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.tree import Problems, error_at
from rmpc_bench.diagnostics.stability import loop_remarks
from rmpc_bench.simulation.open_loop import OpenLoop, Rest
from rmpc_bench.simulation.scenario import initial_covariance, initial_state
from rmpc_bench.types import Array, DesignError, KnownDelay, Method, Plant, PlantInfo
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
        delay = self.draft.problems.tried(delay_of, self.draft, components.model, plant)
        parts = [*components.named.values(), self.draft.input]
        key = [name, delay, *self.key("method", parts, of_plant=is_recorded), self.draft.limits.angles]
        return cast("Method", self.cache.get(key, lambda: self._method(name, components, plant, delay)))

    def _method(self, name: str, components: MethodComponents, plant: Plant | None, delay: KnownDelay | None) -> Method:
        model, info = self.model(components.model), None if plant is None else PlantInfo.of(plant)
        common = {"model": model, "n_steps": self.n_steps, "Ts": self.time.step, "plant_info": info}
        common["limits"] = None if info is None else info.limits
        # The errors of an estimator hide none of the controller.
        estimator = self.draft.problems.tried(self._estimator, components, common, plant)
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
            if self.draft.keys.with_controller or "controller" in self.draft.tree:  # otherwise `check_input` says so
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
