"""The key `input`: a signal in open loop or, with `only`, that of some inputs beside a controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rmpc_bench.config.draft import AlreadyNoted, DraftConfig
from rmpc_bench.config.plant import refuse_runs
from rmpc_bench.config_file.component import Component
from rmpc_bench.registry import NONLINEAR
from rmpc_bench.simulation.open_loop import Fed
from rmpc_bench.types import DesignError, Plant, PlantInfo
from rmpc_bench.types.basics import declaring
from rmpc_bench.types.signals import indices_of


def check_input(draft: DraftConfig) -> None:
    """Report an input of all signals beside a controller, and one of some without a controller."""
    keys = {} if draft.input is None else draft.input.shared
    has_controller = "controller" in draft.tree or bool(draft.keys.with_controller)
    if "only" in keys and not has_controller:
        draft.note(["input", "only"], "needs a controller of the other inputs")
    elif "known" in keys and "only" not in keys:
        draft.note(["input", "known"], "has no effect without `only`")
    elif has_controller and draft.input is not None and "only" not in keys:
        where = "controller" if "controller" in draft.tree else f"methods.{draft.keys.with_controller[0]}.controller"
        message = f"replaces the controller of all methods; leave out `{where}` or the input, or give `only`"
        draft.note(["input"], message, key=True)


def _places(signal: Component, plant: Plant) -> list[int]:
    """Return the inputs that `only` names; a ConfigError where there is a wrong one, or none is left."""
    try:
        found = indices_of(signal.shared["only"], PlantInfo.of(plant).inputs, plant.nu, "input")
        if len(found) < plant.nu:
            return found
        raise DesignError("must leave an input out: the controller needs one of them", "only")
    except DesignError as error:
        raise signal.error(str(error), error.parameter) from None


def built_controller(
    draft: DraftConfig, controller: Component, plant: Plant | None, provided: Mapping[str, Any]
) -> Any:
    """Build a controller of all inputs, or of those beside the signal; a ConfigError where that is not possible."""
    component, model, estimator = draft.input, provided["model"], provided["estimator"]
    if component is None or "only" not in component.shared:
        return controller.build_law(**provided)
    if plant is None:
        raise AlreadyNoted
    places = _places(component, plant)
    if controller.code is not None:
        raise controller.error("a controller of your own returns all inputs; leave out `input`")
    signal = draft.problems.tried(component.build, nu=len(places), Ts=provided["Ts"], n_steps=provided["n_steps"])
    known, names = component.shared.get("known", True), PlantInfo.of(plant).inputs
    if known and estimator is not None:
        # What the disturbance adds to x(k+1) is a mean of the process noise, which laws use as an estimated one.
        estimator = declaring(estimator, estimates_mean=True)
    try:
        # A law that takes a nonlinear model uses none for d.
        is_linear = controller.kind not in NONLINEAR["controllers"]
        B = model.at(0).B[:, places] if is_linear else np.zeros((model.nx, len(places)))
    except DesignError as error:
        raise controller.error(f"beside `input` it needs a linear model: {error}", "kind") from None
    rest = [i for i in range(plant.nu) if i not in places]
    given = {**provided, "estimator": estimator, "measured": [names[i] for i in places] if known else ()}
    law = controller.build_law(inputs=rest, **given)
    if signal is None:
        raise AlreadyNoted
    refuse_runs(draft, signal.n_runs, "input.file")
    return Fed(law, signal, provided["n_steps"], places, rest, B if known else None, model.u_op[places])
