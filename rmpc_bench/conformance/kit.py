"""The checks as functions: one per kind of component, and one for pytest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

from rmpc_bench import registry
from rmpc_bench.components.transport import Recipe, recipe_of
from rmpc_bench.components.user_class import a_component
from rmpc_bench.conformance.process import SECONDS, check_subject
from rmpc_bench.conformance.results import Report
from rmpc_bench.conformance.stages import CHECKS, ExperimentSystem
from rmpc_bench.conformance.subject import Subject, groups_of, subject_of
from rmpc_bench.conformance.systems import LinearSystem
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import DesignError


def check(
    component: Any,
    group: str = "",
    *,
    keys: Mapping[str, Any] | None = None,
    model: Any = None,
    seconds: float = SECONDS,
) -> Report:
    """Check a component in a process of its own.

    Parameters
    ----------
    component : a class, a design function, ``PATH.py:NAME`` or a name of the registry
    group : ``estimators``, ``controllers`` and so on; found from the component unless given
    keys : keywords of its design function
    model : linear model (`LinearModel`) that it is designed for; two states, one input and one output unless given
    seconds : time limit of one check

    Returns
    -------
    The outcome of every check; ``print(report)`` shows it as a table.

    Raises
    ------
    DesignError
        If another process could not find the component.

    Examples
    --------
    >>> report = check("kalman", "estimators")
    >>> report.passed
    True
    """
    system = None if model is None else LinearSystem.of(model)
    return check_subject(subject_of(component, group, keys), system=system, seconds=seconds)


def _check_of(group: str) -> Callable[..., Report]:
    """Return `check` for the components of a group."""

    def checked(component: Any, **options: Any) -> Report:
        return check(component, group, **options)

    # By this name it is found again when it is sent to another process.
    checked.__name__ = checked.__qualname__ = f"check_{registry.singular(group)}"
    checked.__doc__ = f"Check {a_component(group)}; see `check` for the options."
    return checked


check_estimator = _check_of("estimators")
check_controller = _check_of("controllers")
check_plant = _check_of("plants")
check_metric = _check_of("metrics")
check_noise = _check_of("noises")
check_reference = _check_of("references")
check_figure = _check_of("figures")


def parametrize_with_checks(components: Sequence[Any], group: str = "", **options: Any) -> Callable[..., Any]:
    """Parametrise a pytest function with every check of some components.

    The function takes ``check`` and calls it without arguments; it raises an AssertionError where the check fails.  All
    checks of a component are run once.

    Parameters
    ----------
    components : as in `check`
    group : of all components; found from each of them unless given
    options : keys, model and seconds, as in `check`

    Examples
    --------
    >>> @parametrize_with_checks(["kalman"], "estimators")
    ... def test_my_filter(check):
    ...     check()
    """
    import pytest

    parameters = []
    for number, component in enumerate(components):
        kind = group or _group(component)
        outcome = cache(lambda component=component, kind=kind: check(component, kind, **options))
        name = component.rpartition(":")[2] if isinstance(component, str) else getattr(component, "__name__", number)
        parameters += [
            pytest.param(partial(_assert, outcome, each.id), id=f"{name}-{each.id}") for each in CHECKS[kind]
        ]
    return pytest.mark.parametrize("check", parameters)


def _assert(outcome: Callable[[], Report], id: str) -> None:
    """Fail if a check has failed and is of the class `error`; `outcome` returns that of all checks."""
    result = outcome().result(id)
    assert not result.counts, str(result)


def _group(component: Any) -> str:
    subject = subject_of(component)
    candidates = [subject.group] if subject.group else groups_of(subject.loaded())
    if len(candidates) > 1:
        raise DesignError(f"say what {subject.text} is: parametrize_with_checks([...], group='estimators')")
    return candidates[0]


class OwnComponent(NamedTuple):
    """A component of a user in a method."""

    method: str
    text: str  # file and name, or the registered kind
    report: Report | None  # none where it cannot be checked
    reason: str = ""  # why it cannot be checked, or not on a linear system


def check_own_components(experiment: Experiment) -> Iterator[OwnComponent]:
    """Check the estimators and controllers that are not built in; equal ones once."""
    designs = [(method.name, each) for method in experiment.methods for each in (method.estimator, method.controller)]
    recipes = [(name, recipe) for name, design in designs if (recipe := recipe_of(design)) is not None]
    # Of the first one that has a model, for those that have none.
    shared = next((recipe.provided["model"] for _, recipe in recipes if "model" in recipe.provided), None)
    seen: set[tuple[Any, ...]] = set()
    for method, recipe in recipes:
        # Methods may have equal components of their own.
        key = recipe.code, recipe.design, repr(recipe.parameters), id(recipe.provided.get("model"))
        if key not in seen:
            seen.add(key)
            yield _checked(method, recipe, experiment, shared)


def _checked(method: str, recipe: Recipe, experiment: Experiment, shared: Any) -> OwnComponent:
    text = recipe.code.text if recipe.code is not None else getattr(recipe.design, "__name__", recipe.group)
    model = recipe.provided.get("model")
    model = shared if model is None else model
    value = recipe.design if recipe.code is None else None
    subject = Subject(text, recipe.group, recipe.code, keys=recipe.parameters, value=value, provided=recipe.provided)
    if model is not None and model.is_linear_model:
        kept = {name: each for name, each in recipe.provided.items() if name in ("plant_info", "model")}
        system = LinearSystem.of(model.at(0), experiment.plant.Ts)
        return OwnComponent(method, text, check_subject(replace(subject, provided=kept), system=system))
    if recipe.group != "estimators":
        return OwnComponent(method, text, None, "the design model is not linear")
    report = check_subject(subject, system=ExperimentSystem(experiment, method))
    return OwnComponent(method, text, report, "in the experiment itself, because its design model is not linear")
