"""Recorded runs of a method, read from the store."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from rmpc_bench.analysis.traces import COVARIANCE, Traces
from rmpc_bench.execution.store import Store
from rmpc_bench.execution.stored_experiment import StoredPoint


def traces_of(point: StoredPoint, store: Store, name: str) -> Traces | None:
    """Read the recorded runs of a method; None where there are none.

    Parameters
    ----------
    point : the experiment at a point of the sweep
    store : the trial store
    name : name of the method
    """
    method, n_runs = point.methods[name], point.n_recorded
    if point.reference is None or not method.signals:
        return None
    found = {signal: store.traces(method.key, signal, n_runs) for signal in method.signals}
    runs = sorted(set.intersection(*(set(stored) for stored, _ in found.values())))
    signals = {signal: array[np.isin(stored, runs)] for signal, (stored, array) in found.items()}
    r = store.array(point.reference)
    shapes = dict(method.shapes)
    if COVARIANCE in signals and COVARIANCE not in shapes:
        n = math.isqrt(signals[COVARIANCE].shape[2])
        shapes[COVARIANCE] = (n, n)
    return Traces(np.array(runs, dtype=np.int64), signals, r, shapes) if runs else None


def with_estimates(point: StoredPoint, texts: Mapping[str, str], traces: Iterable[Traces]) -> dict[str, str]:
    """Return units or names of components; an estimate of the plant's states has those of the states.

    Parameters
    ----------
    point : the experiment at a point of the sweep
    texts : component -> unit or name
    traces : of all methods
    """
    found = dict(texts)
    widths = {trace.signals["x_hat"].shape[2] for trace in traces if "x_hat" in trace.signals}
    if widths == {point.nx}:
        found |= {f"x_hat.{i}": found[f"x.{i}"] for i in range(point.nx) if f"x.{i}" in found}
    return found
