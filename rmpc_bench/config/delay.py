"""Late and missing measurements, and a late input: what a method knows of them, and which methods cannot have them.

An input that is late is also what a method needs whose y(k) depends on u(k).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rmpc_bench import registry
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.component import Component
from rmpc_bench.models.delay import NONE, SAME, known_delay
from rmpc_bench.models.flow import prediction_flow
from rmpc_bench.simulation.input_channel import least_delay
from rmpc_bench.simulation.open_loop import Fed, Held, OpenLoop, Rest
from rmpc_bench.simulation.scenario import Scenario
from rmpc_bench.types import DesignError, KnownDelay, Method, Model, Plant, PlantInfo


def delay_of(draft: DraftConfig, model: Component | None, plant: Plant | None) -> KnownDelay:
    """Return the delays that a design model knows; a ConfigError where they are invalid."""
    if model is None or plant is None:
        return KnownDelay()
    # A model made from the plant has its delays.
    given = model.shared.get("delay", SAME if model.kind in ("linearise", "nonlinear") else NONE)
    try:
        return known_delay(given, _input_delay(draft, plant.nu), PlantInfo.of(plant).outputs)
    except DesignError as error:
        raise model.error(str(error), error.parameter) from None


def _input_delay(draft: DraftConfig, nu: int) -> int | str:
    """Return the delay of the input in the noise; words where it is no number for all inputs."""
    total = 0
    for law in (term.law for term in draft.noise.of("input")):
        if law is None or law.kind != "delayed":
            continue
        samples, only = law.parameters["samples"], law.parameters["only"]
        bounds = {*(samples if isinstance(samples, list) else [samples])}
        if len(bounds) != 1:
            return "random"
        if only is not None and len(only) < nu:
            return "not that of all inputs"
        total += int(bounds.pop())
    return total


def with_prediction(method: Method, model: Model, controller: Component | None) -> Method:
    """Return a method with what its delay of the input needs; a ConfigError where its law allows none."""
    point, law = model.operating_point, method.controller
    method = method._replace(u_before=() if point is None else tuple(point.u.tolist()))
    if not method.delay.input or controller is None:
        return method
    try:
        if law.allows_delay:
            return method._replace(flow=prediction_flow(model) if law.uses_estimate else None)
        raise DesignError(*_without_delay(law, controller.kind))
    except DesignError as error:
        raise controller.error(str(error), error.parameter) from None


def _without_delay(law: Any, kind: str) -> tuple[str, str]:
    """Say what needs a model without delay, and return the key with the error."""
    found = ("lp-noise", "tuning.kind") if kind == "gpc" else (kind, "kind")
    if isinstance(law, Fed):
        found = f"{kind} beside `input`", "kind"
    elif isinstance(law, Held) and law.every > 1:
        found = "`every`", "every"
    return f"{found[0]} needs a model without delay", found[1]


def refuse_unbridged(draft: DraftConfig, scenario: Scenario, methods: Sequence[Method]) -> None:
    """Report estimators that bridge no missing measurements, or cannot use late ones, where there are some."""
    longest = sum(law.longest_delay for law in scenario.measurement)
    without: list[str] = []
    for each in methods:
        known, bridges = each.delay.measurement, each.estimator.bridges_missing
        late = longest if known is None else max(known, default=0)
        if late and not (bridges and each.estimator.repeats):
            message = f"the estimator of {each.name!r} cannot use late measurements"
            draft.note(["methods", each.name], f"{message}: `delay: none` gives it y as it arrives")
        elif late and not each.controller.allows_late_outputs:
            message = "its law needs the errors of a filter without late measurements: choose another, or `delay: none`"
            draft.note(["methods", each.name, "controller"], message)
        elif not bridges:
            without.append(repr(each.name))
    if without and any(law.omits_measurements for law in scenario.measurement):
        message = f"omits measurements, and the estimator of {', '.join(without)} cannot predict without one"
        draft.note(["noise", "measurement"], f"{message}; some that can: {', '.join(registry.BRIDGING)}")


def refuse_feedthrough(draft: DraftConfig, plant: Plant, scenario: Scenario, methods: Sequence[Method]) -> None:
    """Report methods whose y(k) depends on the u(k) that they compute from it."""
    late = least_delay(scenario.input, plant.nu)
    for each in methods:
        path: list[str | int] = ["methods", each.name]
        depends = plant.feedthrough or each.estimator.fed is not None
        if not depends or isinstance(each.controller, OpenLoop | Rest):
            continue
        if not late:
            key = next((key for key in ("D", "output", "scipy", "control") if key in draft.tree["plant"]), "kind")
            message = "y(k) depends on u(k), which the controller computes from y(k)"
            return draft.note(["plant", key], f"{message}: give it a sample, noise: {{input: {{delayed: 1}}}}")
        if not each.delay.input:
            draft.note(path, "y(k) depends on u(k): its design model needs `delay: same`, or {input: 1} or more")
        elif each.period is not None and each.controller.compares_estimate:
            draft.note(path, "its law compares angles with C x: y must not depend on u")
