"""The figures of a configuration, checked against what the experiment will have to show."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rmpc_bench import registry
from rmpc_bench.config.component import Component
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.sweep_points import Place, nowhere
from rmpc_bench.config.tree import plain
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.closed_loop import BURSTS, SIGNALS
from rmpc_bench.simulation.moments import Moments, exact_laws, signals
from rmpc_bench.simulation.recording import has_bursts
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Method, ResultLayout
from rmpc_bench.types.sweep_points import value_text

OF_RUNS = ("boxplot", "trajectories", "ellipses", "tubes", "elements", "plane", "pareto")
"""Kinds of figures that show single runs."""


def check_figures(
    draft: DraftConfig, metrics: Sequence[str], places: Sequence[Place], layout: ResultLayout | None
) -> None:
    """Report every figure option that the experiment cannot satisfy.

    Parameters
    ----------
    draft : of the first point
    metrics : names of the metrics
    places : the points of the sweep; empty where something is wrong with it
    layout : what the results will have; None where something else is wrong
    """
    for number, part in enumerate(draft.figures):
        if part is not None:
            for key, message in _mistakes(part, draft, metrics, places):
                draft.note(["figures", number, *([key] if key else [])], message)
            mistakes = getattr(registry.get("figures", part.kind), "mistakes", None)
            for key, message in mistakes(part.parameters, layout) if mistakes and layout else ():
                draft.note(["figures", number, *([key] if key else [])], message)


def check_evaluation(draft: DraftConfig, experiment: Experiment) -> None:
    """Note the methods of which nothing would be computed: there are to be no runs, and they have no exact moments.

    Parameters
    ----------
    draft, experiment : of one point
    """
    wanted = draft.values["evaluate"]
    if "runs" in wanted:
        return
    if "moments" not in wanted:
        draft.note(["evaluate"], "an ensemble is one of runs: evaluate: [runs, ensemble]")
        return
    for method in experiment.methods:
        laws = exact_laws(experiment.plant, method, experiment.scenario)
        if isinstance(laws, str):
            draft.note(["evaluate"], f"{method.name} has no exact moments: {laws}; evaluate: [runs, moments]")


def check_recording(draft: DraftConfig, experiments: Sequence[Experiment | None]) -> None:
    """Note signals to record that nothing has, at no point of the sweep.

    Parameters
    ----------
    draft : of the first point
    experiments : of all points, None where something else is wrong
    """
    found = [experiment for experiment in experiments if experiment is not None]
    if len(found) < len(experiments):
        return
    there = list(SIGNALS)
    there += [name for experiment in found for method in experiment.methods for name in method.reports]
    there += [BURSTS for experiment in found if has_bursts(experiment.scenario)]
    for number, name in enumerate(draft.values["record"].signals):
        if name not in there:
            draft.note(["record", "signals", number], unknown(name, dict.fromkeys(there), "signal"))


def _mistakes(
    part: Component, draft: DraftConfig, metrics: Sequence[str], places: Sequence[Place]
) -> list[tuple[str, str]]:
    """Check the keys that mean the same in every figure."""
    keys, found = part.parameters, []
    if "runs" not in draft.values["evaluate"] and part.kind in OF_RUNS:
        found.append(("", "draws runs, and none are evaluated: add `runs` to `evaluate`"))
    for key in ("metric", "x", "y"):
        if keys.get(key) is not None and keys[key] not in metrics:
            found.append((key, unknown(keys[key], metrics, "metric of this configuration")))
    order = keys.get("order") or []
    if len(set(order)) < len(order):
        found.append(("order", "a method is named twice"))
    found += [("order", unknown(name, draft.methods, "method")) for name in order if name not in draft.methods]
    at = keys.get("at") or []
    for wanted in at if isinstance(at, list) else [at]:
        message = nowhere(places, {path: value_text(plain(value)) for path, value in wanted.items()})
        if message:
            found.append(("at", message))
    return found


def _ensemble(nx: int, method: Method) -> dict[str, tuple[int, ...]]:
    """Shapes of the ensemble's series."""
    x0 = method.estimator.x0
    x_hat = np.zeros((1, nx if x0 is None else len(x0)))
    z = np.concatenate([np.zeros((1, nx)), x_hat], axis=1)
    return {name: array.shape[1:] for name, array in signals(Moments(z, z[:, :, None] * z[:, None]), nx).items()}


def _reports(experiments: Sequence[Experiment]) -> dict[str, dict[str, tuple[int, ...]]]:
    """Shapes of what is recorded of what the methods report, at whatever point they do."""
    found: dict[str, dict[str, tuple[int, ...]]] = {}
    for experiment in experiments:
        for method in experiment.methods:
            wanted = experiment.recording.signals if experiment.recording.n_runs else ()
            shapes = {name: shape for name, shape in method.reports.items() if name in wanted}
            found[method.name] = found.get(method.name, {}) | shapes
    return found


def layout(experiments: Sequence[Experiment], n_points: int, *, smoke: bool) -> ResultLayout:
    """Say what the results of an experiment will have, before it runs.

    Parameters
    ----------
    experiments : of the points of the sweep that could be built; what a method reports may be there at some only
    n_points : points of the sweep
    smoke : whether the runs may be shorter than what is drawn of them
    """
    experiment = experiments[0]
    plant, recording = experiment.plant, experiment.recording
    reports = _reports(experiments)
    widths: dict[str, int | None] = {"y": plant.ny, "u": plant.nu, "x": plant.nx, "x_hat": None, BURSTS: 1}
    widths |= {name: math.prod(shape) for shapes in reports.values() for name, shape in shapes.items()}
    series: dict[str, tuple[int, ...]] = {}
    arrays: dict[str, dict[str, tuple[int, ...]]] = {}
    for method in experiment.methods:
        arrays[method.name] = shapes = {name: array.shape for name, array in method.estimator.series().items()}
        if recording.ensemble:
            ensemble = _ensemble(plant.nx, method)
            shapes |= {name: (experiment.n_steps + 1, *entry) for name, entry in ensemble.items()}
        series |= {name: shape[1:] for name, shape in shapes.items()}
    return ResultLayout(
        signals={name: widths.get(name) for name in recording.signals if recording.n_runs},
        end=0.0 if smoke else experiment.n_steps * plant.Ts,
        series=series,
        n_points=n_points,
        arrays=arrays,
        n_recorded=recording.n_runs,
        reports=reports,
    )
