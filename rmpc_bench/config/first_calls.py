"""First calls of a user's components before any run, for the points of a sweep and the rounds of tuning."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config_file.component import Component
from rmpc_bench.simulation.scenario import Scenario
from rmpc_bench.types import Controller, Estimate, Estimator, Method, Plant

if TYPE_CHECKING:
    from rmpc_bench.components.first_call import Sample


class FirstCalls:
    """The first calls of a configuration; points of a sweep with the same files share one.

    Parameters
    ----------
    left_out : whether no code is called, since the process that asks has done it
    """

    def __init__(self, *, left_out: bool = False) -> None:
        self.left_out = left_out
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
                sample = Sample(scenario.x0, r, n_steps)
                self._estimates[key] = None if self.left_out else _called(draft, named, plant, method, sample)
            found[method.name] = self._estimates[key]
        return found


def _components(draft: DraftConfig, name: str) -> dict[str, Component]:
    """Return the plant, the estimator and the controller of a method."""
    parts = draft.methods[name]
    named = {"plant": draft.plant, "estimator": parts.estimator, "controller": parts.controller}
    return {role: each for role, each in named.items() if each is not None}


def _called(
    draft: DraftConfig, named: dict[str, Component], plant: Plant, method: Method, sample: Sample
) -> Estimate | None:
    from rmpc_bench.components.first_call import first_call

    answer = first_call(plant, method, sample)
    if answer.too_long is not None:
        component = named.get(answer.too_long.role, next(each for each in named.values() if each.references()))
        draft.warnings.append(component.problem(answer.too_long.message))
        return None
    for role, design in (("plant", plant), ("estimator", method.estimator), ("controller", method.controller)):
        _keep(design, answer.seconds.get(role), answer.warnings.get(role, ()))
    if answer.finding is not None and answer.finding.role in named:
        draft.problems.append(named[answer.finding.role].problem(answer.finding.message))
    return answer.estimate


def _keep(design: Plant | Estimator | Controller, seconds: float | None, warnings: tuple[str, ...]) -> None:
    """Note what a component written for one run costs, for the estimate of the computing time, and its warnings."""
    from rmpc_bench.components.single_design import SingleDesign

    if isinstance(design, SingleDesign):
        design.seconds_per_step = design.seconds_per_step if seconds is None else seconds
        more = [text for text in warnings if text not in design.remarks]
        design.__dict__["remarks"] = (*design.remarks, *more)
