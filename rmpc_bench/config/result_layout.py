"""The layout of the results of a configuration, from its sections and designs, before any run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.simulation.moments import Moments, signals
from rmpc_bench.simulation.recording import BURSTS, COVARIANCE, design_series
from rmpc_bench.simulation.scenario import Experiment, stores_quantities
from rmpc_bench.types import DesignError, Method, ResultLayout

Shapes = dict[str, tuple[int, ...]]


def layout_of(
    drafts: Sequence[DraftConfig], points: Sequence[SweepPoint | None], *, is_valid: bool, lenient: bool
) -> ResultLayout:
    """Return the layout of the results that a configuration will have.

    A method may report a signal at some points only.  If the sweep has an error (not `is_valid`), its points are not
    known.  If lenient, figures may reach beyond the end of the runs, which are shorter than in the file.
    """
    built = [point for point in points if point is not None]
    is_complete = is_valid and len(built) == len(points)
    names: dict[str, Any] = {
        "methods": tuple(drafts[0].methods),
        "metrics": tuple(drafts[0].metric_names),
        "points": tuple(draft.coordinates for draft in drafts) if is_valid else (),
        "trials": tuple(point.method_keys for point in built) if is_complete else (),
        "has_runs": "runs" in drafts[0].values["evaluate"],
        "tuned": tuple(drafts[0].tuned),
    }
    experiments = [point.experiment for point in built]
    if not experiments:
        return ResultLayout(**names, is_complete=False)
    first = experiments[0]
    names["is_uncertain"] = any(stores_quantities(experiment) for experiment in experiments)
    arrays = {method.name: _series_of(method, first, drafts[0]) for method in first.methods}
    return ResultLayout(
        **names,
        signals=_signals(experiments),
        recorded=range(first.recording.n_runs),
        series={name: shape[1:] for shapes in arrays.values() for name, shape in shapes.items()},
        arrays=arrays,
        end=0.0 if lenient else first.n_steps * first.plant.Ts,
        Ts=first.plant.Ts,
        is_complete=is_valid,
    )


def _signals(experiments: Sequence[Experiment]) -> dict[str, dict[str, tuple[int, ...] | None]]:
    """Return method -> recorded signal -> shape of a sample, of whatever a method reports at some point."""
    plant, recording = experiments[0].plant, experiments[0].recording
    if not recording.n_runs:
        return {}
    known = {"y": (plant.ny,), "x": (plant.nx,), "x_hat": None, COVARIANCE: None, BURSTS: (1,)}
    known |= dict.fromkeys(("u", "u_command"), (plant.nu,))
    extra = {name: (1,) for name in plant.extra_signals}
    found: dict[str, dict[str, tuple[int, ...] | None]] = {}
    for experiment in experiments:
        for method in experiment.methods:
            shapes = {**known, **method.reports, **extra}
            kept = {name: shapes[name] for name in experiment.recording.signals if name in shapes}
            found[method.name] = found.get(method.name, {}) | kept
    return found


def _series_of(method: Method, experiment: Experiment, draft: DraftConfig) -> Shapes:
    """Return series -> shape, axis 0 = k, of a design and of the ensemble; the draft gets the errors of a design."""
    shapes: Shapes = {}
    try:
        shapes = {name: array.shape for name, array in design_series(method).items()}
    except DesignError as error:
        draft.note(["methods", method.name, "estimator"], str(error))
    if experiment.recording.ensemble:
        ensemble = _ensemble(experiment.plant.nx, method)
        shapes |= {name: (experiment.n_steps + 1, *entry) for name, entry in ensemble.items()}
    return shapes


def _ensemble(nx: int, method: Method) -> Shapes:
    """Return series of the ensemble -> shape of a sample."""
    x0 = method.estimator.x0
    x_hat = np.zeros((1, nx if x0 is None else len(x0) - method.n_disturbances))
    z = np.concatenate([np.zeros((1, nx)), x_hat], axis=1)
    return {name: array.shape[1:] for name, array in signals(Moments(z, z[:, :, None] * z[:, None]), nx).items()}
