"""Checks of the components of a user in an experiment, on the linear system that their design model describes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from rmpc_bench.components.transport import Recipe, recipe_of
from rmpc_bench.conformance.experiment_example import ExperimentSystem
from rmpc_bench.conformance.linear_system import LinearSystem
from rmpc_bench.conformance.report import Report
from rmpc_bench.conformance.subject import Subject
from rmpc_bench.conformance.supervisor import check_subject
from rmpc_bench.simulation.scenario import Experiment

NOT_LINEAR = "the design model is not linear"


PARTLY = "in the experiment itself, because its design model is not linear"


class OwnComponent(NamedTuple):
    """A component of a user in a method."""

    method: str
    text: str
    """File and name, or the registered kind."""
    report: Report | None
    """None where it cannot be checked."""
    reason: str = ""
    """Why it cannot be checked, or not on a linear system."""


def check_own_components(experiment: Experiment) -> Iterator[OwnComponent]:
    """Check the estimators and controllers that are not built in; equal ones once.

    Parameters
    ----------
    experiment : with its designs
    """
    seen: set[tuple[Any, ...]] = set()
    for method in experiment.methods:
        for design in (method.estimator, method.controller):
            recipe = recipe_of(design)
            if recipe is None:
                continue
            # Methods may have equal components of their own.
            key = recipe.code, recipe.design, repr(recipe.parameters), id(recipe.provided.get("model"))
            if key in seen:
                continue
            seen.add(key)
            yield _checked(method.name, recipe, experiment)


def _checked(method: str, recipe: Recipe, experiment: Experiment) -> OwnComponent:
    text = recipe.code.text if recipe.code is not None else getattr(recipe.design, "__name__", recipe.group)
    model = recipe.provided.get("model")
    if model is None:
        model = next((each for each in _models(experiment)), None)
    value = recipe.design if recipe.code is None else None
    if model is None or not model.is_linear_model:
        if recipe.group != "estimators":
            return OwnComponent(method, text, None, NOT_LINEAR)
        subject = Subject(
            text, recipe.group, recipe.code, keys=recipe.parameters, value=value, provided=recipe.provided
        )
        return OwnComponent(method, text, check_subject(subject, system=ExperimentSystem(experiment, method)), PARTLY)
    system = LinearSystem.of(model.at(0), experiment.plant.Ts)
    kept = {name: recipe.provided[name] for name in ("plant_info", "model") if name in recipe.provided}
    subject = Subject(text, recipe.group, recipe.code, keys=recipe.parameters, value=value, provided=kept)
    return OwnComponent(method, text, check_subject(subject, system=system))


def _models(experiment: Experiment) -> Iterator[Any]:
    """Design models of the components that are not built in."""
    for method in experiment.methods:
        for design in (method.estimator, method.controller):
            recipe = recipe_of(design)
            if recipe is not None and "model" in recipe.provided:
                yield recipe.provided["model"]
