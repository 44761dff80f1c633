"""What identifies trials: the plain data that are hashed (sweep_point.py) and under which results are stored.

All methods share the plant, the noise, the uncertainty, the true initial state, the reference, the time and the seed.
A method is identified by its model, estimator and controller and by where its estimator starts.
Runs, labels, figures, claims, statistics and execution are not hashed: they may change without a new computation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rmpc_bench.config.component import Component, plain_data
from rmpc_bench.config.draft import DraftConfig, MethodComponents, NoiseTerm
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.simulation.scenario import Experiment

ADDED_LATER: Mapping[tuple[str, str], Any] = {
    ("estimators", "form"): "filter",
    ("estimators", "noise"): "nominal",
    ("estimators", "use_y0"): True,
    ("metrics", "of"): "output",
}
"""Keys that were added after trials had been stored.  Their defaults are left out of the hash, so earlier trials stay
valid."""


def sweep_point(draft: DraftConfig, experiment: Experiment) -> SweepPoint:
    """Return a point of the sweep with the data that identify its trials.

    Parameters
    ----------
    draft : the validated sections
    experiment : the designs made from them
    """
    return SweepPoint(
        draft.coordinates,
        draft.title,
        experiment,
        _shared(draft, experiment),
        {name: method_data(draft, components) for name, components in draft.methods.items()},
        _metrics(draft, experiment),
    )


def _shared(draft: DraftConfig, experiment: Experiment) -> dict[str, Any]:
    """What all methods share."""
    time = draft.values["time"]
    common = {
        "seed": draft.values["seed"],
        "time": {"step": time.step, "steps": time.n_steps},
        "uncertainty": uncertainty_data(draft),
        "plant": plant_data(draft, canonical=True),
        "noise": noise_data(draft, experiment),
        "x": {"mean": experiment.scenario.x0.tolist(), "law": sum_data(draft.initial["laws"])},
        "reference": draft.reference.resolved() if draft.reference else None,
    }
    if draft.input is not None:
        common["input"] = draft.input.resolved()
    plant = experiment.plant
    if plant.opponent is not None:
        common["against"] = method_data(draft, draft.methods[plant.opponent[0]])
    terms = [term for channel in (*draft.noise.values(), draft.initial["laws"]) for term in channel]
    if draft.model is not None and any(term.same is not None for term in terms):
        common["model"] = draft.model.resolved()
    return common


def _metrics(draft: DraftConfig, experiment: Experiment) -> dict[str, Any]:
    """What identifies every metric, by its name; a window is given in samples, whatever the unit of time."""
    table = {}
    for metric, component in zip(experiment.metrics, draft.metrics, strict=True):
        keys = set_keys(component) if component is not None else {}
        keys = {name: value for name, value in keys.items() if name not in ("from", "to", "at")}
        table[metric.name] = {**keys, "window": list(metric.window(experiment.metric_layout))}
    return table


def method_data(draft: DraftConfig, components: MethodComponents) -> dict[str, Any]:
    """What identifies a method: its components, and where its estimator starts."""
    named = {"model": components.model, "estimator": components.estimator, "controller": components.controller}
    resolved = {name: set_keys(component) for name, component in named.items() if component is not None}
    nominal = nominal_plant(draft, components.model)
    return {**resolved, **({} if nominal is None else {"nominal_plant": nominal}), **start_data(draft)}


def nominal_plant(draft: DraftConfig, model: Component | None) -> dict[str, Any] | None:
    """Return the keys of the plant that determine a model made from it; None for a model that is not made from it.

    `perturb` and `set` are not among them: such a model has the nominal parameters.
    """
    if model is None or draft.plant is None or not model.takes("plant"):
        return None
    return set_keys(draft.plant) | {key: value for key, value in draft.plant_range.items() if value is not None}


def set_keys(component: Component) -> dict[str, Any]:
    """Return the keys of a component that are set, those of ADDED_LATER only where they differ from their default."""
    later = {name: value for (group, name), value in ADDED_LATER.items() if group == component.group}
    keys = component.resolved()
    return {name: value for name, value in keys.items() if value is not None and later.get(name) != value}


def uncertainty_data(draft: DraftConfig) -> dict[str, Any]:
    """Return the distributions of the uncertain quantities as plain data."""
    return {name: {"dist": type(law).__name__.lower(), **plain_data(law)} for name, law in draft.uncertainty.items()}


def plant_data(draft: DraftConfig, *, canonical: bool = False) -> dict[str, Any]:
    """Return the plant with ``perturb`` and ``set`` as plain data.

    Parameters
    ----------
    draft : with a valid plant
    canonical : whether expressions are written in a form that does not depend on blanks and parentheses
    """
    assert draft.plant is not None
    plant = set_keys(draft.plant)
    for key, relative in (("perturb", True), ("set", False)):
        expressions = {
            name: change.expression.canonical if canonical else change.expression.text
            for name, change in draft.parameter_changes.items()
            if change.relative == relative
        }
        if expressions:
            plant[key] = expressions
    return plant | {key: value for key, value in draft.plant_range.items() if value is not None}


def noise_data(draft: DraftConfig, experiment: Experiment) -> Any:
    """Return the noise of the plant as plain data."""
    noise: dict[str, Any] = {channel: sum_data(draft.noise.get(channel, ())) for channel in ("process", "measurement")}
    if experiment.scenario.cross is not None:
        noise["cross"] = draft.cross
    return noise


def sum_data(terms: tuple[NoiseTerm, ...]) -> Any:
    """Return the terms of a noise as a configuration writes them; a sum of one term is that term."""
    laws = [_term_data(term) for term in terms]
    return {"sum": laws} if len(laws) > 1 else laws[0] if laws else "none"


def _term_data(term: NoiseTerm) -> Any:
    if term.law is None:
        return {"same": {"scale": term.same}}
    keys = term.law.resolved()
    if term.law.code is not None:
        return {name: value for name, value in keys.items() if value is not None}
    return {keys.pop("kind"): {name: value for name, value in keys.items() if value is not None}}


def start_data(draft: DraftConfig) -> dict[str, Any]:
    """Where the estimators start; the set M is left out where it is 0, so that earlier trials stay valid."""
    start = {key: draft.initial[key] for key in ("x_hat", "P", "M")}
    return start if np.any(start["M"]) else {key: start[key] for key in ("x_hat", "P")}
