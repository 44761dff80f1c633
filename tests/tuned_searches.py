"""Searches with known objectives, written by hand."""

from __future__ import annotations

import numpy as np

from rmpc_bench.types.tuning import TunedParameter, Tuning, TuningProtocol, TuningSearch

PROTOCOL = TuningProtocol(4, 3, "mse")
RADIUS = TunedParameter("estimator.radius", 0.01, 10.0)


def search(method, tuning, test=None, *, values=None, stages=None, protocol=PROTOCOL, point="", default=0.1, **fields):
    """Make a search of one parameter from the metric of every candidate and run."""
    tuning = np.array(tuning, dtype=float)
    n = len(tuning)
    objectives = protocol.objective(tuning)
    chosen = int(np.argmin(objectives)) if np.isfinite(objectives).any() else None
    usual = {
        "parameters": (RADIUS,),
        "default": (default,),
        "candidates": np.array(values if values is not None else np.geomspace(0.02, 5.0, n), dtype=float)[:, None],
        "stages": tuple(stages or ["grid"] * n),
        "test": None if test is None else np.array(test, dtype=float),
        "chosen": chosen,
    }
    return TuningSearch(point=point, method=method, tuning=tuning, protocol=protocol, **(usual | fields))


def tuning(*searches, parameters=None, protocol=PROTOCOL):
    """Put searches together."""
    words = {each.method: protocol.words for each in searches}
    return Tuning(protocol, searches, words | (parameters or {}))


def constant(means, n=3):
    """Return runs that all have the mean of their row."""
    return np.repeat(np.array(means, dtype=float)[:, None], n, axis=1)
