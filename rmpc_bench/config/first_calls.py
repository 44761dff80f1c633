"""First calls of a user's components, in a process of their own, before any run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.component import Component
from rmpc_bench.simulation.scenario import Scenario
from rmpc_bench.types import Estimate, Method, Plant

if TYPE_CHECKING:
    from rmpc_bench.components.first_call import Sample


class FirstCalls:
    """The first calls of a configuration; points of a sweep with the same files share one."""

    def __init__(self) -> None:
        self._estimates: dict[Any, Estimate | None] = {}

    def estimates(
        self, draft: DraftConfig, plant: Plant, methods: Sequence[Method], scenario: Scenario, n_steps: int
    ) -> dict[str, Estimate | None]:
        """Simulate two samples of every method with components from files; what is wrong is added to the draft.

        An error is a problem at the component.  A call that takes too long is a warning, since it may be only slow.
        """
        found: dict[str, Estimate | None] = {}
        for method in methods:
            named = _components(draft, method.name)
            files = tuple(each.references() for each in named.values())
            if not any(files):
                continue
            # Points with the same files and sizes differ in numbers only, and so do the values that tuning tries.
            key = method.name.partition("~")[0], files, plant.nx, plant.nu, plant.ny
            if key not in self._estimates:
                # Imported here: a configuration without files of the user needs none of it.
                from rmpc_bench.components.first_call import Sample

                r = scenario.reference.sample(method.controller.preview + 2)
                self._estimates[key] = _called(draft, named, (plant, method, Sample(scenario.x0, r, n_steps)))
            found[method.name] = self._estimates[key]
        return found


def _components(draft: DraftConfig, name: str) -> dict[str, Component]:
    """Return the plant, the estimator and the controller of a method."""
    parts = draft.methods[name]
    named = {"plant": draft.plant, "estimator": parts.estimator, "controller": parts.controller}
    return {role: each for role, each in named.items() if each is not None}


def _called(draft: DraftConfig, named: dict[str, Component], call: tuple[Plant, Method, Sample]) -> Estimate | None:
    from rmpc_bench.components import probe
    from rmpc_bench.components.transport import dumps

    answer = probe.ask({"first_call": dumps(call)})
    if answer.outcome == "done":
        if answer.value is None:
            return None
        finding, estimate, seconds, warnings = answer.value
        _keep(call, seconds, warnings)
        if finding is not None and finding.role in named:
            draft.problems.append(named[finding.role].problem(finding.message))
        return estimate if estimate is None else Estimate(*estimate)
    component = named.get(answer.stage, next(each for each in named.values() if each.references()))
    if answer.outcome == "died":
        draft.problems.append(component.problem(f"its first call ends the process ({answer.reason})"))
        return None
    text = f"its first call takes longer than {probe.LIMIT:g} s; `execution.timeout` ends runs that take too long"
    draft.warnings.append(component.problem(text))
    return None


def _keep(
    call: tuple[Plant, Method, Sample], seconds: Mapping[str, float], warnings: Mapping[str, tuple[str, ...]]
) -> None:
    """Note what components written for one run cost, for the estimate of the computing time, and their warnings."""
    from rmpc_bench.components.single_design import SingleDesign

    plant, method, _ = call
    for role, design in (("plant", plant), ("estimator", method.estimator), ("controller", method.controller)):
        if isinstance(design, SingleDesign):
            design.seconds_per_step = seconds.get(role, design.seconds_per_step)
            more = [text for text in warnings.get(role, ()) if text not in design.remarks]
            design.__dict__["remarks"] = (*design.remarks, *more)
