"""The layout of the results of a configuration, from its sections and designs, before any run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.sweep_points import Place
from rmpc_bench.simulation.closed_loop import BURSTS
from rmpc_bench.simulation.moments import Moments, signals
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import Method, ResultLayout

Shapes = dict[str, tuple[int, ...]]


def layout_of(
    draft: DraftConfig, places: Sequence[Place], experiments: Sequence[Experiment], *, lenient: bool
) -> ResultLayout:
    """Return the layout of the results that a configuration will have.

    Parameters
    ----------
    draft : of the first point
    places : the points of the sweep; empty where something is wrong with it
    experiments : of the points that could be built; a method may report a signal at some of them only
    lenient : whether figures may reach beyond the end of the runs, which are shorter than in the file
    """
    names: dict[str, Any] = {
        "methods": tuple(draft.methods),
        "metrics": tuple(draft.metric_names),
        "points": tuple(place.coordinates for place in places),
        "has_runs": "runs" in draft.values["evaluate"],
    }
    if not experiments:
        return ResultLayout(**names, is_complete=False)
    first = experiments[0]
    arrays = {method.name: _series_of(method, first) for method in first.methods}
    return ResultLayout(
        **names,
        signals=_signals(experiments),
        recorded=range(first.recording.n_runs),
        series={name: shape[1:] for shapes in arrays.values() for name, shape in shapes.items()},
        arrays=arrays,
        end=0.0 if lenient else first.n_steps * first.plant.Ts,
        Ts=first.plant.Ts,
        is_complete=bool(places),
    )


def _signals(experiments: Sequence[Experiment]) -> dict[str, dict[str, tuple[int, ...] | None]]:
    """Return method -> recorded signal -> shape of a sample, of whatever a method reports at some point."""
    plant, recording = experiments[0].plant, experiments[0].recording
    if not recording.n_runs:
        return {}
    known = {"y": (plant.ny,), "u": (plant.nu,), "x": (plant.nx,), "x_hat": None, BURSTS: (1,)}
    found: dict[str, dict[str, tuple[int, ...] | None]] = {}
    for experiment in experiments:
        for method in experiment.methods:
            shapes = {**known, **method.reports}
            kept = {name: shapes[name] for name in experiment.recording.signals if name in shapes}
            found[method.name] = found.get(method.name, {}) | kept
    return found


def _series_of(method: Method, experiment: Experiment) -> Shapes:
    """Return series -> shape, axis 0 = k, of a design and of the ensemble."""
    shapes = {name: array.shape for name, array in method.estimator.series().items()}
    if experiment.recording.ensemble:
        ensemble = _ensemble(experiment.plant.nx, method)
        shapes |= {name: (experiment.n_steps + 1, *entry) for name, entry in ensemble.items()}
    return shapes


def _ensemble(nx: int, method: Method) -> Shapes:
    """Return series of the ensemble -> shape of a sample."""
    x0 = method.estimator.x0
    x_hat = np.zeros((1, nx if x0 is None else len(x0)))
    z = np.concatenate([np.zeros((1, nx)), x_hat], axis=1)
    return {name: array.shape[1:] for name, array in signals(Moments(z, z[:, :, None] * z[:, None]), nx).items()}
