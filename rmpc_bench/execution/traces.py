"""Recorded runs of a method, read from the store."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from rmpc_bench.analysis.traces import COVARIANCE, Traces
from rmpc_bench.execution.stored_experiment import StoredPoint
from rmpc_bench.received.store import decoded
from rmpc_bench.store.store import Store
from rmpc_bench.types import Array


def traces_of(point: StoredPoint, store: Store, name: str) -> Traces | None:
    """Read the recorded runs of a method; None where there are none."""
    method, n_runs = point.methods[name], point.n_recorded
    if point.reference is None or not method.signals:
        return None
    found = {signal: store.traces(method.key, signal, n_runs) for signal in method.signals}
    runs = sorted(set.intersection(*(set(stored) for stored, _ in found.values())))
    signals = {signal: array[np.isin(stored, runs)] for signal, (stored, array) in found.items()}
    r = store.array(point.reference)
    shapes = dict(method.shapes)
    with decoded(store.directory):
        _check(point, signals if runs else {}, r, shapes)
    if COVARIANCE in signals and COVARIANCE not in shapes:
        n = math.isqrt(signals[COVARIANCE].shape[2])
        shapes[COVARIANCE] = (n, n)
    return Traces(np.array(runs, dtype=np.int64), signals, r, shapes) if runs else None


def _check(point: StoredPoint, signals: Mapping[str, Array], r: Array, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse recorded runs that do not have the samples and the components of their experiment."""
    if r.ndim != 2 or len(r) <= point.n_steps:
        raise ValueError(f"the reference has the shape {r.shape} with {point.n_steps} steps")
    for name, values in signals.items():
        n_samples, width = values.shape[1:]
        if n_samples not in (point.n_steps, point.n_steps + 1) or width != math.prod(shapes.get(name, (width,))):
            raise ValueError(f"traces.data of {name} has {n_samples} samples of {width} components")
    if COVARIANCE in signals and math.isqrt(signals[COVARIANCE].shape[2]) ** 2 != signals[COVARIANCE].shape[2]:
        raise ValueError(f"traces.width of {COVARIANCE} is no square")


def with_estimates(point: StoredPoint, texts: Mapping[str, str], traces: Iterable[Traces]) -> dict[str, str]:
    """Return units or names of components; an estimate of the plant's states has those of the states."""
    found = dict(texts)
    widths = {trace.signals["x_hat"].shape[2] for trace in traces if "x_hat" in trace.signals}
    if widths == {point.nx}:
        found |= {f"x_hat.{i}": found[f"x.{i}"] for i in range(point.nx) if f"x.{i}" in found}
    return found
