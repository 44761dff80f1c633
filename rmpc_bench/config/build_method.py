"""Builds the methods of a configuration: design model, estimator and controller of each."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, cast

from rmpc_bench.config.draft import DraftConfig, MethodComponents
from rmpc_bench.config.identity import nominal_plant
from rmpc_bench.config.recorded_data import refuse_other_sizes, refuse_runs_of_input
from rmpc_bench.config_file.component import Component
from rmpc_bench.diagnostics.stability import loop_remarks
from rmpc_bench.simulation.open_loop import OpenLoop, Rest
from rmpc_bench.simulation.scenario import initial_covariance, initial_state
from rmpc_bench.types import Array, DesignError, Method, Plant, PlantInfo


class DesignCache:
    """Designs that methods and points of a sweep share."""

    def __init__(self) -> None:
        self._designs: dict[str, Any] = {}

    def __len__(self) -> int:
        """Return the number of designs."""
        return len(self._designs)

    def get(self, description: Any, make: Callable[[], Any]) -> Any:
        """Return the design that plain data determine, made only once.

        Where `make` returns None it is called again next time, so that every error is reported.
        """
        key = json.dumps(description, sort_keys=True)
        if self._designs.get(key) is None:
            self._designs[key] = make()
        return self._designs[key]


class MethodBuilder:
    """Builds the methods of a draft; what cannot be built is None, with the reason in the problems of the draft.

    Parameters
    ----------
    draft : the sections of one point, with a valid time
    cache : designs of other points, to share; gets the new ones
    """

    def __init__(self, draft: DraftConfig, cache: DesignCache) -> None:
        self.draft, self.cache = draft, cache
        self.time = draft.values["time"]
        self.n_steps: int = self.time.n_steps
        self.plant: Plant | None = None
        """The nominal plant, for models made from it; set once it has been built."""

    def size(self) -> list[Any]:
        """Return the data that determine every design, besides its own keys."""
        return [self.time.step, self.n_steps, *(self.draft.initial[key] for key in ("x_hat", "P", "M"))]

    def model(self, component: Component | None) -> Any:
        """Build a design model; methods with equal models share one."""
        if component is None:
            return None
        size = {"Ts": self.time.step, "n_steps": self.n_steps}
        nominal = nominal_plant(self.draft, component)
        if component.takes("plant") and self.plant is None:
            # The plant has an error, which is reported there.
            return None
        # The disturbances of a model that depends on the state are checked at the initial estimate.
        start = self.draft.initial["x_hat"] if component.shared else None
        return self.cache.get(
            ["model", size, component.resolved(), nominal, start],
            lambda: self._model(component, {**size, "plant": self.plant}),
        )

    def undisturbed(self, component: Component | None) -> Any:
        """Build a design model without its disturbances, as the plant has none."""
        return self.model(None if component is None else component.without_shared())

    def _model(self, component: Component, provided: Mapping[str, Any]) -> Any:
        """Build a design model with its disturbances; methods with other disturbances share the model without them."""
        if not component.shared:
            return component.build(self.draft.problems, **provided)
        made, x_hat = self.undisturbed(component), self.draft.initial["x_hat"]
        if made is None or x_hat is None or self.sized("x_hat", initial_state, x_hat, made.nx) is None:
            return None
        return component.extended(made, self.draft.problems, n_steps=self.n_steps, x_hat=x_hat)

    def start(self, model: Any) -> dict[str, Array] | None:
        """Return x0, P0 and M0 of the estimators, for the size of a model."""
        given, P, undisturbed = self.draft.initial, self.draft.initial["P"], model.undisturbed
        if any(given[key] is None for key in ("x_hat", "P", "M")):
            return None
        nx = undisturbed.nx
        x0 = self.sized("x_hat", initial_state, given["x_hat"], nx)
        P0 = undisturbed.Q_w if isinstance(P, str) else self.sized("P", initial_covariance, P, nx)
        M0 = self.sized("M", initial_covariance, given["M"], nx)
        return None if x0 is None or P0 is None or M0 is None else model.start(x0, P0, M0)

    def sized(self, key: str, expand: Callable[[Any, int], Array], value: Any, n: int) -> Array | None:
        """Expand a short form under `initial`; a wrong size is reported there."""
        try:
            return expand(value, n)
        except DesignError as error:
            self.draft.note(["initial", key], str(error))
            return None

    def method(self, name: str, components: MethodComponents, plant: Plant | None) -> Method | None:
        """Build an estimator and a controller; points of a sweep with equal methods share one.

        The plant is disclosed to an estimator that takes it; it is None where it cannot be built.
        """
        named = {"model": components.model, "estimator": components.estimator, "controller": components.controller}
        described = {key: component.resolved() for key, component in named.items() if component is not None}
        applied = None if self.draft.input is None else self.draft.input.resolved()
        if plant is not None and plant.recorded is not None and self.draft.plant is not None:
            applied = self.draft.plant.resolved()
        nominal = nominal_plant(self.draft, components.model)
        description = ["method", name, self.size(), described, self._disclosed(components), applied, nominal]
        return cast("Method | None", self.cache.get(description, lambda: self._method(name, components, plant)))

    def _method(self, name: str, components: MethodComponents, plant: Plant | None) -> Method | None:
        problems, model = self.draft.problems, self.model(components.model)
        if model is None:
            return None
        start = self.start(model)
        info = None if plant is None else PlantInfo.of(plant)
        common = {"model": model, "n_steps": self.n_steps, "Ts": self.time.step, "plant_info": info}
        common["limits"] = None if info is None else info.limits
        estimator = None
        if components.estimator is not None and start is not None:
            estimator = self._estimator(components, {**common, **start, "plant": plant})
        if components.controller is None and components.controlled:
            return None
        if components.controller is None:
            controller: Any = self._open_loop(name, model, plant)
            if controller is None:
                return None
        elif estimator is None and components.controller.takes("estimator"):
            return None
        elif info is None and _is_informed(components.controller):
            return None
        else:
            controller = components.controller.build(problems, **common, estimator=estimator)
        if estimator is None or controller is None:
            return None
        remarks = () if isinstance(controller, Rest | OpenLoop) else loop_remarks(model, estimator, controller)
        return Method(name, estimator, controller, model.n_disturbances, remarks)

    def _open_loop(self, name: str, model: Any, plant: Plant | None) -> Any:
        """Return what stands for a controller where there is none; None where the input is invalid."""
        component = self.draft.input
        if self.draft.plant is not None and (plant is None or plant.recorded is not None):
            fits = plant is not None and not refuse_other_sizes(self.draft, name, model, plant)
            if not fits or plant is None or plant.recorded is None:
                return None
            return OpenLoop(plant.recorded.input, self.n_steps) if plant.nu else Rest(model.nu)
        if component is None:
            return None if "input" in self.draft.tree else Rest(model.nu)
        size = {"nu": model.nu, "Ts": self.time.step, "n_steps": self.n_steps}
        description = ["input", size, component.resolved()]
        signal = self.cache.get(description, lambda: component.build(self.draft.problems, **size))
        if signal is None:
            return None
        refuse_runs_of_input(self.draft, signal)
        return OpenLoop(signal, self.n_steps)

    def _estimator(self, components: MethodComponents, provided: Mapping[str, Any]) -> Any:
        """Build an estimator; methods and points with equal estimators share one."""
        estimator, model = components.estimator, components.model
        assert estimator is not None and model is not None
        if provided["plant"] is None and (estimator.takes("plant") or _is_informed(estimator)):
            return None
        disclosed, nominal = self._disclosed(components), nominal_plant(self.draft, model)
        description = ["estimator", self.size(), model.resolved(), estimator.resolved(), disclosed, nominal]
        return self.cache.get(description, lambda: estimator.build(self.draft.problems, **provided))

    def _disclosed(self, components: MethodComponents) -> Any:
        """Data of the plant that a method depends on: an estimator takes it, or a component takes its nominal data."""
        plant = self.draft.plant
        oracle = components.estimator is not None and components.estimator.takes("plant")
        parts = (components.estimator, components.controller)
        informed = any(part is not None and _is_informed(part) for part in parts)
        return plant.resolved() if plant is not None and (oracle or informed) else None


def _is_informed(component: Component) -> bool:
    """Whether a component takes nominal data of the plant."""
    return component.takes("plant_info") or component.takes("limits")
