"""A configuration as plain data: with every default filled in, and the parts of it that identify trials."""

from __future__ import annotations

from typing import Any

from rmpc_bench.experiment.parts import Part, plain_data
from rmpc_bench.experiment.sheet import Law, MethodParts, Sheet
from rmpc_bench.experiment.sweep import swept_paths
from rmpc_bench.experiment.yaml import Map, plain, split
from rmpc_bench.simulation.scenario import Experiment


def shared(sheet: Sheet, experiment: Experiment) -> dict[str, Any]:
    """What all methods share: the truth, its size over time and its seed."""
    time = sheet.values["time"]
    common = {
        "seed": sheet.values["seed"],
        "time": {"step": time.step, "steps": time.n_steps},
        "uncertainty": _uncertainty(sheet),
        "plant": _plant(sheet, canonical=True),
        "noise": _noise(sheet),
        "x": {"mean": experiment.scenario.x0.tolist(), "law": _law(sheet.initial["law"])},
        "reference": sheet.reference.resolved() if sheet.reference else None,
    }
    laws = [*sheet.noise.values(), sheet.initial["law"]]
    if sheet.model is not None and any(law is not None and law.same is not None for law in laws):
        common["model"] = sheet.model.resolved()
    return common


def changes(before: Any, after: Any) -> Any:
    """Say what of a tree of plain data is another in a second one; what the second one lacks is null."""
    if not (isinstance(before, dict) and isinstance(after, dict)):
        return after
    keys = [*before, *(key for key in after if key not in before)]
    return {key: changes(before.get(key), after.get(key)) for key in keys if before.get(key) != after.get(key)}


def _uncertainty(sheet: Sheet) -> dict[str, Any]:
    return {name: {"dist": type(law).__name__.lower(), **plain_data(law)} for name, law in sheet.uncertainty.items()}


def _plant(sheet: Sheet, *, canonical: bool = False) -> dict[str, Any]:
    """The plant with its changes: as written, or in a form that does not depend on blanks and parentheses."""
    assert sheet.plant is not None
    plant = sheet.plant.resolved()
    for key, relative in (("perturb", True), ("set", False)):
        changes = {
            name: change.expression.canonical if canonical else change.expression.text
            for name, change in sheet.changes.items()
            if change.relative == relative
        }
        if changes:
            plant[key] = changes
    return plant


def _noise(sheet: Sheet) -> Any:
    return {channel: _law(sheet.noise.get(channel)) for channel in ("process", "measurement")}


def _law(law: Law | None) -> Any:
    if law is None:
        return "none"
    if law.part is None:
        return {"same": {"scale": law.same}}
    keys = law.part.resolved()
    return {keys.pop("kind"): {name: value for name, value in keys.items() if value is not None}}


def _initial_x(sheet: Sheet) -> Any:
    return _law(sheet.initial["law"]) if sheet.initial["law"] is not None else sheet.initial["x"]


def belief(sheet: Sheet, parts: MethodParts) -> dict[str, Any]:
    """What identifies a method: its parts and where its estimator starts."""
    named = {"model": parts.model, "estimator": parts.estimator, "controller": parts.controller}
    resolved = {name: _without_nothing(part) for name, part in named.items() if part is not None}
    return {**resolved, "x_hat": sheet.initial["x_hat"], "P": sheet.initial["P"]}


def _without_nothing(part: Part) -> dict[str, Any]:
    return {name: value for name, value in part.resolved().items() if value is not None}


def measured(sheet: Sheet, experiment: Experiment) -> dict[str, Any]:
    """What every metric measures, by its name: its window counts in samples, so that no unit can be mistaken."""
    table = {}
    for metric, part in zip(experiment.metrics, sheet.metrics, strict=True):
        keys = _without_nothing(part) if part is not None else {}
        window = getattr(metric, "window", None)
        if window is not None:
            keys = {name: value for name, value in keys.items() if name not in ("from", "to")}
            keys["window"] = list(window)
        table[metric.info.name] = keys
    return table


def _metrics(sheet: Sheet, experiment: Experiment, *, smoke: bool) -> list[dict[str, Any]]:
    """Metrics as keys of a configuration; those of a smoke run with the windows it has cut."""
    entries = []
    for metric, part in zip(experiment.metrics, sheet.metrics, strict=True):
        keys = _without_nothing(part) if part is not None else {}
        if smoke and hasattr(metric, "window"):
            tick = sheet.values["time"].tick
            cut = {"from": metric.window.first * tick, "to": metric.window.last * tick}
            keys |= {name: value for name, value in cut.items() if name in keys}
        entries.append(keys)
    return entries


def resolved(sheet: Sheet, experiment: Experiment, tree: Map, *, smoke: bool) -> dict[str, Any]:
    """Return the whole configuration with every default filled in; it loads to an equal one.

    Parameters
    ----------
    sheet, experiment : of the first point of a sweep
    tree : as given, with the sweep; what it changes in the methods is left as given, or it would miss its place
    smoke : whether the sizes are those of a smoke run
    """
    whole = _resolved(sheet, experiment, smoke=smoke)
    if "sweep" not in tree:
        return whole
    parts = ("model", "estimator", "controller", "methods")
    roots = {split(path, tree.mark)[0] for axis in swept_paths(tree) for path in axis}
    if roots & set(parts):
        whole = {key: value for key, value in whole.items() if key not in parts}
        whole |= {key: plain(tree[key]) for key in parts if key in tree}
    return {**whole, "sweep": plain(tree["sweep"])}


def _resolved(sheet: Sheet, experiment: Experiment, *, smoke: bool) -> dict[str, Any]:
    values, time = sheet.values, sheet.values["time"]
    length = {"duration": time.duration} if time.duration is not None else {"steps": time.steps}
    head = {
        key: values[key] for key in ("version", "name", "paper", "title", "seed", "runs") if values[key] is not None
    }
    methods = {}
    for name, parts in sheet.methods.items():
        believed = belief(sheet, parts)
        methods[name] = {"label": parts.label, **{key: believed[key] for key in ("model", "estimator", "controller")}}
    return {
        **head,
        "time": {"step": time.step, **length},
        "uncertainty": _uncertainty(sheet),
        "plant": _plant(sheet),
        "model": _without_nothing(sheet.model) if sheet.model else {},
        "noise": _noise(sheet),
        "initial": {"x": _initial_x(sheet), "x_hat": sheet.initial["x_hat"], "P": sheet.initial["P"]},
        "reference": sheet.reference.resolved() if sheet.reference else {},
        "methods": methods,
        "metrics": _metrics(sheet, experiment, smoke=smoke),
        "statistics": plain_data(values["statistics"]),
        "record": plain_data(values["record"]),
        "figures": [_without_nothing(part) for part in sheet.figures if part is not None],
        "claims": [plain_data(keys) for keys in sheet.claims if keys is not None],
        "execution": plain_data(values["execution"]),
        "smoke": plain_data(values["smoke"]),
    }
