"""First calls of a user's components, in a process of their own, before any run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rmpc_bench.components import probe
from rmpc_bench.components.first_call import Sample
from rmpc_bench.components.transport import dumps
from rmpc_bench.config.component import Component
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Method


def call_first(drafts: Sequence[DraftConfig], points: Sequence[SweepPoint | None]) -> None:
    """Simulate two samples of every method that has components from files; what is wrong is added to the drafts.

    An error is a problem at the component.  A call that takes too long is a warning, since it may be only slow.

    Parameters
    ----------
    drafts : the sections of every point
    points : what was built from them
    """
    seen: set[Any] = set()
    for draft, point in zip(drafts, points, strict=True):
        if point is None or draft.problems:
            continue
        for method in point.experiment.methods:
            named = _components(draft, method.name)
            files = tuple(each.references() for each in named.values())
            # Points of a sweep with the same files differ in numbers only.
            if any(files) and (method.name, files) not in seen:
                seen.add((method.name, files))
                _call(draft, point.experiment, method, named)


def _components(draft: DraftConfig, name: str) -> dict[str, Component]:
    """Return the plant, the estimator and the controller of a method."""
    parts = draft.methods[name]
    named = {"plant": draft.plant, "estimator": parts.estimator, "controller": parts.controller}
    return {role: each for role, each in named.items() if each is not None}


def _call(draft: DraftConfig, experiment: Experiment, method: Method, named: dict[str, Component]) -> None:
    r = experiment.scenario.reference.sample(method.controller.preview + 1)
    sample = Sample(experiment.scenario.x0, r, experiment.n_steps)
    answer = probe.ask({"first_call": dumps((experiment.plant, method, sample))})
    if answer.outcome == "done":
        if answer.value is not None and answer.value.role in named:
            component = named[answer.value.role]
            draft.problems.append(component.problem(answer.value.message))
        return
    component = named.get(answer.stage, next(each for each in named.values() if each.references()))
    if answer.outcome == "died":
        draft.problems.append(component.problem(f"its first call ends the process ({answer.reason})"))
        return
    text = (
        f"its first call takes longer than {probe.LIMIT:g} s; `execution: {{timeout: {{step: 10 s}}}}` ends such runs"
    )
    draft.warnings.append(component.problem(text))
