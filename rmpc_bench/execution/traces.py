"""Recorded runs of a method, read from the store."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from rmpc_bench.analysis.trials import Traces
from rmpc_bench.config.sweep_point import SweepPoint
from rmpc_bench.execution.store import Store
from rmpc_bench.simulation.recording import kept
from rmpc_bench.types import Plant


def traces_of(point: SweepPoint, store: Store, name: str) -> Traces | None:
    """Read the recorded runs of a method; None where there are none.

    Parameters
    ----------
    point : the experiment at a point of the sweep
    store : the trial store
    name : name of the method
    """
    experiment, recording = point.experiment, kept(point.experiment, name)
    if not (recording.n_runs and recording.signals):
        return None
    found = {signal: store.traces(point.method_keys[name], signal, recording.n_runs) for signal in recording.signals}
    runs = sorted(set.intersection(*(set(stored) for stored, _ in found.values())))
    signals = {signal: array[np.isin(stored, runs)] for signal, (stored, array) in found.items()}
    shapes = {signal: shape for signal, shape in experiment.method(name).reports.items() if signal in signals}
    r = experiment.scenario.reference.sample(experiment.n_steps + 1)
    return Traces(np.array(runs, dtype=np.int64), signals, r, shapes) if runs else None


def units_of(plant: Plant, traces: Iterable[Traces]) -> dict[str, str]:
    """Units of the signals, and of components that have their own; an estimate of the plant's states has theirs.

    Parameters
    ----------
    plant : the true system
    traces : of all methods
    """
    units = {"y": plant.y_unit, "u": plant.u_unit, **plant.units}
    widths = {trace.signals["x_hat"].shape[2] for trace in traces if "x_hat" in trace.signals}
    if widths == {plant.nx}:
        units |= {f"x_hat.{i}": units[f"x.{i}"] for i in range(plant.nx) if f"x.{i}" in units}
    return units
