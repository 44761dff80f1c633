"""A configuration as plain data: with every default filled in, and the parts of it that identify trials."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rmpc_bench.config.component import Component, plain_data
from rmpc_bench.config.draft import DraftConfig, Law, MethodComponents
from rmpc_bench.config.inheritance import TAKEN, comes_from
from rmpc_bench.config.reader import Map, plain, split
from rmpc_bench.config.sweep import swept_paths
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import HasOpponent


def shared(draft: DraftConfig, experiment: Experiment) -> dict[str, Any]:
    """What all methods share: the truth, its size over time and its seed."""
    time = draft.values["time"]
    common = {
        "seed": draft.values["seed"],
        "time": {"step": time.step, "steps": time.n_steps},
        "uncertainty": _uncertainty(draft),
        "plant": _plant(draft, canonical=True),
        "noise": _noise(draft, experiment),
        "x": {"mean": experiment.scenario.x0.tolist(), "law": _laws(draft.initial["laws"])},
        "reference": draft.reference.resolved() if draft.reference else None,
    }
    plant = experiment.plant
    if isinstance(plant, HasOpponent) and plant.opponent is not None:
        common["against"] = belief(draft, draft.methods[plant.opponent[0]])
    laws = [law for terms in (*draft.noise.values(), draft.initial["laws"]) for law in terms]
    if draft.model is not None and any(law.same is not None for law in laws):
        common["model"] = draft.model.resolved()
    return common


def changes(before: Any, after: Any) -> Any:
    """Say what of a tree of plain data is another in a second one; what the second one lacks is null."""
    if not (isinstance(before, dict) and isinstance(after, dict)):
        return after
    keys = [*before, *(key for key in after if key not in before)]
    return {key: changes(before.get(key), after.get(key)) for key in keys if before.get(key) != after.get(key)}


def _uncertainty(draft: DraftConfig) -> dict[str, Any]:
    return {name: {"dist": type(law).__name__.lower(), **plain_data(law)} for name, law in draft.uncertainty.items()}


def _plant(draft: DraftConfig, *, canonical: bool = False) -> dict[str, Any]:
    """The plant with its changes: as written, or in a form that does not depend on blanks and parentheses."""
    assert draft.plant is not None
    plant = _without_nothing(draft.plant)
    for key, relative in (("perturb", True), ("set", False)):
        changes = {
            name: change.expression.canonical if canonical else change.expression.text
            for name, change in draft.changes.items()
            if change.relative == relative
        }
        if changes:
            plant[key] = changes
    return plant


def _noise(draft: DraftConfig, experiment: Experiment) -> Any:
    noise: dict[str, Any] = {channel: _laws(draft.noise.get(channel, ())) for channel in ("process", "measurement")}
    if experiment.scenario.cross is not None:
        noise["cross"] = draft.cross
    return noise


def _laws(terms: tuple[Law, ...]) -> Any:
    """The terms of a noise as they are written; a sum of one is that one."""
    laws = [_law(term) for term in terms]
    return {"sum": laws} if len(laws) > 1 else laws[0] if laws else "none"


def _law(law: Law) -> Any:
    if law.part is None:
        return {"same": {"scale": law.same}}
    keys = law.part.resolved()
    return {keys.pop("kind"): {name: value for name, value in keys.items() if value is not None}}


def _initial_x(draft: DraftConfig) -> Any:
    return _laws(draft.initial["laws"]) if draft.initial["laws"] else draft.initial["x"]


def _start(draft: DraftConfig) -> dict[str, Any]:
    """Where the estimators start; without the set that came after trials had been stored, unless it is given."""
    start = {key: draft.initial[key] for key in ("x_hat", "P", "M")}
    return start if np.any(start["M"]) else {key: start[key] for key in ("x_hat", "P")}


def belief(draft: DraftConfig, parts: MethodComponents) -> dict[str, Any]:
    """What identifies a method: its parts and where its estimator starts."""
    named = {"model": parts.model, "estimator": parts.estimator, "controller": parts.controller}
    resolved = {name: _without_nothing(part) for name, part in named.items() if part is not None}
    return {**resolved, **_start(draft)}


LATER: Mapping[tuple[str, str], Any] = {
    ("estimators", "form"): "filter",
    ("estimators", "noise"): "nominal",
    ("estimators", "use_y0"): True,
    ("metrics", "of"): "output",
}
"""Keys that came after trials had been stored, at their defaults: left out, those trials are still theirs."""


def _without_nothing(part: Component) -> dict[str, Any]:
    later = {name: value for (group, name), value in LATER.items() if group == part.group}
    return {name: value for name, value in part.resolved().items() if value is not None and later.get(name) != value}


def measured(draft: DraftConfig, experiment: Experiment) -> dict[str, Any]:
    """What every metric measures, by its name: its window counts in samples, so that no unit can be mistaken."""
    table = {}
    for metric, part in zip(experiment.metrics, draft.metrics, strict=True):
        keys = _without_nothing(part) if part is not None else {}
        window = getattr(metric, "window", None)
        if window is not None:
            keys = {name: value for name, value in keys.items() if name not in ("from", "to", "at")}
            keys["window"] = list(window)
        table[metric.info.name] = keys
    return table


def _metrics(draft: DraftConfig, experiment: Experiment, *, smoke: bool) -> list[dict[str, Any]]:
    """Metrics as keys of a configuration; those of a smoke run with the windows it has cut."""
    entries = []
    for metric, part in zip(experiment.metrics, draft.metrics, strict=True):
        keys = _without_nothing(part) if part is not None else {}
        if smoke and hasattr(metric, "window"):
            tick = draft.values["time"].tick
            first, last = (sample * tick for sample in metric.window)
            cut = {"from": first, "to": last, "at": last}
            keys |= {name: value for name, value in cut.items() if part is not None and name in part.resolved()}
        entries.append(keys)
    return entries


def resolved(draft: DraftConfig, experiment: Experiment, tree: Map, *, smoke: bool) -> dict[str, Any]:
    """Return the whole configuration with every default filled in; it loads to an equal one.

    Parameters
    ----------
    draft, experiment : of the first point of a sweep
    tree : as given, with the sweep; what it changes in the methods is left as given, or it would miss its place
    smoke : whether the sizes are those of a smoke run
    """
    whole = first_point(draft, experiment, smoke=smoke)
    if "sweep" not in tree:
        return whole
    parts: tuple[str, ...] = ("model", "estimator", "controller", "methods")
    roots = {split(path, tree.mark)[0] for axis in swept_paths(tree) for path in axis}
    if comes_from(tree) and roots & {*parts, "plant"}:
        parts = (*parts, "plant", *TAKEN)
    if roots & set(parts):
        whole = {key: value for key, value in whole.items() if key not in parts}
        whole |= {key: plain(tree[key]) for key in parts if key in tree}
    return {**whole, "sweep": plain(tree["sweep"])}


def first_point(draft: DraftConfig, experiment: Experiment, *, smoke: bool) -> dict[str, Any]:
    """Return the configuration at the first point of a sweep, with every default filled in."""
    values, time = draft.values, draft.values["time"]
    length = {"duration": time.duration} if time.duration is not None else {"steps": time.steps}
    head = {
        key: values[key] for key in ("version", "name", "paper", "title", "seed", "runs") if values[key] is not None
    }
    methods = {}
    for name, parts in draft.methods.items():
        believed = belief(draft, parts)
        named: dict[str, Any] = {key: believed[key] for key in ("model", "estimator", "controller") if key in believed}
        methods[name] = {"label": parts.label, **named}
    return {
        **head,
        "time": {"step": time.step, **length},
        "uncertainty": _uncertainty(draft),
        "plant": _plant(draft),
        "model": _without_nothing(draft.model) if draft.model else {},
        "noise": _noise(draft, experiment),
        "initial": {"x": _initial_x(draft), **_start(draft)},
        "reference": draft.reference.resolved() if draft.reference else {},
        "methods": methods,
        "metrics": _metrics(draft, experiment, smoke=smoke),
        "statistics": plain_data(values["statistics"]),
        "evaluate": values["evaluate"],
        "record": plain_data(values["record"]),
        "figures": [_without_nothing(part) for part in draft.figures if part is not None],
        "claims": [plain_data(keys) for keys in draft.claims if keys is not None],
        "execution": plain_data(values["execution"]),
        "smoke": plain_data(values["smoke"]),
    }
